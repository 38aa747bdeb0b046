"""What a recording holds, also one that was never finished, or is damaged."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import zstandard
from foxglove import Schema as FoxgloveSchema
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk

from toolee_robot.errors import UserError, words_of
from toolee_robot.recording import RECORDING
from toolee_robot.recording.history import RunHistory
from toolee_robot.recording.messages import decoder


def recording_of(run: Path) -> Path:
    """The recording of a run.

    Args:
        run: The run's folder, or the recording itself.

    Returns:
        The file.

    Raises:
        UserError: There is none.
    """
    path = run / RECORDING if run.is_dir() else run
    if not path.is_file():
        raise UserError(f"{run} holds no {RECORDING}: give the folder that the job named")
    return path


MAGIC = b"\x89MCAP0\r\n"
LARGEST_CHUNK = 64 * 1024**2
"""Largest content of a chunk that is unpacked [bytes]: a depth image of 8 megapixels takes 32 MiB."""
_KINDS: dict[int, Any] = {
    Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.ATTACHMENT: Attachment, Opcode.METADATA: Metadata,
    Opcode.DATA_END: DataEnd, Opcode.CHUNK: Chunk,
}  # fmt: skip


def read_history(path: Path) -> RunHistory:
    """Read a recording.

    Args:
        path: The file.

    Returns:
        What it says, up to its end or to its first damage: `complete` and `damage` tell.

    Raises:
        UserError: The file cannot be read, or holds nothing; code `user.recording_unreadable`.
    """
    records = _Records(path)
    history = RunHistory(complete=False)
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, Any]] = {}

    def take(record: Any) -> None:
        match record:
            case Schema():
                schemas[record.id] = record
            case Channel():
                schema = schemas[record.schema_id]
                channels[record.id] = record.topic, decoder(_schema(schema))
            case Metadata(name="run"):
                history.metadata = dict(record.metadata)
            case Attachment():
                history.attachments[record.name] = record.data
            case Message():
                topic, decode = channels[record.channel_id]
                history.add(topic, record.log_time * 1e-9, decode(record.data))

    records.read(take)
    history.complete, history.damage = records.complete, records.damage
    if not history.metadata and not len(history.decisions):
        raise _unreadable(path, records.damage or "it holds no recording of a run")
    return history


class _Records:
    """The records of a file, whose checksums are verified.

    Args:
        path: The file.

    Attributes:
        complete: Whether the file was finished, and is whole.
        damage: What is wrong with it, and from where on it is not read; empty for an unfinished file that is whole.
    """

    def __init__(self, path: Path) -> None:
        self.complete, self.damage = False, ""
        self._path = path

    def read(self, take: Any) -> None:
        """Hand over every record, as far as the file can be read.

        Args:
            take: Takes a record.

        Raises:
            UserError: There is no such file, or it is no MCAP.
        """
        try:
            with self._path.open("rb") as file:
                if file.read(len(MAGIC)) != MAGIC:
                    raise _unreadable(self._path, "it is no MCAP file")
                at = file.tell()
                try:
                    for record in self._records(file):
                        take(record)
                        at = file.tell()
                except Exception as error:  # noqa: BLE001 - what damaged bytes make of the libraries cannot be listed
                    self.complete = False
                    self.damage = f"it is damaged after {at} bytes, and read up to there ({_words(error)})"
        except OSError as error:
            raise _unreadable(self._path, words_of(error)) from error

    def _records(self, file: IO[bytes]) -> Iterator[Any]:
        size = os.fstat(file.fileno()).st_size
        checksum = zlib.crc32(MAGIC)
        while True:
            head = file.read(9)
            opcode, length = head[:1], int.from_bytes(head[1:], "little")
            if len(head) < 9 or opcode == b"\0" or length > size - file.tell():
                return  # the end of a file that was not finished, or zeros after a power cut
            content = file.read(length)
            kind = _KINDS.get(opcode[0])
            record = None if kind is None else kind.read(ReadDataStream(BytesIO(content)))
            if isinstance(record, DataEnd):
                if record.data_section_crc not in (0, checksum):
                    raise ValueError("a checksum is wrong")
                break
            checksum = zlib.crc32(content, zlib.crc32(head, checksum))
            if isinstance(record, Attachment):
                _check(content[:-4], int.from_bytes(content[-4:], "little"))
            if isinstance(record, Chunk):
                yield from _unpacked(record)
            elif record is not None:
                yield record
        self.complete = file.read()[-len(MAGIC) :] == MAGIC  # an index follows, which nothing here needs


def _unpacked(chunk: Chunk) -> list[Any]:
    if chunk.uncompressed_size > LARGEST_CHUNK:
        raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes")
    data = chunk.data
    if chunk.compression == "zstd":
        stream = zstandard.ZstdDecompressor().stream_reader(data)
        data = stream.read(chunk.uncompressed_size + 1)
    elif chunk.compression:
        raise ValueError(f"a chunk packed by {chunk.compression}")
    if len(data) != chunk.uncompressed_size:
        raise ValueError("a chunk of another size than it says")
    _check(data, chunk.uncompressed_crc)
    return breakup_chunk(replace(chunk, data=data, compression=""))


def _check(data: bytes, checksum: int) -> None:
    if checksum not in (0, zlib.crc32(data)):
        raise ValueError("a checksum is wrong")


def _schema(schema: Schema) -> FoxgloveSchema:
    return FoxgloveSchema(name=schema.name, encoding=schema.encoding, data=schema.data)


def _words(error: Exception) -> str:
    return str(error) or type(error).__name__


def _unreadable(path: Path, why: str) -> UserError:
    return UserError(f"cannot read the recording {path}: {why}", code="user.recording_unreadable")

"""What a recording holds, also one that was never finished, or is damaged."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, Chunk, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk

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


LARGEST_CHUNK = 64 * 1024**2
"""Largest record, and largest content of a chunk that is unpacked [bytes]: a depth image of 8 megapixels takes 32
MiB."""


def read_history(path: Path) -> RunHistory:
    """Read a recording.

    Args:
        path: The file.

    Returns:
        What it says, up to its end or to its first damage: `complete` and `damage` tell.

    Raises:
        UserError: The file cannot be read, or holds nothing; code `user.recording_unreadable`.
    """
    history = RunHistory(complete=False)
    try:
        with path.open("rb") as file:
            try:
                _take(_records(file), history)
                history.complete = True
            except Exception as error:  # noqa: BLE001 - what damaged bytes make of the libraries cannot be listed
                at, why = file.tell(), str(error) or type(error).__name__
                if isinstance(error, CRCValidationError):
                    why = "a checksum is wrong"
                if file.read(1):  # else it was cut there, as that of a program that was killed
                    history.damage = f"it is damaged before byte {at}, and read up to there ({why})"
    except OSError as error:
        raise _unreadable(path, words_of(error)) from error
    if not history.metadata and not len(history.decisions):
        raise _unreadable(path, history.damage or "it holds no recording of a run")
    return history


def _take(records: Iterator[Any], history: RunHistory) -> None:
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, Any]] = {}
    for record in records:
        match record:
            case Schema():
                schemas[record.id] = record
            case Channel():
                channels[record.id] = record.topic, decoder(schemas[record.schema_id])
            case Metadata(name="run"):
                history.metadata = dict(record.metadata)
            case Attachment():
                history.attachments[record.name] = record.data
            case Message():
                topic, decode = channels[record.channel_id]
                history.add(topic, record.log_time * 1e-9, decode(record.data))


def _records(file: IO[bytes]) -> Iterator[Any]:
    """The records of a file, whose checksums are verified."""
    reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=LARGEST_CHUNK)
    for record in reader.records:
        if isinstance(record, Attachment):  # whose checksum mcap's reader passes over
            builder: Any = RecordBuilder()
            record.write(builder)
            file.seek(-4, os.SEEK_CUR)
            if file.read(4) != builder.end()[-4:]:
                raise ValueError("a checksum is wrong")
        if not isinstance(record, Chunk):
            yield record
            continue
        told = zstandard.frame_content_size(record.data) if record.compression == "zstd" else 0
        if max(told, record.uncompressed_size) > LARGEST_CHUNK:
            raise ValueError(f"a chunk of {max(told, record.uncompressed_size)} bytes")
        yield from breakup_chunk(record, validate_crc=True)


def _unreadable(path: Path, why: str) -> UserError:
    return UserError(f"cannot read the recording {path}: {why}", code="user.recording_unreadable")

"""Reads a recording, also one that was never finished."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Footer, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory

from toolee_robot.errors import UserError, words_of
from toolee_robot.recording.history import RunHistory


def read_history(path: Path) -> RunHistory:
    """Read a recording.

    Args:
        path: The file.

    Returns:
        What it says; of an unfinished file all up to its last complete chunk.

    Raises:
        UserError: The file cannot be read or holds nothing; code `user.recording_unreadable`.
    """
    history, decoders = RunHistory(complete=False), DecoderFactory()
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    decode: dict[int, Any] = {}
    for record in _records(path):
        match record:
            case Schema():
                schemas[record.id] = record
            case Channel():
                channels[record.id] = record
            case Metadata(name="run"):
                history.metadata = dict(record.metadata)
            case Attachment():
                history.attachments[record.name] = record.data
            case Footer():
                history.complete = True
            case Message():
                channel = channels[record.channel_id]
                if channel.id not in decode:
                    decode[channel.id] = decoders.decoder_for(channel.message_encoding, schemas[channel.schema_id])
                if decode[channel.id] is not None:
                    history.add(channel.topic, record.log_time * 1e-9, decode[channel.id](record.data))
    if not history.metadata and not len(history.decisions):
        raise UserError(f"{path} holds no recording of a run", code="user.recording_unreadable")
    return history


def finish_copy(source: Path, target: Path) -> int:
    """Copy all that can be read of an unfinished recording into a finished one, which every reader opens.

    Args:
        source: The unfinished file.
        target: The finished file.

    Returns:
        Number of messages.

    Raises:
        UserError: The file cannot be read; code `user.recording_unreadable`.
    """
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    count = 0
    with target.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for record in _records(source):
            match record:
                case Schema() if record.id not in schemas:
                    schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
                case Channel() if record.id not in channels:
                    channels[record.id] = writer.register_channel(
                        record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
                    )
                case Metadata():
                    writer.add_metadata(record.name, record.metadata)
                case Attachment():
                    writer.add_attachment(
                        record.create_time, record.log_time, record.name, record.media_type, record.data
                    )
                case Message():
                    writer.add_message(
                        channels[record.channel_id], record.log_time, record.data, record.publish_time, record.sequence
                    )
                    count += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return count


def _records(path: Path) -> Iterator[Any]:
    try:
        with path.open("rb") as file:
            records = StreamReader(file).records
            first = True
            while True:
                try:
                    record = next(records)
                except StopIteration:
                    return
                except (McapError, struct.error, EOFError):  # the end of a file that was not finished
                    if first:
                        raise
                    return
                first = False
                yield record
    except (OSError, McapError, struct.error, EOFError) as error:
        raise UserError(
            f"cannot read the recording {path}: {words_of(error)}", code="user.recording_unreadable"
        ) from error

"""An MCAP file that a thread of its own writes, so that who records waits for neither encoding nor disk."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from google.protobuf.message import Message
from mcap.well_known import MessageEncoding
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

import toolee_robot
from toolee_robot.errors import UserError, words_of
from toolee_robot.recording.messages import nanoseconds

FLUSH_PERIOD = 1.0
"""Longest time that a message waits in memory [s]; what a killed process loses."""
CHUNK_SIZE = 256 * 1024
"""Size at which a chunk is compressed and written [bytes]."""

Item = tuple[str, float, Message]
"""Topic, stamp [s] on the station's clock, message."""


class _ChunkWriter(Writer):
    def end_chunk(self) -> None:
        """Write the messages so far; mcap's writer itself does so by size only."""
        self._Writer__finalize_chunk()  # type: ignore[attr-defined]


class McapFile:
    """Writes messages in the background until it is closed.

    Args:
        path: The file; its folder exists.

    Raises:
        UserError: It cannot be written; code `user.recording_not_writable`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise self._not_writable(error) from error
        self._writer = _ChunkWriter(self._file, chunk_size=CHUNK_SIZE)
        self._writer.start(profile="", library=f"toolee_robot {toolee_robot.__version__}")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._queue: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write metadata.

        Args:
            name: Name of the record.
            values: Text by name.
        """
        self._queue.put(lambda: self._writer.add_metadata(name, dict(values)))

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment.

        Args:
            name: Its name.
            media_type: Its media type.
            data: Its content.
        """
        self._queue.put(lambda: self._writer.add_attachment(0, 0, name, media_type, data))

    def write(self, build: Callable[[], list[Item]], then: Callable[[Item], None]) -> None:
        """Write messages.

        Args:
            build: Makes the messages, on the writing thread.
            then: Called with each message after it was written, on the writing thread.
        """

        def write() -> None:
            for item in build():
                self._add(*item)
                then(item)

        self._queue.put(write)

    def close(self) -> None:
        """Write what waits, the index, and close.

        Raises:
            UserError: Something could not be written; code `user.recording_not_writable`.
        """
        self._queue.put(None)
        self._thread.join()
        try:
            with self._file:
                if self._failure is not None:
                    raise self._failure
                self._writer.finish()  # type: ignore[no-untyped-call]
        except OSError as error:
            raise self._not_writable(error) from error

    def _run(self) -> None:
        pending, flushed = False, time.monotonic()
        while True:
            wait = max(FLUSH_PERIOD - (time.monotonic() - flushed), 0.0) if pending else None
            try:
                action = self._queue.get(timeout=wait)
                if action is None:
                    return
                pending = True
            except queue.Empty:
                action = _nothing
            if self._failure is not None:
                continue  # the queue is emptied nevertheless: a full disk must not fill the memory, too
            try:
                action()
                if pending and time.monotonic() - flushed >= FLUSH_PERIOD:
                    self._writer.end_chunk()
                    self._file.flush()
                    pending, flushed = False, time.monotonic()
            except BaseException as error:  # noqa: BLE001  (reported by `close`)
                self._failure = error

    def _add(self, topic: str, stamp: float, message: Message) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            name = message.DESCRIPTOR.full_name
            if name not in self._schemas:
                self._schemas[name] = register_schema(self._writer, type(message))
            channel = self._writer.register_channel(topic, MessageEncoding.Protobuf, self._schemas[name])
            self._channels[topic] = channel
        time_ns = nanoseconds(stamp)
        self._writer.add_message(channel, log_time=time_ns, data=message.SerializeToString(), publish_time=time_ns)

    def _not_writable(self, error: OSError) -> UserError:
        return UserError(
            f"cannot write the recording {self._path}: {words_of(error)}", code="user.recording_not_writable"
        )


def _nothing() -> Any:
    """What is done where only time has passed."""

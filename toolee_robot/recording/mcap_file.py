"""The files of a recording: the MCAP file, written with Foxglove's SDK, and the tool's shape in it.

A full disk ends the MCAP file, and nothing else.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from contextlib import suppress
from io import FileIO
from pathlib import Path

import numpy as np
import trimesh
from foxglove import Channel, Context, Schema, open_mcap
from foxglove.mcap import MCAPWriteOptions

from toolee_robot.errors import UserError, words_of
from toolee_robot.tools import ToolShape

CHUNK_SIZE = 256 * 1024
"""Size at which a chunk is compressed and written [bytes]."""
ROOM_LEFT = 64 * 1024
"""What is given back when the disk is full, for the run's summary [bytes]."""


class McapFile:
    """Writes an MCAP file until it is closed.

    Args:
        path: The file.

    Raises:
        UserError: It cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._sink = _Sink(path)
        except OSError as error:
            message = f"cannot write the recording {path}: {words_of(error)}"
            raise UserError(message) from error
        self._context = Context()
        options = MCAPWriteOptions(chunk_size=CHUNK_SIZE, disable_seeking=True)
        self._writer = open_mcap(self._sink, context=self._context, writer_options=options)
        self._channels: dict[str, Channel] = {}

    @property
    def failure(self) -> OSError | None:
        """Why nothing is written any more; None as long as all is."""
        return self._sink.failure

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write text by name."""
        self._writer.write_metadata(name, dict(values))

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment.

        Args:
            name: Its name.
            media_type: Its media type.
            data: Its content.
        """
        self._writer.attach(log_time=0, create_time=0, name=name, media_type=media_type, data=data)

    def write(self, topic: str, time_ns: int, schema: Schema, data: bytes) -> None:
        """Write a message.

        Args:
            topic: Its topic.
            time_ns: Its time [ns].
            schema: Its schema, which the topic has had since its first message.
            data: The message, by Protocol Buffers.
        """
        channel = self._channels.get(topic)
        if channel is None:
            channel = Channel(topic, message_encoding="protobuf", schema=schema, context=self._context)
            self._channels[topic] = channel
        channel.log(data, log_time=time_ns)

    def flush(self) -> None:
        """End the chunk: all so far can be read after a kill."""
        self._writer.flush()
        self._sink.mark()

    def close(self) -> None:
        """Write index and checksums."""
        self._writer.close()
        self._sink.close()


class _Sink:
    """The file as the SDK sees it: never fails. What cannot be written any more is dropped."""

    def __init__(self, path: Path) -> None:
        self.failure: OSError | None = None
        self._file = FileIO(path, "w")
        self._size, self._marks = 0, [0]

    def write(self, data: bytes | bytearray) -> int:
        if self.failure is None:
            try:
                rest = memoryview(data)
                while rest:
                    rest = rest[self._file.write(rest) :]
            except OSError as error:
                self.failure = error
                keep = max((mark for mark in self._marks if mark <= self._size - ROOM_LEFT), default=0)
                with suppress(OSError):
                    self._file.truncate(keep)
        self._size += len(data)
        return len(data)

    def seek(self, *_: int) -> int:
        """The present position, all that the SDK asks for with `disable_seeking`."""
        return self._size

    def flush(self) -> None:
        """Nothing is buffered."""

    def mark(self) -> None:
        """Remember that the file is whole up to here."""
        if self.failure is None:
            self._marks.append(self._size)

    def close(self) -> None:
        with suppress(OSError):
            self._file.close()


def tool_model(shape: ToolShape) -> bytes:
    """A tool's surface as a glTF binary, coloured by part, in the frame `tool`.

    Args:
        shape: The tool.

    Returns:
        The file.
    """
    colors = np.array([[*(round(255 * c) for c in part.material.color), 255] for part in shape.parts], dtype=np.uint8)
    # The faces' corners apart, so that each has its part's colour.
    triangles = shape.mesh.vertices.view(np.ndarray)[shape.mesh.faces.view(np.ndarray)].reshape(-1, 3)
    mesh = trimesh.Trimesh(triangles, np.arange(len(triangles)).reshape(-1, 3), process=False)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.repeat(colors[shape.face_parts], 3, axis=0))
    data = mesh.export(file_type="glb")
    assert isinstance(data, bytes)
    return data


def read_tool_model(data: bytes) -> trimesh.Trimesh:
    """The surface of a tool from its file, frame `tool`.

    Args:
        data: The file.

    Returns:
        The mesh, coloured by vertex.
    """
    return trimesh.load_mesh(io.BytesIO(data), file_type="glb")

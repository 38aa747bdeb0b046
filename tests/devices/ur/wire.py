"""A peer of the read-only clients that sends prepared bytes: over a socket pair, so that many cases are quick."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

FORMATS = {"DOUBLE": "d", "VECTOR6D": "6d", "VECTOR3D": "3d", "INT32": "i", "UINT32": "I", "UINT64": "Q", "BOOL": "?"}


def packet(kind: bytes, payload: bytes = b"") -> bytes:
    return struct.pack(">HB", 3 + len(payload), kind[0]) + payload


def setup_reply(types: Sequence[str], recipe: int = 1) -> bytes:
    return packet(b"O", bytes([recipe]) + ",".join(types).encode()) + packet(b"S", b"\x01")


def data(types: Sequence[str], values: Sequence[object], recipe: int = 1) -> bytes:
    flat: list[object] = []
    for value in values:
        flat += value if isinstance(value, tuple) else (value,)
    return packet(b"U", bytes([recipe]) + struct.pack(">" + "".join(FORMATS[t] for t in types), *flat))


@contextmanager
def peer_sends(*chunks: bytes, pause: float = 0.0, close: bool = True) -> Iterator[socket.socket]:
    """The near end of a connection whose far end sends the chunks, with a pause [s] after each, then closes."""
    near, far = socket.socketpair()
    stop = threading.Event()

    def send() -> None:
        for chunk in chunks:
            try:
                far.sendall(chunk)
            except OSError:
                return
            if pause and stop.wait(pause):
                return
        if close:
            far.shutdown(socket.SHUT_WR)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield near
    finally:
        stop.set()
        near.close()
        thread.join()
        far.close()


def soon(seconds: float = 10.0) -> float:
    """A deadline; by default one that a busy machine keeps, too."""
    return time.monotonic() + seconds

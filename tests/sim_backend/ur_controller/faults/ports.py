"""Clients of the ports of the controller stand-in that the tests of the fault port use."""

from __future__ import annotations

import socket
import struct

HOST = "127.0.0.15"
"""Address of the stand-in."""


def ask(line: str) -> str:
    """A question to the dashboard."""
    with socket.create_connection((HOST, 29999), 5.0) as dashboard, dashboard.makefile("rw") as stream:
        stream.readline()
        stream.write(f"{line}\n")
        stream.flush()
        return stream.readline().strip()


def upload(source: str) -> None:
    with socket.create_connection((HOST, 30003), 5.0) as port:
        port.sendall(source.encode())


def reachable(port: int) -> bool:
    try:
        socket.create_connection((HOST, port), 1.0).close()
    except OSError:
        return False
    return True


def calibration() -> tuple[float, ...]:
    """Checksum (6), theta (6), a (6), d (6), alpha (6), status: from the primary interface's first robot state."""
    with socket.create_connection((HOST, 30001), 5.0) as primary, primary.makefile("rb") as stream:
        while True:
            size, kind = struct.unpack(">iB", stream.read(5))
            body = stream.read(size - 5)
            while kind == 16 and body:
                part, name = struct.unpack(">iB", body[:5])
                if name == 5:
                    return struct.unpack(">6I24dI", body[5:part])
                body = body[part:]

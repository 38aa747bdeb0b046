"""Supervision of ur_rtde's sockets through the kernel.

ur_rtde's control interface reconnects silently when it has lost the robot: within a few milliseconds it ends the
robot's program and starts another. But a lost connection must end a motion, and nothing may resume by itself. So the
original sockets are monitored, and the process is prevented from opening others.

ur_rtde also disables Nagle's algorithm on a socket that it replaces when it connects, so it stays enabled. A command
then waits for the acknowledgement of the previous one, which a controller sends with its next packet: after one late
command, every later one would arrive a cycle late.
"""

from __future__ import annotations

import os
import resource
import socket
import stat
from contextlib import suppress
from pathlib import Path

_OPEN_FILES = 1  # not 0: poll() refuses more descriptors than the limit. Descriptor 0 itself is in use.


class UrRtdeSockets:
    """The sockets of this process that are connected to a peer's TCP port at the time of construction.

    Construction disables Nagle's algorithm on them and prevents this process from opening any more files or sockets; a
    new connection needs a new process.

    Args:
        port: The peer's TCP port.
    """

    def __init__(self, port: int) -> None:
        self._inodes: dict[int, int] = {}
        for entry in Path("/proc/self/fd").iterdir():
            with suppress(OSError):  # not connected, or the descriptor of the listing itself
                fd, state = int(entry.name), os.fstat(int(entry.name))
                if stat.S_ISSOCK(state.st_mode) and _claim(fd, port):
                    self._inodes[fd] = state.st_ino
        resource.setrlimit(resource.RLIMIT_NOFILE, (_OPEN_FILES, _OPEN_FILES))

    @property
    def same(self) -> bool:
        """Whether all of them are still the original ones; takes some microseconds."""
        try:
            return all(os.fstat(fd).st_ino == inode for fd, inode in self._inodes.items())
        except OSError:
            return False


def _claim(fd: int, port: int) -> bool:
    """Disable Nagle's algorithm if the socket is connected to this port; returns whether it is."""
    with socket.socket(fileno=os.dup(fd)) as sock:
        if sock.family not in (socket.AF_INET, socket.AF_INET6) or sock.getpeername()[1] != port:
            return False
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return True

"""The wheel's connections to the robot, as the kernel knows them.

Its control interface connects again by itself when it has lost the robot, and says nothing of it: commands are missing
in between, and the robot has moved on. A lost connection has to end a motion, so the sockets are watched themselves.
"""

from __future__ import annotations

import os
import socket
import stat
from contextlib import suppress
from pathlib import Path


class WheelSockets:
    """The sockets of this process that are connected to this TCP port of a peer at the time of construction."""

    def __init__(self, port: int) -> None:
        self._inodes: dict[int, int] = {}
        for entry in Path("/proc/self/fd").iterdir():
            with suppress(OSError):  # not connected, or the listing's own
                fd, state = int(entry.name), os.fstat(int(entry.name))
                if stat.S_ISSOCK(state.st_mode) and _peer_port(fd) == port:
                    self._inodes[fd] = state.st_ino

    @property
    def same(self) -> bool:
        """Whether all of them are still those of the beginning. Some microseconds."""
        try:
            return all(os.fstat(fd).st_ino == inode for fd, inode in self._inodes.items())
        except OSError:
            return False


def _peer_port(fd: int) -> int:
    with socket.socket(fileno=os.dup(fd)) as sock:
        if sock.family not in (socket.AF_INET, socket.AF_INET6):
            return 0
        return int(sock.getpeername()[1])

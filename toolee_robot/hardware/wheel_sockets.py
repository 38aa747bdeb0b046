"""The wheel's connections to the robot, as the kernel knows them.

Its control interface connects again by itself when it has lost the robot, and says nothing of it: commands are missing
in between, and the robot has moved on. A lost connection has to end a motion, so the sockets are watched themselves.
"""

from __future__ import annotations

import os
import socket
import stat
from contextlib import suppress


class WheelSockets:
    """The sockets of this process that are connected to a TCP port of a peer at the time of construction."""

    def __init__(self, port: int) -> None:
        self._inodes: dict[int, int] = {}
        for name in os.listdir("/proc/self/fd"):
            with suppress(OSError):
                state = os.stat(int(name))
                if stat.S_ISSOCK(state.st_mode) and _peer_port(int(name)) == port:
                    self._inodes[int(name)] = state.st_ino

    def __len__(self) -> int:
        return len(self._inodes)

    @property
    def same(self) -> bool:
        """Whether all of them are still those of the beginning. Some microseconds."""
        try:
            return all(os.stat(fd).st_ino == inode for fd, inode in self._inodes.items())
        except OSError:
            return False


def _peer_port(fd: int) -> int:
    with socket.socket(fileno=os.dup(fd)) as sock:
        if sock.family not in (socket.AF_INET, socket.AF_INET6):
            return 0
        return int(sock.getpeername()[1])

"""ur_rtde's connections to the robot, as the kernel knows them.

Its control interface connects again by itself when it has lost the robot, and says nothing of it: within a few
milliseconds it ends the robot's program, which the robot's watchdog would have ended with the arm held where it was
sent, and starts another. A lost connection has to end a motion, and nothing may resume by itself. So the sockets are
watched, and no other may take their place.

It also turns Nagle's algorithm off too early: its library makes another socket when it connects. With the algorithm on,
a command waits until the one before it has been acknowledged, which a controller does with its next packet: once a
command is late, all of them reach the robot a cycle later from then on.
"""

from __future__ import annotations

import os
import resource
import socket
import stat
from contextlib import suppress
from pathlib import Path

# poll() itself refuses more descriptors than may be open; the one that is left is 0, which is in use.
_OPEN_FILES = 1


class UrRtdeSockets:
    """The sockets of this process that are connected to this TCP port of a peer at the time of construction.

    From then on they send at once what they are given, and this process can open no file and no socket any more:
    whoever wants to connect anew starts another.
    """

    def __init__(self, port: int) -> None:
        self._inodes: dict[int, int] = {}
        for entry in Path("/proc/self/fd").iterdir():
            with suppress(OSError):  # not connected, or the listing's own
                fd, state = int(entry.name), os.fstat(int(entry.name))
                if stat.S_ISSOCK(state.st_mode) and _claim(fd, port):
                    self._inodes[fd] = state.st_ino
        resource.setrlimit(resource.RLIMIT_NOFILE, (_OPEN_FILES, _OPEN_FILES))

    @property
    def same(self) -> bool:
        """Whether all of them are still those of the beginning. Some microseconds."""
        try:
            return all(os.fstat(fd).st_ino == inode for fd, inode in self._inodes.items())
        except OSError:
            return False


def _claim(fd: int, port: int) -> bool:
    """Whether it is connected to this port; Nagle's algorithm is off then."""
    with socket.socket(fileno=os.dup(fd)) as sock:
        if sock.family not in (socket.AF_INET, socket.AF_INET6) or sock.getpeername()[1] != port:
            return False
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return True

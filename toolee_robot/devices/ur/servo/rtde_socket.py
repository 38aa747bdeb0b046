"""Supervision of ur_rtde's RTDE connection through the kernel, and the watchdog's kick on it.

ur_rtde's control interface reconnects silently when it has lost the robot: within a few milliseconds it ends the
robot's program and starts another. But a lost connection must end a motion, and nothing may resume by itself. So the
original socket is monitored, and the process is prevented from opening others.

ur_rtde's own `kickWatchdog` waits until the control script has taken the kick. If the robot is stopped or its program
paused in that cycle, the script never does, and the call keeps this process busy for seconds. The kick is therefore
written as the RTDE packet that it is.

ur_rtde also disables Nagle's algorithm on a socket that it replaces when it connects, so it stays enabled. A command
then waits for the acknowledgement of the previous one, which a controller sends with its next packet: after one late
command, every later one would arrive a cycle late.
"""

from __future__ import annotations

import os
import resource
import socket
import stat
import struct
from contextlib import suppress
from pathlib import Path

from toolee_robot.errors import DeviceError

_KICK = struct.pack(">HBBi", 8, ord("U"), 4, 0)
"""A data packet of ur_rtde's fourth input recipe, which is input_int_register_0 alone, with 0: no command."""

_OPEN_FILES = 1  # not 0: poll() refuses more descriptors than the limit. Descriptor 0 itself is in use.


class UrRtdeSocket:
    """The one socket of ur_rtde that is connected to the robot's RTDE server at the time of construction.

    Construction disables Nagle's algorithm on it and prevents this process from opening any more files or sockets; a
    new connection needs a new process.

    Args:
        port: TCP port of the RTDE server.
        ours: Descriptor of this process's own connection to it, which is not ur_rtde's.

    Raises:
        DeviceError: ur_rtde has another number of connections than the one that is known here.
    """

    def __init__(self, port: int, ours: int) -> None:
        found: dict[int, int] = {}
        for entry in Path("/proc/self/fd").iterdir():
            with suppress(OSError):  # not connected, or the descriptor of the listing itself
                fd, state = int(entry.name), os.fstat(int(entry.name))
                if fd != ours and stat.S_ISSOCK(state.st_mode) and _claim(fd, port):
                    found[fd] = state.st_ino
        if len(found) != 1:
            message = f"ur_rtde has {len(found)} RTDE connections instead of one: install the version in pyproject"
            raise DeviceError(message, code="device.ur_rtde_version")
        ((self._fd, self._inode),) = found.items()
        resource.setrlimit(resource.RLIMIT_NOFILE, (_OPEN_FILES, _OPEN_FILES))

    @property
    def same(self) -> bool:
        """Whether it is still the original one; takes some microseconds."""
        try:
            return os.fstat(self._fd).st_ino == self._inode
        except OSError:
            return False

    def kick(self) -> bool:
        """Reset the robot's watchdog; never waits. Returns whether the connection took the packet."""
        try:
            return self.same and os.write(self._fd, _KICK) == len(_KICK)
        except OSError:
            return False


def _claim(fd: int, port: int) -> bool:
    """Disable Nagle's algorithm if the socket is connected to this port; returns whether it is."""
    with socket.socket(fileno=os.dup(fd)) as sock:
        if sock.family not in (socket.AF_INET, socket.AF_INET6) or sock.getpeername()[1] != port:
            return False
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return True

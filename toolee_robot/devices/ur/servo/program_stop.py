"""Ending the robot's program through the dashboard server.

A protective or safeguard stop only pauses a program. Play at the pendant, or on a CB3 controller the closing safeguard,
would resume it, and the arm would move on to the last position sent. The dashboard's `stop` ends the program and
releases nothing: a person still has to clear the stop (UR, "Dashboard server").
"""

from __future__ import annotations

import errno
import socket
import time
from contextlib import suppress
from typing import Final

from toolee_robot.devices.ur.protocols.dashboard import DASHBOARD_PORT
from toolee_robot.devices.ur.protocols.tcp import connect, receive, send
from toolee_robot.errors import DeviceError

RETRY: Final = 0.2  # [s] on the wall clock between two requests
CONNECT: Final = 0.02  # [s] on the wall clock between two looks at a connection that is being made
TRIES: Final = 3  # requests on one connection, before a new one
SPARES: Final = 4  # sockets for new connections, made in advance: the servo process may open none later
_STOP = b"stop\n"


class ProgramStop:
    """A connection to the dashboard server that is kept open, so that a stop is one packet and needs no waiting.

    Args:
        host: Address of the controller.
        deadline: Deadline of connecting [s], a value of `time.monotonic()`.

    Raises:
        NoAnswerError: The dashboard server does not answer.
    """

    def __init__(self, host: str, deadline: float) -> None:
        self._socket = connect(host, DASHBOARD_PORT, deadline)
        self._address = self._socket.getpeername()
        self._socket.setblocking(False)
        self._spares = [socket.socket(socket.AF_INET, socket.SOCK_STREAM) for _ in range(SPARES)]
        self._connected, self._tries, self._next = True, 0, 0.0

    def request(self) -> None:
        """Ask for the end of the program; to be called in every cycle until the robot's state shows that it has ended.

        The request is repeated every RETRY seconds, on a new connection if the old one is lost or silent. Never waits.
        """
        now = time.monotonic()
        if now < self._next:
            return
        if not self._connected:
            self._connected = self._socket.connect_ex(self._address) in (0, errno.EISCONN)
        if self._connected and (self._tries >= TRIES or not self._send()):
            self._replace()
        self._next = now + (RETRY if self._connected else CONNECT)

    def _send(self) -> bool:
        """Whether the request could be handed to a connection that is not closed."""
        self._tries += 1
        try:
            with suppress(BlockingIOError):
                if not self._socket.recv(4096):  # greetings and answers: the robot's state tells more
                    return False
            self._socket.send(_STOP)
        except OSError:
            return False
        return True

    def _replace(self) -> None:
        """Begin a new connection, as long as there are sockets for it."""
        if self._spares:
            self._socket.close()
            self._socket = self._spares.pop()
            self._socket.setblocking(False)
            self._socket.connect_ex(self._address)
            self._connected, self._tries = False, 0


def end_program(host: str, timeout: float) -> bool:
    """End the robot's program from a process that has no connection; waits for the answer.

    Args:
        host: Address of the controller.
        timeout: Longest duration [s] on the wall clock.

    Returns:
        Whether the dashboard server has confirmed it.
    """
    deadline = time.monotonic() + timeout
    try:
        with connect(host, DASHBOARD_PORT, deadline) as sock:
            send(sock, _STOP, deadline)
            answers = b""
            while answers.count(b"\n") < 2:  # the greeting, and the answer
                answers += receive(sock, deadline)
    except DeviceError:
        return False
    return answers.split(b"\n")[1].strip() == b"Stopped"

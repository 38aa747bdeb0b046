"""Questions to the dashboard server (port 29999) that change nothing: model, serial number, modes.

A question is a line, its answer is a line; the server greets first. The whole conversation ends by its deadline.
"""

from __future__ import annotations

import socket
from collections.abc import Sequence
from typing import Literal

from toolee_robot.errors import ProtocolError
from toolee_robot.hardware.ur.protocols.tcp import connect, receive, send

DASHBOARD_PORT = 29999
_LONGEST = 4096  # [bytes] of a line

Question = Literal[
    "PolyscopeVersion",
    "get robot model",
    "get serial number",
    "is in remote control",
    "robotmode",
    "safetymode",
    "running",
]


class DashboardReader:
    """One connection; the greeting has been read."""

    def __init__(self, sock: socket.socket, deadline: float) -> None:
        """sock: connected, owned from here. Raises NoAnswerError, ProtocolError."""
        self._sock = sock
        self._bytes = bytearray()
        greeting = self._line(deadline)
        if "dashboard" not in greeting.lower():
            raise ProtocolError(f"port {DASHBOARD_PORT} greets with {greeting[:60]!r}: this is no dashboard server")

    def ask(self, question: Question, deadline: float) -> str | None:
        """The answer, or None where this PolyScope does not know the question."""
        send(self._sock, question.encode() + b"\n", deadline)
        answer = self._line(deadline).strip()
        return None if answer.lower().startswith(("could not understand", "unknown command")) else answer

    def _line(self, deadline: float) -> str:
        while b"\n" not in self._bytes:
            if len(self._bytes) > _LONGEST:
                raise ProtocolError("the dashboard server sends a line without end: this is no dashboard server")
            self._bytes += receive(self._sock, deadline)
        line, _, rest = self._bytes.partition(b"\n")
        self._bytes = bytearray(rest)
        try:
            return line.decode("utf-8")
        except UnicodeDecodeError as error:
            raise ProtocolError("the dashboard server's answer is not text") from error


def ask_all(
    host: str, questions: Sequence[Question], deadline: float, port: int = DASHBOARD_PORT
) -> dict[Question, str | None]:
    """Every question's answer (None: not known to this PolyScope). Raises NoAnswerError, ProtocolError."""
    sock = connect(host, port, deadline)
    with sock:
        reader = DashboardReader(sock, deadline)
        return {question: reader.ask(question, deadline) for question in questions}

"""Read-only client of the dashboard server (port 29999): model, serial number, modes.

The server greets with a line, and answers each line with one. All calls end by their deadline, a value of
`time.monotonic()`.
"""

from __future__ import annotations

import socket
from collections.abc import Sequence
from typing import Literal

from toolee_robot.devices.ur.protocols.tcp import connect, receive, send
from toolee_robot.errors import ProtocolError

DASHBOARD_PORT = 29999
_MAX_LINE = 4096  # [bytes]

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
    """A connection to the dashboard server whose greeting has been read.

    Args:
        sock: Connected socket; the caller closes it.
        deadline: Deadline of the greeting [s], a value of `time.monotonic()`.

    Raises:
        NoAnswerError: There is no greeting in time.
        ProtocolError: The peer is no dashboard server.
    """

    def __init__(self, sock: socket.socket, deadline: float) -> None:
        self._sock = sock
        self._bytes = bytearray()
        greeting = self._line(deadline)
        if "dashboard" not in greeting.lower():
            message = f"port {DASHBOARD_PORT} greets with {greeting[:60]!r}: this is no dashboard server"
            raise ProtocolError(message)

    def ask(self, question: Question, deadline: float) -> str | None:
        """Ask one question.

        Args:
            question: The command to send.
            deadline: Deadline of the answer [s], a value of `time.monotonic()`.

        Returns:
            The answer, or None if this version of PolyScope does not know the question.

        Raises:
            NoAnswerError: There is no answer in time.
            ProtocolError: The answer is not a line of text.
        """
        send(self._sock, question.encode() + b"\n", deadline)
        answer = self._line(deadline).strip()
        return None if answer.lower().startswith(("could not understand", "unknown command")) else answer

    def _line(self, deadline: float) -> str:
        while b"\n" not in self._bytes:
            if len(self._bytes) > _MAX_LINE:
                message = "the dashboard server sends a line without end: this is no dashboard server"
                raise ProtocolError(message, code="protocol.line_too_long")
            self._bytes += receive(self._sock, deadline)
        line, _, rest = self._bytes.partition(b"\n")
        self._bytes = bytearray(rest)
        try:
            return line.decode("utf-8")
        except UnicodeDecodeError as error:
            raise ProtocolError("the dashboard server's answer is not text", code="protocol.not_text") from error


def ask_all(host: str, questions: Sequence[Question], deadline: float) -> dict[Question, str | None]:
    """Connect and ask several questions.

    Args:
        host: Address of the controller.
        questions: The commands to send.
        deadline: Deadline of all answers [s], a value of `time.monotonic()`.

    Returns:
        The answer to each question; None where this version of PolyScope does not know it.

    Raises:
        NoAnswerError: The server does not answer in time.
        ProtocolError: The peer is no dashboard server.
    """
    with connect(host, DASHBOARD_PORT, deadline) as sock:
        reader = DashboardReader(sock, deadline)
        return {question: reader.ask(question, deadline) for question in questions}

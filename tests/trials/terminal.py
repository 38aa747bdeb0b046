"""A command at a pseudo-terminal, and a person who reads it and answers."""

from __future__ import annotations

import os
import pty
import re
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Self

from toolee_robot.runtime.readable import readable

_CONTROL = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]|\r")


class Terminal:
    """Runs a Python program as the leader of its own terminal, so that Ctrl-C reaches it and its children.

    Args:
        code: The program.
        args: Its arguments.

    Attributes:
        text: What the terminal shows.
        pid: The process; 0 once it has ended.
    """

    def __init__(self, code: str, *args: str) -> None:
        self.text, self._read = "", 0
        self.pid, self._fd = pty.fork()
        if self.pid == 0:
            os.execve(sys.executable, [sys.executable, "-c", code, *args], {**os.environ, "COLUMNS": "200"})

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._fd)
        if self.pid:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)

    def wait_for(self, words: Sequence[str], timeout: float = 120.0) -> str:
        """Read until something is shown that was not there at the last call.

        Args:
            words: What is waited for.
            timeout: Time after which the test fails [s].

        Returns:
            Which of them came.
        """
        end = time.monotonic() + timeout
        while True:
            unread = self.text[self._read :]
            found = [(unread.find(word), word) for word in words if word in unread]
            if found:
                at, word = min(found)
                self._read += at + len(word)
                return word
            assert time.monotonic() < end, f"none of {words} came; the terminal shows:\n{self.text}"
            assert self._more(1.0), f"it ended without {words}; the terminal shows:\n{self.text}"

    def answer(self, line: str) -> None:
        """Type a line.

        Args:
            line: The line; `\\x03` at its end is Ctrl-C.
        """
        os.write(self._fd, line.encode() if line.endswith("\x03") else f"{line}\n".encode())

    def until_end(self, answers: Mapping[str, str], timeout: float = 120.0) -> int:
        """Answer questions until the command ends.

        Args:
            answers: By what the question contains.
            timeout: Time between questions after which the test fails [s].

        Returns:
            Its exit code.
        """
        end = time.monotonic() + timeout
        while True:
            unread = self.text[self._read :]
            found = [(unread.find(question), question) for question in answers if question in unread]
            if found:
                at, question = min(found)
                self._read += at + len(question)
                self.answer(answers[question])
                end = time.monotonic() + timeout
            elif not self._more(1.0):
                break
            assert time.monotonic() < end, f"it asks nothing and does not end; the terminal shows:\n{self.text}"
        _, status = os.waitpid(self.pid, 0)
        self.pid = 0
        return os.waitstatus_to_exitcode(status)

    def _more(self, timeout: float) -> bool:
        """Read what comes; False where the command has ended."""
        if not readable([self._fd], timeout):
            return True
        try:
            data = os.read(self._fd, 65536)
        except OSError:  # the other end is closed
            return False
        self.text += _CONTROL.sub("", data.decode(errors="replace"))
        return bool(data)

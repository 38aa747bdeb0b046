"""URScript upload on ports 30001 (primary), 30002 (secondary) and 30003 (real-time)."""

from __future__ import annotations

from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.server.link import Sink

MAX_SCRIPT = 256 << 10  # [bytes] of one program above which the client is dropped


class ScriptReader:
    """Splits a byte stream into programs: from `def` or `sec` to an `end` in column 0, or a single line."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._lines: list[str] = []
        self._size = 0

    @property
    def size(self) -> int:
        """Bytes of the incomplete program."""
        return self._size + len(self._buffer)

    def feed(self, data: bytes) -> list[str]:
        """Take received bytes.

        Args:
            data: The bytes.

        Returns:
            The programs that they complete; a single statement becomes a program of one line.
        """
        self._buffer += data
        done: list[str] = []
        *lines, rest = self._buffer.split(b"\n")
        self._buffer = bytearray(rest)
        for raw in lines:
            line = raw.decode("utf-8", "replace").rstrip("\r")
            if self._lines:
                self._lines.append(line)
                self._size += len(raw) + 1
                if line.rstrip() == "end":
                    done.append("\n".join(self._lines) + "\n")
                    self._lines, self._size = [], 0
            elif line.startswith(("def ", "sec ")):
                self._lines, self._size = [line], len(raw) + 1
            elif line.strip() and not line.lstrip().startswith("#"):
                done.append(f"def unnamed():\n  {line.strip()}\nend\n")
        return done


class ScriptSession:
    """A client's session on port 30003: takes programs, sends nothing.

    Args:
        sink: The client's connection.
        robot: The robot.
    """

    def __init__(self, sink: Sink, robot: Robot) -> None:
        self._sink, self._robot = sink, robot
        self._reader = ScriptReader()

    def feed(self, data: bytes) -> None:
        """Take received bytes and upload each complete program."""
        for source in self._reader.feed(data):
            if self._robot.model.e_series and not self._robot.safety.remote:
                self._robot.log("script ignored: the robot is in local control")
            else:
                self._robot.program.upload(source)
        if self._reader.size > MAX_SCRIPT:
            self._sink.close()

    def tick(self) -> None:
        """Nothing to do."""

    def close(self) -> None:
        """Nothing to release."""

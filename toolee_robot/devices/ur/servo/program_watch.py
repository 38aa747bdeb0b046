"""A process that ends the robot's program when the servo process is gone without having seen that program end.

A servo process may lose the link, hang in a call and end itself, or be killed, with the robot's program still loaded.
If that plays, the robot's watchdog ends it. If the robot was stopped just before, the program is paused, its watchdog
does not count, and Play would move the arm on to an old position. Only the dashboard server is left to end it then,
and nobody in the servo process to ask for it. This process outlives both the servo process and the task.

It imports little, so that it costs little time and memory.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import suppress
from typing import Final

from toolee_robot.devices.ur.protocols.dashboard import DASHBOARD_PORT, DashboardReader
from toolee_robot.devices.ur.protocols.tcp import connect
from toolee_robot.devices.ur.servo.program_stop import RETRY, end_program
from toolee_robot.errors import DeviceError

PATIENCE: Final = 600.0
"""[s] on the wall clock for which the end of the program is asked for, as long as the dashboard does not confirm it."""
NOT_ENDED: Final = (
    "the dashboard server has not confirmed the end of the robot's program: if the robot was stopped too, stop the "
    "program at the pendant before you release the stop, or Play would move the arm on"
)

_ANSWER = 1.0  # [s] on the wall clock, for one attempt
_LOOK = 0.02  # [s] on the wall clock between two looks at the safety mode
_BEGUN, _ENDED = b"B", b"E"
_PROGRAM = "from toolee_robot.devices.ur.servo.program_watch import main; main()"


class ProgramWatch:
    """The watching process, for the task's process.

    Args:
        host: Address of the controller.
        delay: Time [s] on the wall clock from the servo process's end until the robot's program is ended: long enough
            for the robot's watchdog, with which a moving arm stops where it was sent last. An arm that the robot's
            safety system stops has its program ended at once.

    Attributes:
        fd: Descriptor that the servo process must inherit, and no other; see `WatchedProgram`.
    """

    def __init__(self, host: str, delay: float) -> None:
        self._host, self._delay, self._cancelled = host, delay, False
        read, self.fd = os.pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, str(read), host, str(delay)],
            pass_fds=(read,),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
        )
        os.close(read)

    def hand_over(self) -> None:
        """Close this process's copy of `fd`, once the servo process has it."""
        os.close(self.fd)

    def ended(self, timeout: float) -> bool:
        """Whether the robot's program has ended; to be called once the servo process is gone.

        Args:
            timeout: Longest wait for it [s] on the wall clock, beside the delay.

        Returns:
            Whether it has, never existed, or is no longer watched. If not, this process goes on trying.
        """
        if self._cancelled:
            return True
        try:
            code = self._process.wait(self._delay + timeout)
        except subprocess.TimeoutExpired:
            return False
        # Killed as well: what it would have done is left to this process.
        return code == 0 or end_program(self._host, timeout)

    def cancel(self) -> None:
        """Give up; before another program of this driver begins, which must not be ended. Idempotent."""
        self._cancelled = True
        self._process.kill()
        self._process.wait()


class WatchedProgram:
    """The servo process's notes for the watching process; never waits.

    Args:
        fd: Descriptor of `ProgramWatch`. That this process is gone shows by its closing.
    """

    def __init__(self, fd: int) -> None:
        self._fd = fd
        os.set_blocking(fd, False)

    def begun(self) -> None:
        """Note that this process's program runs on the robot."""
        self._write(_BEGUN)

    def ended(self) -> None:
        """Note that the robot has reported the program's end."""
        self._write(_ENDED)

    def _write(self, note: bytes) -> None:
        with suppress(OSError):  # the watching process was killed
            os.write(self._fd, note)


def main() -> None:
    """Watch until the program has ended; exits with 0 if it has.

    Command-line arguments: descriptor of the servo process's notes, host, delay [s].
    """
    fd, host, delay = int(sys.argv[1]), sys.argv[2], float(sys.argv[3])
    exists = False
    while note := os.read(fd, 1):
        exists = note == _BEGUN
        if note == _ENDED:
            return
    if not exists:
        return
    give_up = time.monotonic() + PATIENCE
    _await_watchdog(host, time.monotonic() + delay)
    while not end_program(host, _ANSWER):
        if time.monotonic() > give_up:
            sys.exit(1)
        time.sleep(RETRY)


def _await_watchdog(host: str, deadline: float) -> None:
    """Wait until `deadline` [s], a value of `time.monotonic()`, or until the robot's safety system stops the arm."""
    with suppress(DeviceError), connect(host, DASHBOARD_PORT, deadline) as sock:
        reader = DashboardReader(sock, deadline)
        while time.monotonic() < deadline:
            mode = reader.ask("safetymode", deadline)
            if mode is not None and not mode.upper().endswith(("NORMAL", "REDUCED")):
                return
            time.sleep(_LOOK)
    time.sleep(max(deadline - time.monotonic(), 0.0))

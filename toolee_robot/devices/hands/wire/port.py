"""A serial port with the errors of a hand's: it cannot be opened, or is gone."""

from __future__ import annotations

import termios
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import serial
from serial.tools.list_ports import comports

from toolee_robot.errors import NoAnswerError, words_of

_READ_TIME = 0.01
_BY_ID = Path("/dev/serial/by-id")
"""Where Linux names serial ports by what is plugged in."""


class SerialPort:
    """The serial port of a hand; one thread may use it.

    Args:
        port: Path of the port.
        baud_rate: Its rate [bit/s], 8 data bits, no parity, 1 stop bit.
        write_time: Longest time for sending [s].

    Attributes:
        path: Path of the port.

    Raises:
        NoAnswerError: The port cannot be opened.
    """

    def __init__(self, port: str, baud_rate: int, write_time: float) -> None:
        self.path = port
        try:
            self._serial = serial.Serial(port, baud_rate, timeout=_READ_TIME, write_timeout=write_time, exclusive=True)
        except (OSError, ValueError, termios.error) as error:  # pyserial's errors are OSErrors
            raise NoAnswerError(
                f"cannot open the hand's port {port} ({words_of(error)}; this computer has "
                f"{', '.join(serial_ports()) or 'no serial port'}): check hand.port, the cable, your rights to the "
                "port, and that no other program uses it",
                code="no_answer.hand_port",
            ) from error

    def close(self) -> None:
        """Release the port; nothing is said to the hand."""
        self._serial.close()

    def send(self, data: bytes) -> bool:
        """Send bytes.

        Args:
            data: The bytes.

        Returns:
            Whether they went out in time; otherwise they lie in the host's buffer.

        Raises:
            NoAnswerError: The port is gone.
        """
        with self._watched():
            try:
                self._serial.write(data)
            except serial.SerialTimeoutException:
                return False
        return True

    def receive(self) -> bytes:
        """Return what has come; wait for the first byte for 0.01 s at most.

        Returns:
            The bytes; none if none came.

        Raises:
            NoAnswerError: The port is gone.
        """
        with self._watched():
            return self._serial.read(max(1, self._serial.in_waiting))

    def drop_received(self) -> None:
        """Forget what has come.

        Raises:
            NoAnswerError: The port is gone.
        """
        with self._watched():
            self._serial.reset_input_buffer()

    @contextmanager
    def _watched(self) -> Iterator[None]:
        try:
            yield
        except (OSError, termios.error, TypeError) as error:  # TypeError: pyserial, of a port that was closed meanwhile
            message = f"the hand's port {self.path} is gone ({words_of(error)}): plug the cable in, then start again"
            raise NoAnswerError(message, code="no_answer.hand_unplugged") from error


def serial_ports() -> list[str]:
    """Find the serial ports of this computer.

    Returns:
        Their paths: those that stay the same, where the system has such, else those of the devices.
    """
    try:
        named = sorted(str(path) for path in _BY_ID.iterdir())
    except OSError:  # there is no such folder, or no more: it goes with the last device
        named = []
    return named or sorted(port.device for port in comports())

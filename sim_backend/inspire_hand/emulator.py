"""The emulated RH56, on a pseudo-terminal or on Modbus-TCP."""

from __future__ import annotations

from functools import partial

from toolee_robot.robots.hands.inspire import joints_of_counts
from toolee_robot.sim_backend.hand_wire import (
    ACKNOWLEDGE,
    Frame,
    HandTime,
    LineEmulator,
    LineFaults,
    PseudoTerminal,
    TcpServer,
    Wire,
    WriteFault,
)
from toolee_robot.sim_backend.inspire_hand import modbus, requests
from toolee_robot.sim_backend.inspire_hand.hand import NAMES, Hand
from toolee_robot.sim_backend.inspire_hand.motor import OVERHEATED

TURNAROUND = 0.0041
"""Time that the hand takes for a reply [s]: with the 29 bytes of a read of 12 bytes, the measured 6.6 ms."""
BYTE_TIME = 10.0 / 115200.0
"""Time of a byte on the line [s]."""
TCP_TURNAROUND = 0.002
"""Time that a hand with Ethernet takes for a reply [s]: assumed."""
TCP_BYTE_TIME = 8.0e-8
"""Time of a byte at 100 Mbit/s [s]."""
ERRORS = tuple(bits for bits in range(1, 32) if not bits & OVERHEATED)
"""Values of ERROR that stay until they are cleared; heat goes with the temperature."""
GRACE = 0.3
"""Time after the end of a connection for which a hand was seen to end the next one at once [s]."""


class _Emulator(LineEmulator[Hand]):
    label = "Inspire RH56"
    motors, thumb = NAMES, "thumb_bend"
    joints = staticmethod(joints_of_counts)
    events = "heat MOTOR DEGREES, jam MOTOR, free MOTOR, error MOTOR BITS"
    line_events = (*LineEmulator.line_events, *WriteFault, ACKNOWLEDGE)

    def __init__(
        self, number: int, wire: Wire, faults: LineFaults, turnaround: float, byte_time: float, pace: float
    ) -> None:
        self.time = HandTime(pace)
        hand = Hand(self.time, number)
        super().__init__(hand, wire, faults, turnaround, byte_time, pace)

    def happen(self, event: str, motor: int | None, *words: str) -> None:
        """Let a motor get hot, jam, come free, or report errors.

        Args:
            event: Its first word, one of `events`.
            motor: The motor that it names; None without one.
            words: What follows.

        Raises:
            ValueError: There is no such event, or a word is wrong.
        """
        if motor is None or event not in ("heat", "jam", "free", "error") or len(words) != (event in ("heat", "error")):
            raise ValueError(event)
        if event == "error" and int(words[0]) not in ERRORS:
            raise ValueError(words[0])

        def change(hand: Hand) -> None:
            hand.run()
            if event == "heat":
                hand.motors[motor].temperature = float(words[0])
            elif event == "error":
                hand.motors[motor].error |= int(words[0])
            else:
                hand.motors[motor].jammed = event == "jam"

        self.tell(change)


class InspireEmulator(_Emulator):
    """An Inspire RH56 on RS-485, a pseudo-terminal, that a driver finds at `port`.

    Args:
        number: The hand's number on the line.
        seed: Seed of the line's noise.
        pace: Rate of the motors' time relative to the host's; the line keeps to the host's.
    """

    def __init__(self, number: int = 1, seed: int = 0, pace: float = 1.0) -> None:
        faults = LineFaults(requests.foreign, seed)
        super().__init__(number, PseudoTerminal(), faults, TURNAROUND, BYTE_TIME, pace)
        self._parser = requests.RequestParser(number)

    def _answer(self, data: bytes) -> list[Frame]:
        frames = []
        for request in self._parser.take(data):
            carry_out = partial(requests.answer, self._hand, request)
            writes = isinstance(request, requests.WriteRequest)
            frames += self.faults.write(carry_out) if writes else carry_out()
        self._parser.number = self._hand.number
        return frames


class ModbusEmulator(_Emulator):
    """An Inspire RH56 on Modbus-TCP that a driver finds at `port`.

    Args:
        address: Host and port to listen at; port 0 for a free one.
        number: The hand's unit identifier.
        seed: Seed of the line's noise.
        pace: Rate of the motors' time relative to the host's; the line keeps to the host's.

    Attributes:
        server: What answers the requests.

    Raises:
        UserError: It cannot listen there.
    """

    label = "Inspire RH56 on Modbus-TCP"
    events = f"{_Emulator.events}, shift TRANSACTIONS, refuse EXCEPTION, refuse EXCEPTION TIMES"
    line_events = tuple(event for event in _Emulator.line_events if event != "echo")

    def __init__(
        self, address: tuple[str, int] = ("127.0.0.1", 0), number: int = 1, seed: int = 0, pace: float = 1.0
    ) -> None:
        faults = LineFaults(modbus.foreign, seed, modbus.FRAMING)
        super().__init__(number, TcpServer(address, GRACE), faults, TCP_TURNAROUND, TCP_BYTE_TIME, pace)
        self.server = modbus.ModbusServer(self._hand, faults)

    def happen(self, event: str, motor: int | None, *words: str) -> None:
        """Let a motor get hot, jam, come free, or report errors, shift transaction identifiers, or refuse requests.

        Args:
            event: Its first word, one of `events`.
            motor: The motor that it names; None without one.
            words: What follows.

        Raises:
            ValueError: There is no such event, or a word is wrong.
        """
        if motor is None and event == "shift" and len(words) == 1:
            self.server.shift = int(words[0])
        elif motor is None and event == "refuse" and len(words) in (1, 2):
            code, times = (int(word) for word in (*words, "1")[:2])
            if not 1 <= code <= 255:
                raise ValueError(event)
            self.server.refusals.extend([code] * times)
        else:
            super().happen(event, motor, *words)

    def _connected(self) -> None:
        self.server.reset()

    def _answer(self, data: bytes) -> list[Frame]:
        return [Frame(reply) for reply in self.server.take(data)]

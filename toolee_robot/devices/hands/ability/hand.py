"""The Ability Hand as a `hal.Hand`."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from toolee_robot.devices.hands.ability.faults import HEAT, LAPSE, NO_PADS, Heat, heat_error
from toolee_robot.devices.hands.ability.line import HandLine
from toolee_robot.devices.hands.ability.replies import Limited
from toolee_robot.devices.hands.ability.touch import Touch
from toolee_robot.devices.hands.wire.driver import MOTION_TIME, WiredHand
from toolee_robot.devices.hands.wire.grip import GripRule
from toolee_robot.devices.hands.wire.motion import Motion
from toolee_robot.devices.hands.wire.setpoints import Setpoints
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, HandState
from toolee_robot.robots.hands import HandModel
from toolee_robot.robots.hands.ability import CLOSED, MOTORS, OPEN, RANGE, joints_of_closures
from toolee_robot.runtime.clock import HostClock

APPROACH_SPEED, FINISH_SPEED, OPENING_SPEED = 120.0, 20.0, 240.0
"""Speeds of the fingers until they touch, of their pressing, and of opening [deg/s]."""
FOLLOW_SPEED = 60.0
"""Speed with which fingers that hold something follow it when it gives way, until they touch it again [deg/s]: the 4
deg which say that it has slipped take 0.07 s."""
LEAD = 12.0
"""Largest way by which a setpoint is ahead of a motor [deg]."""
SILENT_MOST = 0.25
"""Longest time between two commands for which the hand has certainly not left its API mode, which takes 0.3 s: of the
host's time, as the station's may stand still in a simulation; in a rehearsal, which is slower, of the station's [s]."""
OPENED = 5.0
"""Largest distance from the open hand's closure that counts as open [deg]."""
REACTION = 0.03
"""Time from a command until a motor follows it [s]: assumed."""
STILL = 0.5
"""Way of a motor that counts as none [deg]; at the slowest speed in use it is 2 within STANDS_FOR."""
OPEN_STILL = 15.0
"""Closure below which a finger that the hand has stopped has not closed on anything [deg]."""
ATTEMPTS = 4
"""Attempts to open a finger: going back after a collision may count as another one."""
_FINGERS, _THUMB, _ROTATOR = [0, 1, 2, 3], MOTORS.index("thumb flexor"), MOTORS.index("thumb rotator")
_ALL = [*_FINGERS, _THUMB, _ROTATOR]
_SIGNS = np.array([1.0, 1.0, 1.0, 1.0, 1.0, -1.0])
TOUCHES = 0.6
"""Force of a finger's pads that counts as touch [N]; the pads are not calibrated."""
RULE = GripRule((0, 1, 2, 3), _THUMB, touches=TOUCHES, shut=CLOSED[0] - 2.0, slipped=4.0, unit="deg")
"""A grip: a finger within 2 deg of its end is shut, one that has closed by 4 deg says that the tool has slipped."""
_FINGER_OF_MOTOR = {"index": 0, "middle": 1, "ring": 2, "little": 3, "thumb": _THUMB}


@dataclass(frozen=True)
class Reading:
    """What the hand said.

    Attributes:
        stamp: Time at which it was asked, at the earliest [s].
        number: Number of the reading, from 1.
        closures: How far each motor is closed, (6,) [deg].
        forces: Force on each motor's pads, (6,) [N]; the rotator has none.
        limited: Motors that protect themselves.
        fault: The gravest fault; None without one.
    """

    stamp: float
    number: int
    closures: Array
    forces: Array
    limited: Limited
    fault: DeviceError | None

    @property
    def barred(self) -> NDArray[np.bool_]:
        """Which motors protect themselves, (6,)."""
        return np.array([bool(self.limited >> motor & 1) for motor in range(len(MOTORS))])


class AbilityHand(WiredHand[HandLine, Reading]):
    """A PSYONIC Ability Hand on a serial port; use it in its `with` block. Entering it moves nothing.

    Its first motion takes the hand into its API mode; from then on a command goes out every 10 ms, and the block keeps
    it up. 0.3 s after the last one the hand leaves that mode, **possibly with motion**: when the block ends, when the
    program dies, when the cable is pulled, whatever holds the tool then is not this driver.

    Its two speeds: the fingers close until they touch, then press slowly until the hand itself stops them, and the
    thumb after them. The drives hold without power what they have gripped. A grip is kept up: a finger whose force has
    fallen closes further, which takes a moment of opening, and one that has closed by more than a little says that the
    tool has slipped, which `state` reports as a fault until the hand is opened or closed again.

    The maker publishes no force of its grip: do not let it hold a hammer that strikes without a strap or a mount.

    Args:
        model: The hand: `hand_model(config.hand)`.
        port: The serial port.
        clock: Clock of the station, the host's.
        hand_id: The hand's address on the line.
    """

    def __init__(self, model: HandModel, port: str, clock: Clock, hand_id: int = 0x50) -> None:
        super().__init__(model, clock, RULE, STILL)
        self._port, self._address = port, hand_id
        self._silent_most = clock.to_wall_time(SILENT_MOST) if isinstance(clock, HostClock) else SILENT_MOST
        self._touch, self._heat = Touch(), Heat()
        self._setpoints: Setpoints | None = None
        self._closures: Array | None = None
        self._asked = -np.inf
        self._lapsed = False

    def state(self, max_age: float = 0.1) -> HandState:
        """Return the newest state; it may be asked from any thread at any time.

        Args:
            max_age: Largest age of the reading [s].

        Returns:
            The joints as the motors' positions and the couplings give them, the forces of thumb and fingers by the
            maker's rough conversion, and whether it holds something, averaged over 0.1 s. No temperature: the hand
            tells none.

        Raises:
            StaleDataError: The hand has been silent for longer than `max_age`.
            NoAnswerError: Its port is gone.
            DeviceError: It is closed.
        """
        reading = self._opened().newest(max_age)
        fault = HEAT if reading.fault is not None else ""
        return HandState(
            self._joints(reading, joints_of_closures),
            {finger: float(reading.forces[motor]) for finger, motor in _FINGER_OF_MOTOR.items()},
            self._grip.holding,
            fault=", ".join(filter(None, (fault, LAPSE if self._lapsed else "", self._grip.slipped))),
        )

    def open(self, timeout: float = MOTION_TIME) -> None:
        """Open the thumb, then the fingers; the thumb stays before the palm.

        Args:
            timeout: Time for the motion [s].

        Raises:
            DeviceError: The motion timed out, something blocks a finger, a motor has a fault, or `stop` ended it.
        """
        with self._motion(timeout) as motion:  # whatever is wrong: a person waits for the tool
            self._grip.end()
            self._lapsed = False
            for motors in ([_THUMB], _ALL):
                self._go(motors, np.array(OPEN), OPENING_SPEED)
                motion.until_still()
                self._free_what_is_stuck(motion, motors)
            short = self._short(motion.reading, _ALL)
            if short:
                motion.refuse_faults()
                names = ", ".join(MOTORS[motor] for motor in short)
                message = f"something blocks the hand, or it is too hot: {names} did not open; look at it"
                raise DeviceError(message, code="device.hand_blocked")

    def close(self, timeout: float = MOTION_TIME) -> None:
        """Close the fingers, then the thumb, until they hold something or are shut.

        Args:
            timeout: Time for the motion [s].

        Raises:
            DeviceError: The motion timed out, a motor has a fault, or `stop` ended it; the hand keeps its grip.
        """
        with self._motion(timeout) as motion:
            motion.refuse_faults()
            self._grip.end()
            self._lapsed = False
            if abs(motion.reading.closures[_ROTATOR] - CLOSED[_ROTATOR]) > OPENED:  # the thumb turns before it bends
                self._go([_ROTATOR], np.array(CLOSED), OPENING_SPEED)
                motion.until_still(_ROTATOR)
            for motors in (_FINGERS, [_THUMB]):
                self._go(motors, np.array(CLOSED), APPROACH_SPEED)
                motion.until_still()
            reading = motion.reading
            stuck = reading.barred & (reading.closures < OPEN_STILL) & (reading.forces <= TOUCHES)
            if stuck[[*_FINGERS, _THUMB]].any():
                names = ", ".join(MOTORS[motor] for motor in np.flatnonzero(stuck))
                message = f"something blocks the hand, or it is too hot: {names} did not close; look at it"
                raise DeviceError(message, code="device.hand_stall")
            self._grip.begin(reading)

    def _go(self, motors: list[int], targets: Array, speed: float) -> None:
        """Send motors to targets, unless the hand is to stop."""

        def go(_line: HandLine) -> None:
            if self._stopped.is_set() or self._closures is None:
                return
            if self._setpoints is None:
                self._setpoints = Setpoints(self._closures, LEAD)
            self._setpoints.go(motors, targets, speed)

        self._opened().run(go)

    def _free_what_is_stuck(self, motion: Motion[HandLine, Reading], motors: list[int]) -> None:
        """A finger that should open and does not may be told so again after it was told to close."""
        for _ in range(ATTEMPTS):
            stuck = [motor for motor in self._short(motion.reading, motors) if motion.reading.barred[motor]]
            if not stuck:
                return

            def free(_line: HandLine, stuck: list[int] = stuck) -> None:
                if self._setpoints is not None and self._closures is not None:
                    self._setpoints.free(stuck, self._closures, -1.0)

            self._opened().run(free)
            self._go(motors, np.array(OPEN), OPENING_SPEED)
            motion.until_still()

    def _short(self, reading: Reading, motors: list[int]) -> list[int]:
        return [motor for motor in motors if abs(reading.closures[motor] - OPEN[motor]) > OPENED]

    def _connect(self) -> HandLine:
        self._touch, self._heat, self._setpoints, self._lapsed = Touch(), Heat(), None, False
        return HandLine(self._port, self._address, self._clock)

    def _read(self, line: HandLine, number: int) -> Reading:
        """Send the next command, and take the reply to it: in the poller's thread, silent or not."""
        host = time.monotonic()
        if self._setpoints is not None and host - self._asked > self._silent_most:
            # The hand may have left its API mode and moved: it stays where it is now.
            self._lapsed, self._setpoints = True, None
        self._asked = host
        command = None
        if self._setpoints is not None and self._closures is not None:
            command = tuple(_SIGNS * self._setpoints.advance(self._clock.now(), self._closures))
        answer = line.exchange(command) if number > 1 else line.find()
        reply = answer.reply
        if number == 1 and not any(reply.touch):
            raise DeviceError(NO_PADS, code="device.hand_no_pads")
        closures = _SIGNS * reply.positions
        forces = np.append(self._touch.newtons(np.array(reply.touch)), 0.0)
        hot = self._heat.judge(answer.stamp, reply.limited)
        self._closures = closures
        if self._setpoints is None and self._lapsed:
            self._setpoints = Setpoints(closures, LEAD)
        return Reading(answer.stamp, number, closures, forces, reply.limited, heat_error() if hot else None)

    def _watch(self, reading: Reading, line: HandLine) -> None:  # noqa: ARG002
        """With every reading, in the poller's thread: slow what touches, let go of nothing, judge the grip."""
        self._note(reading)
        relaxed = self._grip.follow(reading)
        setpoints = self._setpoints
        if setpoints is None:
            return
        closing = setpoints.moving & (setpoints.way > 0.0)
        setpoints.slow(closing & (reading.forces > TOUCHES), FINISH_SPEED)
        if relaxed:
            setpoints.free(relaxed, reading.closures, 1.0)
            setpoints.go(relaxed, np.array(CLOSED), FOLLOW_SPEED)

    def _freeze(self, line: HandLine) -> None:  # noqa: ARG002
        """Let every motor stay where it will have stopped; what presses keeps its force without being told."""
        if self._setpoints is None or not self._recent:
            return
        now = self._recent[-1]
        reached = now.closures + self._speeds() * REACTION
        self._setpoints.hold(np.ones(len(MOTORS), bool), np.clip(reached, 0.0, RANGE))

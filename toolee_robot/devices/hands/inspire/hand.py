"""The Inspire RH56 as a `hal.Hand`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from toolee_robot.devices.hands.inspire.forces import newtons
from toolee_robot.devices.hands.inspire.line import HandLine
from toolee_robot.devices.hands.inspire.modbus_line import ModbusLine
from toolee_robot.devices.hands.inspire.registers import (
    ANGLE_ACT,
    ANGLE_SET,
    ANGLES_LENGTH,
    CLEAR_ERROR,
    CONDITION_LENGTH,
    FORCE_ACT,
    FORCE_SET,
    FULL,
    SPEED_SET,
    Condition,
    pack,
    unpack_angles,
    unpack_condition,
)
from toolee_robot.devices.hands.inspire.serial_line import SerialLine
from toolee_robot.devices.hands.inspire.tcp_port import is_tcp
from toolee_robot.devices.hands.wire.driver import MOTION_TIME, WiredHand
from toolee_robot.devices.hands.wire.grip import GripRule
from toolee_robot.errors import DeviceError, NoAnswerError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, HandState
from toolee_robot.robots.hands import HandModel
from toolee_robot.robots.hands.inspire import CLOSED, MOTORS, OPEN, joints_of_counts

Counts = tuple[int, int, int, int, int, int]

APPROACH_SPEED, FINISH_SPEED = 300, 25
"""Speeds of the fingers until they touch, and of their pressing [counts; 1000 is the whole range in 0.8 s]. Above 25 a
finger overshoots its force threshold: of one of 500 by 115 % at 250 and by 5 % at 25 (measured)."""
FOLLOW_SPEED = 150
"""Speed with which fingers that hold something follow it when it gives way [counts]: the 40 counts that say that it has
slipped take 0.2 s, at 25 they would take 1.3 s. A finger that meets it again overshoots the grip force by 40 %
(between the two that were measured), which the hand can press."""
TOUCH_FORCE, GRIP_FORCE = 100, 800
"""Force thresholds of the two [counts, about 0.01 N each]."""
OPENED = 50
"""Largest distance from the open hand's angle that counts as open [counts]."""
REACTION = 0.07
"""Time from a command until a motor follows it [s]."""
PRESSES = 50
"""Force above which a motor that closes is left to press when the hand is stopped [counts]."""
UNTAKEN = f"it does not take the command to close further (register {ANGLE_SET})"
"""Fault of a hand that answers and lets its grip go slack, for people."""
_BEND, _ROTATION = MOTORS.index("thumb bend"), MOTORS.index("thumb rotation")
STILL = 2
"""Way of a motor that counts as none [counts]; at the slowest speed in use it is 3 within STANDS_FOR."""
RULE = GripRule(fingers=(0, 1, 2, 3), thumb=_BEND, touches=100.0, shut=FULL - 30.0, slipped=40.0, unit="of 1000")
"""A grip: forces above 100 counts, some 1 N; a finger within 30 counts of its end is shut; 40 counts are some 3 deg."""
_FINGER_OF_MOTOR = {"little": 0, "ring": 1, "middle": 2, "index": 3, "thumb": _BEND}


@dataclass(frozen=True)
class Reading:
    """What the hand said.

    Attributes:
        stamp: Time at which it was asked [s].
        number: Number of the reading, from 1.
        angles: Angles of the six motors [counts].
        condition: Forces, currents, faults, states, temperatures.
    """

    stamp: float
    number: int
    angles: tuple[int, ...]
    condition: Condition

    @property
    def closures(self) -> Array:
        """How far each motor is closed, (6,) [counts]."""
        return FULL - np.array(self.angles, float)

    @property
    def forces(self) -> Array:
        """Forces, (6,) [counts]."""
        return np.array(self.condition.forces, float)

    @property
    def fault(self) -> DeviceError | None:
        """The gravest fault; None without one."""
        return self.condition.error


class InspireHand(WiredHand[HandLine[Any], Reading]):
    """An Inspire RH56 on a serial port or on Modbus-TCP; use it in its `with` block. Entering it moves nothing.

    Its speeds: the fingers close until they touch, press slowly up to the grip force, and follow faster what gives way
    in them. A grip is kept up: a finger whose force has fallen closes further, and one that has closed by more than a
    little says that the tool has slipped, which `state` reports as a fault until the hand is opened or closed again; so
    is a hand that does not take the command to close further, until it takes one. No
    fault is cleared by itself: `clear_faults` does, after a person has looked.

    Its fingers press with 7 to 13 N: they do not hold a hammer that strikes. Use a strap or a mount.

    Args:
        model: The hand: `hand_model(config.hand)`.
        port: The serial port, or `tcp://HOST:PORT` for a hand with Ethernet.
        clock: Clock of the station, the host's.
        hand_id: The hand's number on the line, of Modbus its unit identifier.
    """

    def __init__(self, model: HandModel, port: str, clock: Clock, hand_id: int = 1) -> None:
        super().__init__(model, clock, RULE, STILL)
        self._port, self._hand_id = port, hand_id
        self._target: Counts | None = None
        self._untaken = ""

    def state(self, max_age: float = 0.1) -> HandState:
        """Return the newest state; it may be asked from any thread at any time.

        Args:
            max_age: Largest age of the reading [s].

        Returns:
            The joints as the motors' angles and the couplings give them, the forces of thumb and fingers as measured on
            one hand, the highest of the six temperatures, and whether it holds something, averaged over 0.1 s.

        Raises:
            StaleDataError: The hand has been silent for longer than `max_age`.
            NoAnswerError: Its port is gone.
            DeviceError: It is closed.
        """
        reading = self._opened().newest(max_age)
        condition = reading.condition
        forces = {finger: newtons(finger, condition.forces[motor]) for finger, motor in _FINGER_OF_MOTOR.items()}
        return HandState(
            self._joints(reading, lambda closures: joints_of_counts(FULL - closures)),
            forces,
            self._grip.holding,
            temperature=float(max(condition.temperatures)),
            fault=", ".join(filter(None, (condition.described, self._grip.slipped, self._untaken))),
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
            self._untaken = ""
            a, b, c, d, _, rotation = motion.reading.angles
            self._command(FORCE_SET, (FULL,) * 6)
            self._command(SPEED_SET, (FULL,) * 6)
            self._move((a, b, c, d, OPEN[_BEND], rotation))
            motion.until_still(_BEND)
            self._move(OPEN)
            motion.until_still()
            at_goal = zip(MOTORS, motion.reading.angles, OPEN, strict=True)
            short = [name for name, at, goal in at_goal if abs(at - goal) > OPENED]
            if short:
                if motion.reading.fault is not None:
                    raise motion.reading.fault
                message = f"something blocks the hand: {', '.join(short)} did not open; look at it"
                raise DeviceError(message, code="device.hand_blocked")

    def close(self, timeout: float = MOTION_TIME) -> None:
        """Close fingers and thumb until they hold something or are shut.

        Args:
            timeout: Time for the motion [s].

        Raises:
            DeviceError: The motion timed out, a motor has a fault, or `stop` ended it; the hand keeps its grip.
        """
        with self._motion(timeout) as motion:
            motion.refuse_faults()
            self._grip.end()
            self._untaken = ""
            self._command(FORCE_SET, (TOUCH_FORCE,) * 5 + (FULL,))
            self._command(SPEED_SET, (APPROACH_SPEED,) * 5 + (FULL,))
            if motion.reading.angles[_ROTATION] > OPENED:  # the thumb turns before it bends
                a, b, c, d, bend, _ = motion.reading.angles
                self._move((a, b, c, d, bend, CLOSED[_ROTATION]))
                motion.until_still(_ROTATION)
            self._move(CLOSED)
            motion.until_still()
            self._command(FORCE_SET, (GRIP_FORCE,) * 5 + (FULL,))
            self._command(SPEED_SET, (FINISH_SPEED,) * 5 + (FULL,))
            self._move(CLOSED)
            motion.until_still()
            if self._grip.begin(motion.reading):
                self._command(SPEED_SET, (FOLLOW_SPEED,) * 5 + (FULL,))

    def clear_faults(self) -> None:
        """Clear what is wrong, after a person has looked; heat has to go by itself.

        Raises:
            DeviceError: The hand does not take it.
        """
        self._opened().run(lambda line: line.write(CLEAR_ERROR, line.one))

    def _command(self, register: int, values: tuple[int, ...]) -> None:
        self._opened().run(lambda line: line.write(register, pack(values, line.order)))

    def _move(self, target: Counts) -> None:
        """Set the motors' targets; the hand is known to have them only once it has acknowledged them."""

        def write(line: HandLine[Any]) -> None:
            if self._stopped.is_set():
                return
            line.write(ANGLE_SET, pack(target, line.order))
            self._target = target

        self._opened().run(write)

    def _connect(self) -> HandLine[Any]:
        kind = ModbusLine if is_tcp(self._port) else SerialLine
        return kind(self._port, self._hand_id)

    def _read(self, line: HandLine[Any], number: int) -> Reading:
        stamp = self._clock.now()
        angles = unpack_angles(line.read(ANGLE_ACT, ANGLES_LENGTH), line.order)
        condition = unpack_condition(line.read(FORCE_ACT, CONDITION_LENGTH), line.order)
        return Reading(stamp, number, angles, condition)

    def _freeze(self, line: HandLine[Any]) -> None:
        """Set new targets: a speed of zero is no stop, the hand was seen to move on.

        A motor that moves gets the angle as target that it will have reached when it hears of it, so that none turns
        back.
        """
        if not self._recent or self._target is None:
            return
        now = self._recent[-1]
        target, angles = np.array(self._target), np.array(now.angles)
        reached = np.clip(angles - self._speeds() * REACTION, *np.sort([angles, target], axis=0))
        presses = (target < angles) & (np.array(now.condition.forces) > PRESSES)
        a, b, c, d, e, f = (int(count) for count in np.clip(np.where(presses, target, np.rint(reached)), 0, FULL))
        line.write(ANGLE_SET, pack((a, b, c, d, e, f), line.order))
        self._target = (a, b, c, d, e, f)

    def _watch(self, reading: Reading, line: HandLine[Any]) -> None:
        """With every reading, in the poller's thread: judge the grip, and keep it up."""
        self._note(reading)
        if self._grip.follow(reading) and self._target is not None:
            try:
                line.write(ANGLE_SET, pack(self._target, line.order), again=True)
            except NoAnswerError:
                self._untaken = UNTAKEN  # what is raised here is forgotten with the next reading
                raise
            self._untaken = ""

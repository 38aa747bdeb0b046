"""The Shadow Hand as a `hal.Hand`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolee_robot.devices.hands.shadow.line import HandLine
from toolee_robot.devices.hands.shadow.reading import AT_CLOSED, AT_OPEN, FLEXORS, PREFIXES, WAYS, Reading, named
from toolee_robot.devices.hands.wire.driver import MOTION_TIME, WiredHand
from toolee_robot.devices.hands.wire.grip import GripRule
from toolee_robot.devices.hands.wire.setpoints import Setpoints
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, HandState
from toolee_robot.robots.hands import HandModel
from toolee_robot.robots.hands.shadow import MAKER_SIGNS, MOTORS, joints_of_motors
from toolee_robot.types import HandEfforts, JointState

APPROACH_SPEED, FINISH_SPEED, OPENING_SPEED = 70.0, 15.0, 100.0
"""Speeds of the motors until they touch, of their pressing, and of opening [deg/s]; those of two joints, and the
thumb's, are twice as fast. The maker's description allows a finger's joint 115 and the thumb's 230."""
LEAD = 15.0
"""Largest way by which a setpoint is ahead of a motor [deg]."""
OPENED = 5.0
"""Largest distance from the open hand's position that counts as open [deg]."""
REACTION = 0.04
"""Time from a command until a motor follows it [s]: assumed."""
IMPACT_TIME = 0.08
"""Time from a touch for which the effort is that of the approach's speed [s]: two reactions."""
STILL = 0.5
"""Way of a motor that counts as none [deg]; at the slowest speed in use it is 1.5 within STANDS_FOR."""
STUCK = 15.0
"""Way within which a finger's motor that was told to close has not closed on anything [deg]."""
RULE = GripRule((0, 1, 2, 3), 4, touches=1.0, shut=float(WAYS[0]) - 6.0, slipped=8.0, unit="deg")
"""A grip of the five fingers, by `Reading.fingers`: a finger within 6 deg of its end is shut, one that has closed by 8
deg, both its motors together, says that the tool has slipped."""
_THUMB = [motor for motor, name in enumerate(MOTORS) if name.startswith("TH")]
_OTHERS = [motor for motor, name in enumerate(MOTORS) if not name.startswith("TH")]
_ALL = [*range(len(MOTORS))]
_WRIST = [motor for motor, name in enumerate(MOTORS) if name.startswith("WR")]
_TWICE = 1.0 + np.array([name.endswith("J0") or name.startswith("TH") for name in MOTORS])
_PRESSING = np.isin(_ALL, np.concatenate(FLEXORS))
_BENDING = np.isin(_ALL, np.concatenate(FLEXORS[:4]))


class ShadowHand(WiredHand[HandLine, Reading]):
    """A right Shadow Hand behind a rosbridge; use it in its `with` block. Entering it moves nothing.

    Its two speeds: the fingers close until their motors' strain gauges feel a touch, then press slowly up to the grip's
    effort, and the thumb after them. A grip is kept up: a finger whose effort has fallen closes further, and one that
    has closed by more than a little says that the tool has slipped, which `state` reports as a fault until the hand is
    opened or closed again. The hand's own controllers keep positions and grip when the block ends, when the program
    dies, and when the network is gone.

    rosbridge acknowledges nothing: a command counts as taken when the state of the hand's controllers shows it, and is
    sent again until then. While the hand is silent nothing is sent, so that no old command waits in the network.

    Args:
        model: The hand: `hand_model(config.hand)`.
        url: Address of the rosbridge, such as `ws://127.0.0.1:9090`.
        efforts: What the hand's efforts mean, as the lab has measured.
        clock: Clock of the station, the host's.
    """

    def __init__(self, model: HandModel, url: str, efforts: HandEfforts, clock: Clock) -> None:
        super().__init__(model, clock, RULE, STILL)
        self._url, self._efforts = url, efforts
        self._setpoints: Setpoints | None = None
        self._sent: Array | None = None
        self._touched_at = np.full(len(MOTORS), np.inf)

    def state(self, max_age: float = 0.1) -> HandState:
        """Return the newest state; it may be asked from any thread at any time.

        Args:
            max_age: Largest age of the reading [s].

        Returns:
            The joints as measured, the forces of thumb and fingers by the efforts that the lab has measured, the
            highest of the motors' temperatures, which are up to half a second old, and whether it holds something,
            averaged over 0.1 s.

        Raises:
            StaleDataError: The hand has been silent for longer than `max_age`, or repeats itself.
            NoAnswerError: The connection is gone.
            DeviceError: It is closed.
        """
        reading = self._opened().newest(max_age)
        touches = reading.fingers(self._efforts.touch).forces
        newtons = np.where(touches > RULE.touches, touches * self._efforts.touch * self._efforts.newtons_per_unit, 0.0)
        temperatures = [status.temperature for status in reading.told.motors.values() if status.temperature is not None]
        return HandState(
            JointState(reading.q, MAKER_SIGNS * reading.told.joints.velocity, reading.stamp),
            {finger: float(force) for finger, force in zip(PREFIXES, newtons, strict=True)},
            self._grip.holding,
            temperature=max(temperatures) if temperatures else None,
            fault=", ".join(filter(None, (reading.faults, self._grip.slipped))),
        )

    def open(self, timeout: float = MOTION_TIME) -> None:
        """Open the thumb, then the fingers; the wrist goes to its rest.

        Args:
            timeout: Time for the motion [s].

        Raises:
            DeviceError: The motion timed out, something blocks a finger, a motor has a fault, the hand does not take
                commands, or `stop` ended it.
        """
        with self._motion(timeout) as motion:  # whatever is wrong: a person waits for the tool
            self._grip.end()
            for motors in (_THUMB, _ALL):
                self._go(motors, AT_OPEN, OPENING_SPEED)
                motion.until_still()
            short = np.abs(motion.reading.closures - AT_OPEN) > OPENED
            short[_WRIST] = False  # the wrist gives way to whoever holds it
            if short.any():
                motion.refuse_faults()
                message = f"something blocks the hand: {named(short)} did not open; look at it"
                raise DeviceError(message, code="device.hand_blocked")

    def close(self, timeout: float = MOTION_TIME) -> None:
        """Close the fingers, then the thumb, until they hold something or are shut.

        Args:
            timeout: Time for the motion [s].

        Raises:
            DeviceError: The motion timed out, a motor has a fault, a finger does not move, the hand does not take
                commands, or `stop` ended it; the hand keeps its grip.
        """
        with self._motion(timeout) as motion:
            motion.refuse_faults()
            self._grip.end()
            if np.abs(motion.reading.closures - AT_OPEN)[_THUMB].max() > OPENED:  # out of the fingers' way
                self._go(_THUMB, AT_OPEN, OPENING_SPEED)
                motion.until_still()
            for motors in (_OTHERS, _THUMB):
                self._go(motors, AT_CLOSED, APPROACH_SPEED)
                motion.until_still(settled=self._presses)
            motion.refuse_faults()
            stuck = _BENDING & (motion.reading.closures - AT_OPEN < STUCK)
            if stuck.any():
                message = f"something blocks the hand: {named(stuck)} did not close; look at it"
                raise DeviceError(message, code="device.hand_stall")
            self._grip.begin(motion.reading.fingers(self._efforts.touch))

    def _go(self, motors: Sequence[int], targets: Array, speed: float) -> None:
        """Send motors to targets, unless the hand is to stop."""

        def go(_line: HandLine) -> None:
            if self._stopped.is_set() or not self._recent:
                return
            if self._setpoints is None:
                self._setpoints = Setpoints(self._recent[-1].closures, LEAD)
            self._setpoints.go([*motors], targets, speed * _TWICE[[*motors]])
            self._touched_at[[*motors]] = np.inf

        self._opened().run(go)

    def _presses(self, reading: Reading) -> bool:
        """Whether no motor is to press harder, or it cannot: one that presses hardly moves."""
        setpoints = self._setpoints
        if setpoints is None:
            return True
        going = _PRESSING & setpoints.moving & (setpoints.at - reading.closures < LEAD - STILL)
        return not going.any()

    def _connect(self) -> HandLine:
        self._setpoints, self._sent, self._recent = None, None, ()
        self._touched_at[:] = np.inf
        return HandLine(self._url, self._clock)

    def _read(self, line: HandLine, number: int) -> Reading:
        """Take the next reading: in the poller's thread."""
        told = line.find() if number == 1 else line.read()
        reading = Reading.of(told, number)
        if number == 1:
            self._note(reading)
        return reading

    def _watch(self, reading: Reading, line: HandLine) -> None:
        """With every reading, in the poller's thread: regulate what presses, judge the grip, send the next setpoint."""
        self._note(reading)
        relaxed = self._grip.follow(reading.fingers(self._efforts.touch))
        setpoints = self._setpoints
        if setpoints is None:
            return
        if relaxed:
            motors = [motor for finger in relaxed for motor in FLEXORS[finger]]
            setpoints.go(motors, AT_CLOSED, FINISH_SPEED * _TWICE[motors])
        self._regulate(setpoints, reading)
        at = setpoints.at.copy()
        setpoints.advance(self._clock.now(), reading.closures)
        moved = self._sent is None or not np.array_equal(at, setpoints.at)
        if moved or (reading.told.unshown is not None and not reading.ignored):
            self._sent = setpoints.at.copy()
            line.command(MAKER_SIGNS * joints_of_motors(self._sent))

    def _regulate(self, setpoints: Setpoints, reading: Reading) -> None:
        """Slow what touches, end what presses enough; a motor that has just touched begins from where it is."""
        closing = _PRESSING & setpoints.moving & (setpoints.way > 0.0)
        touching = closing & (reading.forces > self._efforts.touch)
        first = touching & np.isinf(self._touched_at)
        if first.any():
            targets = setpoints.at + setpoints.way
            setpoints.hold(first, reading.closures)
            motors = [int(motor) for motor in np.flatnonzero(first)]
            setpoints.go(motors, targets, FINISH_SPEED * _TWICE[motors])
            self._touched_at[first] = reading.stamp
        setpoints.slow(touching, FINISH_SPEED * _TWICE)
        at_rest = reading.stamp - self._touched_at > IMPACT_TIME
        setpoints.hold(touching & at_rest & (reading.forces >= self._efforts.grip), setpoints.at)

    def _freeze(self, line: HandLine) -> None:
        """Let every motor stay where it will have stopped; what presses goes on pressing."""
        if self._setpoints is None or not self._recent:
            return
        now = self._recent[-1]
        free = self._setpoints.moving & (now.forces <= self._efforts.touch)
        self._setpoints.hold(free, now.closures + self._speeds() * REACTION)
        self._setpoints.hold(self._setpoints.moving, self._setpoints.at)
        self._sent = self._setpoints.at.copy()
        line.command(MAKER_SIGNS * joints_of_motors(self._sent))

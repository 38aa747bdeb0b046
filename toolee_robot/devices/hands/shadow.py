"""Driver of the right Shadow Dexterous Hand, by the rosbridge of the computer that runs the maker's ROS software.

    with ShadowHand(hand_model(config.hand), "ws://127.0.0.1:9090", config.hand.efforts, HostClock()) as hand:
        hand.open()

Facts are from the maker's documentation ("Shadow Dexterous Hand", user guide, *Command Line Interface*, *Firmware*,
*Ranges*), and from its source code (shadow-robot/sr-ros-interface-ethercat, sr_core, sr_common, sr_interface), for ROS
1. No code here was ever run on such a hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from toolee_robot.devices.hands import WiredHandKind
from toolee_robot.devices.hands.grip import GripRule, Reading, Setpoints
from toolee_robot.devices.hands.polled import PolledHand
from toolee_robot.devices.hands.rosbridge import RosbridgeLine, Told
from toolee_robot.errors import ConfigError, DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock
from toolee_robot.robots import HandModel
from toolee_robot.robots.hands.shadow import CLOSED, MAKER_SIGNS, MOTORS, OPEN, joints_of_motors, motors_of_joints
from toolee_robot.station import HandConfig
from toolee_robot.types import HandEfforts

SHOWN_S = 0.3
"""Time in which the controllers' states show a command; they come at 50 Hz."""
MOTORS_S = 2.0
"""Longest time without a word of the motors' states, which come at 2 Hz."""
APPROACH_SPEED, FINISH_SPEED, OPENING_SPEED = 70.0, 15.0, 100.0
"""Speeds of the motors until they touch, of their pressing, and of opening [deg/s]; those of two joints, and the
thumb's, are twice as fast. The maker's description allows a finger's joint 115 and the thumb's 230."""
LEAD_DEG = 15.0
"""Largest way by which a setpoint is ahead of a motor."""
OPENED_DEG = 5.0
"""Largest distance from the open hand's position that counts as open."""
REACTION_S = 0.04
"""Time from a command until a motor follows it: assumed."""
IMPACT_S = 0.08
"""Time from a touch for which the effort is that of the approach's speed: two reactions."""
STILL_DEG = 0.5
"""Way of a motor that counts as none; at the slowest speed in use it is 1.5 within STANDS_S."""
STUCK_DEG = 15.0
"""Way within which a finger's motor that was told to close has not closed on anything."""
PREFIXES = {"index": "FF", "middle": "MF", "ring": "RF", "little": "LF", "thumb": "TH"}
"""Finger -> beginning of the names of its motors."""
FLEXORS = [
    *([MOTORS.index(f"{finger}J3"), MOTORS.index(f"{finger}J0")] for finger in ("FF", "MF", "RF", "LF")),
    [MOTORS.index(joint) for joint in ("THJ5", "THJ2", "THJ1")],
]
"""Motors that close each finger, in the order of PREFIXES."""
AT_OPEN, AT_CLOSED = np.array(OPEN), np.array(CLOSED)
RULE = GripRule(
    (0, 1, 2, 3), 4, touches=1.0, shut=float((AT_CLOSED - AT_OPEN)[FLEXORS[0]].sum()) - 6.0, slipped=8.0, unit="deg"
)
"""A grip of the five fingers, by `fingers_of`: a finger within 6 deg of its end is shut, one that has closed by 8 deg,
both its motors together, says that the tool has slipped."""
_THUMB = [motor for motor, name in enumerate(MOTORS) if name.startswith("TH")]
_OTHERS = [motor for motor, name in enumerate(MOTORS) if not name.startswith("TH")]
_ALL = [*range(len(MOTORS))]
_WRIST = [motor for motor, name in enumerate(MOTORS) if name.startswith("WR")]
_TWICE = 1.0 + np.array([name.endswith("J0") or name.startswith("TH") for name in MOTORS])
_PRESSING = np.isin(_ALL, np.concatenate(FLEXORS))
_BENDING = np.isin(_ALL, np.concatenate(FLEXORS[:4]))
_JOINTS = [np.flatnonzero(moved) for moved in np.array([motors_of_joints(q) for q in np.eye(len(MAKER_SIGNS))]).T]
"""Joints of each motor."""


def reading_of(told: Told) -> Reading[Told]:
    """Make a reading of what the hand said: closures and forces are the motors' angles [deg] and efforts, (20,)."""
    # Two coupled joints report their motor's effort each.
    forces = np.array([np.abs(told.effort[joints]).max() for joints in _JOINTS])
    temperatures = [motor.temperature for motor in told.motors.values() if motor.temperature is not None]
    troubles = [motor.trouble for motor in told.motors.values() if motor.trouble]
    fault: DeviceError | None = None
    if troubles:
        cold = [motor for motor in told.motors.values() if motor.trouble and not motor.hot]
        code, remedy = "device.hand_over_temperature", "let it cool down"
        if cold:
            code, remedy = "device.hand_motor", "check it in the maker's own interface"
        message = f"the hand reports a fault ({', '.join(troubles)}): {remedy}; a motor that is halted does not press"
        fault = DeviceError(message, code=code)
    if _ignored(told):
        troubles.append("its controllers do not follow commands")
        message = f"the hand: {troubles[-1]}; see that its trajectory controllers run and nothing else commands it"
        fault = fault or DeviceError(message, code="device.hand_command")
    if told.motors_age > MOTORS_S:
        troubles.append("it says nothing of its motors")
        message = f"the hand: {troubles[-1]}, so overheating would go unnoticed: check that /diagnostics is published"
        fault = fault or DeviceError(message, code="device.hand_motor")
    closures, temperature = motors_of_joints(MAKER_SIGNS * told.position), max(temperatures, default=None)
    return Reading(told.stamp, closures, forces, told, fault, ", ".join(troubles), temperature)


def fingers_of(reading: Reading[Told], touch: float) -> Reading[Told]:
    """The same by fingers: the sum of their motors' ways, (5,) [deg], and their strongest effort by that of a touch."""
    closures = np.array([(reading.closures - AT_OPEN)[motors].sum() for motors in FLEXORS])
    forces = np.array([reading.forces[motors].max() for motors in FLEXORS]) / touch
    return Reading(reading.stamp, closures, forces, reading.said, reading.fault)


class ShadowHand(PolledHand[RosbridgeLine, Told]):
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
        super().__init__(model, clock, RULE, STILL_DEG)
        self._url, self._efforts = url, efforts
        self._setpoints: Setpoints | None = None
        self._sent: Array | None = None
        self._touched_at = np.full(len(MOTORS), np.inf)

    def _spread(self, reading: Reading[Told]) -> tuple[Reading[Told], list[str]]:
        """The thumb first, then the fingers; the wrist goes to its rest."""
        for motors in (_THUMB, _ALL):
            self._go(motors, AT_OPEN, OPENING_SPEED)
            reading = self._until_still()
        short = np.abs(reading.closures - AT_OPEN) > OPENED_DEG
        short[_WRIST] = False  # the wrist gives way to whoever holds it
        return reading, _named(short)

    def _grasp(self, reading: Reading[Told]) -> tuple[Reading[Told], list[str]]:
        """The fingers first, then the thumb."""
        if np.abs(reading.closures - AT_OPEN)[_THUMB].max() > OPENED_DEG:  # out of the fingers' way
            self._go(_THUMB, AT_OPEN, OPENING_SPEED)
            self._until_still()
        for motors in (_OTHERS, _THUMB):
            self._go(motors, AT_CLOSED, APPROACH_SPEED)
            reading = self._until_still(settled=self._presses)
        reading.refuse_fault()
        stuck = _BENDING & (reading.closures - AT_OPEN < STUCK_DEG)
        return fingers_of(reading, self._efforts.touch), _named(stuck)

    def _go(self, motors: Sequence[int], targets: Array, speed: float) -> None:
        """Send motors to targets, unless the hand is to stop."""

        def go(_line: RosbridgeLine) -> None:
            if not self._stopped.is_set():
                if self._setpoints is None:
                    self._setpoints = Setpoints(self._recent[-1].closures, LEAD_DEG)
                self._setpoints.go([*motors], targets, speed * _TWICE[[*motors]])
                self._touched_at[[*motors]] = np.inf

        self._tell(go)

    def _presses(self, reading: Reading[Told]) -> bool:
        """Whether no motor is to press harder, or it cannot: one that presses hardly moves."""
        setpoints = self._setpoints
        if setpoints is None:
            return True
        return not (_PRESSING & setpoints.moving & (setpoints.at - reading.closures < LEAD_DEG - STILL_DEG)).any()

    def _connect(self) -> RosbridgeLine:
        self._setpoints, self._sent = None, None
        self._touched_at = np.full(len(MOTORS), np.inf)
        return RosbridgeLine(self._url, self._clock)

    def _read(self, line: RosbridgeLine) -> Reading[Told]:
        return reading_of(line.read() if self.readings else line.find())

    def _watch(self, reading: Reading[Told], line: RosbridgeLine) -> None:
        """Regulate what presses, judge the grip, send the next setpoint."""
        relaxed = self._grip.follow(fingers_of(reading, self._efforts.touch))
        setpoints = self._setpoints
        if setpoints is None:
            return
        if relaxed:
            motors = [motor for finger in relaxed for motor in FLEXORS[finger]]
            setpoints.go(motors, AT_CLOSED, FINISH_SPEED * _TWICE[motors])
        self._regulate(setpoints, reading)
        setpoints.advance(self._clock.now(), reading.closures)
        moved = self._sent is None or not np.array_equal(self._sent, setpoints.at)
        if moved or (reading.said.unshown is not None and not _ignored(reading.said)):
            self._send(setpoints, line)

    def _send(self, setpoints: Setpoints, line: RosbridgeLine) -> None:
        self._sent = setpoints.at.copy()
        line.command(MAKER_SIGNS * joints_of_motors(self._sent))

    def _regulate(self, setpoints: Setpoints, reading: Reading[Told]) -> None:
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
        at_rest = reading.stamp - self._touched_at > IMPACT_S
        setpoints.hold(touching & at_rest & (reading.forces >= self._efforts.grip), setpoints.at)

    def _freeze(self, line: RosbridgeLine) -> None:
        """Let every motor stay where it will have stopped; what presses goes on pressing."""
        if self._setpoints is None:
            return
        now = self._recent[-1]
        free = self._setpoints.moving & (now.forces <= self._efforts.touch)
        self._setpoints.hold(free, now.closures + self._speeds() * REACTION_S)
        self._setpoints.hold(self._setpoints.moving, self._setpoints.at)
        self._send(self._setpoints, line)

    def _positions(self, reading: Reading[Told]) -> Array:
        return np.asarray(MAKER_SIGNS * reading.said.position)

    def _newtons(self, reading: Reading[Told]) -> dict[str, float]:
        touches = fingers_of(reading, self._efforts.touch).forces
        newtons = np.where(touches > RULE.touches, touches * self._efforts.touch * self._efforts.newtons_per_unit, 0.0)
        return dict(zip(PREFIXES, map(float, newtons), strict=True))


def _named(motors: NDArray[np.bool_]) -> list[str]:
    """The fingers of motors, (20,), for people."""
    fingers = {prefix: finger for finger, prefix in PREFIXES.items()}
    return [f"{fingers[MOTORS[motor][:2]]} ({MOTORS[motor]})" for motor in np.flatnonzero(motors)]


def _ignored(told: Told) -> bool:
    """Whether the hand does not do what it is told, for SHOWN_S already."""
    return told.unshown is not None and told.unshown >= SHOWN_S


def _build(model: HandModel, port: str, config: HandConfig, clock: Clock) -> ShadowHand:
    if config.efforts is None:
        lacking = ", ".join(f"hand.efforts.{field.name}" for field in fields(HandEfforts))
        message = f"the meaning of the {model.label}'s efforts differs from hand to hand: measure and give {lacking}"
        raise ConfigError(f"{message}; docs/how-to/shadow_hand.md", code="config.hand_efforts")
    return ShadowHand(model, port, config.efforts, clock)


KIND = WiredHandKind(
    _build, "the address of its rosbridge, such as ws://HOST:9090", "ws", serial=False, measured_efforts=True
)

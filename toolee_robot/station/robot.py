"""The robot: the arm's model and joint limits, and the hand on its flange."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from toolee_robot.errors import ConfigError
from toolee_robot.frames import Array
from toolee_robot.station.schema import STRICT, JointAccelerations, JointSpeeds
from toolee_robot.types import MOUNT, ArmModel, DhCalibration, HandEfforts, HandMounting, HandWeight, ToolMount
from toolee_robot.types.units import (
    Direction,
    NewtonMetres,
    Newtons,
    Number,
    RadiansPerSecond2,
    RadiansPerSecond3,
    Seconds,
    Unit,
)

GRAVITY = 9.81
"""Standard acceleration of free fall [m/s^2], as Pinocchio and the simulation have it."""
UPRIGHT = (0.0, 0.0, 1.0)
"""`ArmLimits.up` of an arm on a level table."""


def gravity_below(up: tuple[float, float, float]) -> Array:
    """Acceleration of free fall.

    Args:
        up: The direction straight up; any length.

    Returns:
        The vector, (3,) [m/s^2].
    """
    return -GRAVITY * np.array(up) / np.linalg.norm(up)


STOP_ROOM = 4 / 3
"""Acceleration of a stop as a share of a strike's, which turns its joints about: a stop needs room beside that. With
4/3 all of 168 stops on six swings kept the limit; with 1 one in seven took up to 1.3 times what is permitted, for some
30 ms."""


@dataclass(frozen=True)
class ArmLimits:
    """The arm's model, its calibration, and the joint limits that the planner may use.

    Velocities are those of the UR10's data sheet: base and shoulder 120 deg/s, the other joints 180 deg/s.
    Accelerations are not published; 8 rad/s^2 is a common choice. With the default of 15 rad/s^2 for strikes the
    elbow, which carries most of a strike's load, takes up to 90 % of its 150 Nm while the arm brakes (inverse dynamics
    of arm, hand and a 0.9 kg hammer), and no strike is planned with more.
    """

    __pydantic_config__ = STRICT
    model: ArmModel
    """Model of the arm."""
    up: Direction
    """Mounting of the base: the upward direction in `base`, of any length. (0, 0, 1) on a table, (0, 0, -1) under a
    ceiling. A program saved by the pendant gives it as `set_gravity`, in the pendant's Base.
    """
    host: str | None = None
    """Address of the arm's controller; null for the simulated arm. `toolee run hammer` connects to it."""
    calibration: DhCalibration | None = None
    """Factory calibration of this arm, from its controller's calibration.conf; null: the model's nominal
    kinematics, which are 1 to 2 mm off.
    """
    velocity: JointSpeeds = (2.09, 2.09, 3.14, 3.14, 3.14, 3.14)
    """Largest velocity of each joint, base to wrist 3."""
    acceleration: JointAccelerations = (15.0, 15.0, 15.0, 15.0, 15.0, 15.0)
    """Largest acceleration of each joint in a strike, base to wrist 3."""
    jerk: Annotated[float, RadiansPerSecond3(10.0, 20_000.0)] = 500.0
    """Largest jerk of every joint."""
    stop_jerk: Annotated[float, RadiansPerSecond3(10.0, 20_000.0)] = 1500.0
    """Largest jerk of every joint while braking after a contact or a stop."""
    transfer_velocity_scale: Annotated[float, Number(0.01, 1.0, "a share")] = 0.5
    """Share of `velocity` used for transfers through free space: 60 deg/s of the large joints, PolyScope's default."""
    transfer_acceleration: Annotated[float, RadiansPerSecond2(0.1, 100.0)] = 3.0
    """Largest acceleration of every joint in a transfer."""

    def __post_init__(self) -> None:
        if np.linalg.norm(self.up) < 1e-6:
            raise ValueError("up is not a direction: give the upward direction in the base, (0, 0, 1) on a table")

    @property
    def stop_acceleration(self) -> Array:
        """Largest acceleration of each joint while braking after a contact or a stop, (6,) [rad/s^2]."""
        return STOP_ROOM * np.asarray(self.acceleration)

    @property
    def gravity(self) -> Array:
        """Acceleration of free fall in `base`, (3,) [m/s^2]."""
        return gravity_below(self.up)

    @property
    def tilt(self) -> float:
        """Angle between z of `base` and straight up [rad]; 0 for an upright base, pi under a ceiling."""
        x, y, z = self.up
        return float(np.arctan2(np.hypot(x, y), z))


@dataclass(frozen=True)
class HandConfig:
    """The hand on the flange, or a tool mount without a hand."""

    __pydantic_config__ = STRICT
    model: str
    """Name of the hand, from `toolee devices list`; `mount` for a tool mount without a hand."""
    yield_torque: Annotated[float, NewtonMetres(0.05, 60.0, "the wrist joints of a UR10 have 56 Nm")] | None = None
    """Torque at which the wrist or the mount yields in a strike; null: the hand model's. A mount needs it."""
    weighed: HandWeight | None = None
    """Mass and centre of mass of everything on the flange without a tool; null: the hand model's. For a mount they
    are in `mount`.
    """
    mount: ToolMount | None = None
    """The tool mount, for the model `mount` only. Measure every field."""
    mounting: HandMounting | None = None
    """How the hand is mounted on the flange, for a hand without a standard adapter (`inspire_rh56`). Measure every
    field. Null for the others.
    """
    port: str | None = None
    """Port of the hand: a serial port such as `/dev/serial/by-id/...`, `tcp://HOST:PORT` for an Inspire hand with
    Ethernet, `ws://HOST:9090` for rosbridge with `shadow_right`; null for a simulated hand or a mount.
    """
    efforts: HandEfforts | None = None
    """Scale of the hand's motor efforts, for `shadow_right` only. Measure every field. Null for the others and for
    the simulated hand.
    """
    strap_force: Annotated[float, Newtons(1.0, 1000.0)] | None = None
    """Force of a strap that presses the handle into the hand, if the fingers alone do not hold the hammer; null
    without a strap. The simulated grip adds it to the fingers' forces.
    """
    hand_id: Annotated[int, Number(1, 254, "Modbus")] | None = None
    """Number of the hand on its line, or its Modbus unit identifier; null: as delivered (1 for `inspire_rh56`, 80
    for `ability_hand`).
    """

    def __post_init__(self) -> None:
        if self.model != MOUNT:
            if self.mount is not None:
                raise ValueError(f"mount is for the model {MOUNT!r} only, not for {self.model!r}")
            return
        if self.weighed is not None:
            raise ValueError("weighed is for a hand: for a mount give mount.mass and mount.center_of_mass")
        if any(given is not None for given in (self.mounting, self.port, self.strap_force, self.efforts)):
            raise ValueError(f"mounting, port, efforts and strap_force are for hands, not for the model {MOUNT!r}")
        needed = {"hand.yield_torque": self.yield_torque, "every field of hand.mount": self.mount}
        if missing := [name for name, value in needed.items() if value is None]:
            raise ValueError(f"a mount has no defaults: measure yours and give {' and '.join(missing)}")


@dataclass(frozen=True)
class ServoConfig:
    """Parameters of URScript's servoj, the measured lag, and the timeouts of the driver.

    Gain and lookahead are servoj's own defaults. A higher gain and a shorter lookahead follow a strike more closely and
    may make the arm vibrate (Universal Robots, Script manual, "servoj"): change them with `toolee arm lag` only.

    All times are on the station's clock, except `link_timeout`, which is on the wall clock as ur_rtde's own timeout is.
    """

    __pydantic_config__ = STRICT
    gain: Annotated[float, Number(100.0, 2000.0, "Script manual, servoj")] = 300.0
    """Proportional gain of servoj."""
    lookahead: Annotated[float, Seconds(0.03, 0.2, "Script manual, servoj")] = 0.1
    """Lookahead time of servoj, which smooths the path."""
    lag: Annotated[float, Seconds(0.002, 0.5, "UR arms follow within 0.03 to 0.25 s")] | None = None
    """Delay of the measured position behind its command with this gain and lookahead, network included; null: not
    measured, so the driver assumes an upper bound (`servo_lag`).
    """
    watchdog: Annotated[float, Unit("Hz", 2.0, 100.0, "without commands the arm goes on for 1/watchdog s")] = 10.0
    """Rate of the robot's watchdog: the robot stops the program when no command comes for 1/watchdog s."""
    connect_timeout: Annotated[float, Seconds(0.1, 60.0)] = 3.0
    """Timeout of the connection to the robot."""
    handshake_timeout: Annotated[float, Seconds(0.05, 30.0)] = 1.0
    """Timeout of each call that the control script acknowledges, such as payload, TCP and zero of the force."""
    link_timeout: Annotated[float, Seconds(0.05, 2.4, "after 2.5 s ur_rtde itself reconnects")] = 1.5
    """Time without new data at rest after which the link counts as lost; less than 2.5 s, when ur_rtde reconnects."""
    hang_timeout: Annotated[float, Seconds(0.02, 2.0)] = 0.2
    """Time without progress of the servo loop after which the servo process counts as hung."""
    heartbeat_timeout: Annotated[float, Seconds(0.02, 1.0, "the arm goes on for as long")] = 0.1
    """Time without a heartbeat of the task's process after which the arm stops."""


def servo_lag(servo: ServoConfig, rate: float) -> float:
    """Upper bound of the delay of a measured position behind its command.

    Args:
        servo: The servo's parameters.
        rate: The controller's rate [Hz].

    Returns:
        The measured lag [s]. Until it is measured an assumed bound: the lookahead, 25 s divided by the gain for the
        proportional law, and three cycles; with the defaults 0.19 s at 500 Hz and 0.21 s at 125 Hz. Measured elsewhere:
        34 ms on a UR10e with 0.03 s and a gain of 1200 (Universal Robots client library, issue 86), which it bounds by
        57 ms.
    """
    return servo.lookahead + 25.0 / servo.gain + 3.0 / rate if servo.lag is None else servo.lag


UPRIGHT_WITHIN = np.radians(1.0)
"""Largest tilt of a base that counts as upright [rad]. Across the base's z it leaves 0.17 N of each kilogram that the
flange carries: 0.9 N of a hand of 5 kg."""


def check_upright(arm: ArmLimits, purpose: str) -> None:
    """Refuse a tilted base for what takes z of `base` for straight up.

    Args:
        arm: The arm.
        purpose: What needs an upright base.

    Raises:
        ConfigError: The base is tilted (`config.mounting_tilted`).
    """
    if arm.tilt > UPRIGHT_WITHIN:
        raise ConfigError(
            f"arm.up {list(arm.up)}: the base is tilted by {np.degrees(arm.tilt):.1f}°, but {purpose} needs it "
            f"upright to {np.degrees(UPRIGHT_WITHIN):.0f}°: correct arm.up if it is",
            code="config.mounting_tilted",
        )


InputNumber = Annotated[int, Number(0, 17)]
"""Number of a digital input in the robot's input bits: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""


@dataclass(frozen=True)
class PersonConfig:
    """Digital inputs of the guarded door and the hold-to-run switch. No field has a default: a lab states its wiring.

    Both are wired so that a broken wire reads as an open door and a released switch. These inputs inform the program;
    they protect nobody: the door also acts on the robot's safeguard input.
    """

    __pydantic_config__ = STRICT
    door_closed_input: InputNumber
    """Input that is high while the door is closed, and nobody can be inside."""
    door_open_input: InputNumber | None
    """Input of the door's second contact, high while the door is open; null if it has one contact."""
    hold_to_run_input: InputNumber
    """Input that is high while the station's own hold-to-run switch is pressed. The 3-position switch of an
    e-Series does not serve: it acts in manual mode only.
    """
    hold_to_run_released_input: InputNumber | None
    """Input of the switch's second contact, high while the switch is released; null if it has one contact."""

    def __post_init__(self) -> None:
        used = [
            number
            for number in (
                self.door_closed_input,
                self.door_open_input,
                self.hold_to_run_input,
                self.hold_to_run_released_input,
            )
            if number is not None
        ]
        if len(set(used)) < len(used):
            raise ValueError(f"inputs {used} name one input twice: give every contact its own input")

"""What acceleration each joint bears: short motions about the arm's place, from gentle to fast, one joint at a time.

A motion turns the joint about once to either side of its place, as a strike does. Nobody is in reach.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import savgol_filter

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control import Supervisor
from toolee_robot.control.arm_dynamics import TORQUE_SHARE, ArmDynamics, torque_use
from toolee_robot.control.planning.timing import SAMPLE_PERIOD
from toolee_robot.devices.ur.servo.motion import tracking_error
from toolee_robot.errors import PlanningError, ProtectiveStopError, TrackingError
from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport
from toolee_robot.station import STOP_ROOM, servo_lag
from toolee_robot.tasks.bring_up.lag import (
    NOISES,
    RATIO,
    REST,
    VIBRATION,
    execute_whole,
    fast_part,
    rms,
    stop_ratio,
)
from toolee_robot.tasks.bring_up.slow_motions import SlowStation
from toolee_robot.types import Trajectory

STEPS = (2.0, 4.0, 6.0, 8.0, 11.0, 15.0, 20.0, 30.0, 40.0)
"""Accelerations that are tried, gentle to fast [rad/s^2]."""
HOLD = 0.04
"""Time for which an acceleration is held [s]: five cycles of a CB3."""
PULSES = (0.5, -1.0, 0.5, -0.5, 1.0, -0.5)
"""Shares of the acceleration, one after the other: out, about, and to rest; then the same to the other side."""


def turn_about(q: Array, joint: int, acceleration: float, jerk: float) -> Trajectory:
    """Build a motion of one joint to both sides of its place.

    Args:
        q: Present joint positions, (6,) [rad].
        joint: Number of the joint, 1 (base) to 6 (wrist 3).
        acceleration: Largest acceleration, at both turns [rad/s^2].
        jerk: Largest jerk [rad/s^3].

    Returns:
        The motion, with a rest of REST at both ends. Its speed is half of acceleration * (acceleration / jerk + HOLD).
    """
    rise = np.linspace(0.0, 1.0, int(np.ceil(acceleration / (jerk * SAMPLE_PERIOD) - 1e-9)) + 1)
    pulse = np.concatenate([rise, np.ones(round(HOLD / SAMPLE_PERIOD)), rise[-2:0:-1]])
    rest = np.zeros(round(REST / SAMPLE_PERIOD))
    a = acceleration * np.concatenate([rest, *(share * pulse for share in PULSES), rest])
    # The acceleration is linear between the samples, so these are exact.
    v = np.concatenate([[0.0], np.cumsum(0.5 * SAMPLE_PERIOD * (a[1:] + a[:-1]))])
    moved = SAMPLE_PERIOD * v[:-1] + SAMPLE_PERIOD**2 * (2.0 * a[:-1] + a[1:]) / 6.0
    times = SAMPLE_PERIOD * np.arange(len(a), dtype=float)
    full = np.zeros((3, len(a), 6))
    full[:, :, joint - 1] = np.concatenate([[0.0], np.cumsum(moved)]), v, a
    full[0] += q
    return Trajectory(times, *full)


@dataclass(frozen=True)
class AccelerationTrial:
    """One motion of one joint.

    Attributes:
        joint: Number of the joint.
        acceleration: Its largest acceleration [rad/s^2].
        sign: Why the joint gets no faster motion; empty if it bore this one.
        reached: Largest measured acceleration, over HOLD [rad/s^2]: gentle servo settings smooth a motion. None without
            a whole motion.
        deviation: Largest deviation from the command, as the supervisor counts it [rad]; None likewise.
        ratio: How near it came to a protective stop; see `LagFigures`.
        vibration: Root mean square of the joint's fast motion after the last turn [rad]; None likewise.
    """

    joint: int
    acceleration: float
    sign: str
    reached: float | None = None
    deviation: float | None = None
    ratio: float | None = None
    vibration: float | None = None


def raise_acceleration(arm: Supervisor, station: SlowStation, joint: int, most: float) -> Iterator[AccelerationTrial]:
    """Move a joint with rising accelerations until the first sign that it should not get more.

    Args:
        arm: The arm, in UNATTENDED mode.
        station: The station, whose limits permit `most`.
        joint: Number of the joint, 1 to 6.
        most: Largest acceleration [rad/s^2].

    Yields:
        The trials; the last one may have a sign.

    Raises:
        TooleeError: What `Supervisor.execute` raises, unless it shows what the arm bears.
    """
    for acceleration in steps_to(most):
        try:
            trial = _try(arm, station, joint, acceleration)
        except (PlanningError, ProtectiveStopError, TrackingError) as error:
            trial = AccelerationTrial(joint, acceleration, str(error))
        yield trial
        if trial.sign:
            return


def steps_to(most: float) -> tuple[float, ...]:
    """STEPS below an acceleration, and that acceleration [rad/s^2]."""
    return (*(step for step in STEPS if step < most), most)


def _try(arm: Supervisor, station: SlowStation, joint: int, acceleration: float) -> AccelerationTrial:
    config, robot = station.config, station.robot
    motion = turn_about(arm.state().q_commanded, joint, acceleration, config.arm.jerk)
    dynamics = ArmDynamics.with_payload(robot, station.world.q_hand, None)
    if np.max(torque_use(dynamics, motion, TORQUE_SHARE * np.array(ARM_DATA[config.arm.model].torque))) > 1.0:
        return AccelerationTrial(
            joint, acceleration, f"not tried: it would take over {100 * TORQUE_SHARE:.0f} % of a joint's torque"
        )
    # A stop takes no more than belongs to this step, whatever the largest one is.
    report = execute_whole(arm, replace(motion, braking=np.full((len(motion.times), 2), STOP_ROOM * acceleration)))
    limit = config.supervisor.tracking_error
    deviation, ratio = largest_deviation(report, servo_lag(config.servo, arm.rate)), stop_ratio(report)
    t = report.stamps - report.stamps[0]
    q, period = report.q_measured[:, joint - 1], float(t[-1]) / (len(t) - 1)
    bent = savgol_filter(q, 2 * round(0.5 * HOLD / period) + 1, 2, deriv=2, delta=period)
    fast = fast_part(t, q)
    still, after = rms(fast[t < 0.9 * REST]), rms(fast[t > motion.duration - 0.5 * REST])
    sign = ""
    if deviation > RATIO * limit:
        sign = f"it deviates by {1e3 * deviation:.0f} mrad, supervisor.tracking_error allows {1e3 * limit:.0f}"
    elif ratio is not None and ratio > RATIO:
        sign = f"it is near a protective stop: ratio {ratio:.2f}, the robot stops at 1"
    elif after > max(VIBRATION, NOISES * still):
        sign = "it vibrates"
    return AccelerationTrial(joint, acceleration, sign, float(np.max(np.abs(bent))), deviation, ratio, after)


def largest_deviation(report: MotionReport, lag: float) -> float:
    """Largest deviation of a measured joint from the commands that it may answer to [rad], as the driver counts it."""
    commands = report.stamps, report.q_commanded
    rows = zip(report.stamps, report.q_measured, strict=True)
    return max(tracking_error(*commands, float(stamp), q, lag) for stamp, q in rows)


def borne(trials: Sequence[AccelerationTrial]) -> dict[int, float]:
    """The largest acceleration that each joint bore without a sign [rad/s^2]; a joint without one is left out."""
    return {trial.joint: trial.acceleration for trial in trials if not trial.sign}

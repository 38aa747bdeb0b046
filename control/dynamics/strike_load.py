"""What a strike asked of the arm: impulse at the flange, joint torques, and the controller's own ratios."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control.dynamics.arm_dynamics import ArmDynamics
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport
from toolee_robot.station import StrikeConfig
from toolee_robot.types import ArmModel, Payload

BEFORE, AFTER = 0.016, 0.080
"""Time before and after the detected contact over which the force is integrated [s]."""
SMOOTHING = 0.024
"""Time over which a parabola gives velocity and acceleration of the command [s]: three samples at 125 Hz. A single late
command must not seem an acceleration."""


@dataclass(frozen=True)
class StrikeLoad:
    """Load of the arm in one strike.

    Attributes:
        impulse: Integral of the force on the flange around the contact [N s]; 0 without a contact.
        torque_share: Largest torque of a joint as a share of its largest one: rigid-body inverse dynamics of the
            commanded motion with the measured wrench. Friction, rotors, and impacts that are shorter than the arm's
            cycle are not in it.
        position_deviation_ratio: The controller's largest ratio in the strike; see `hal.ArmState`. None where it has
            none.
        collision_ratio: Likewise.
    """

    impulse: float
    torque_share: float
    position_deviation_ratio: float | None = None
    collision_ratio: float | None = None

    def excess(self, strike: StrikeConfig) -> str:
        """Tell what of it exceeds the limits above which no further strike is made.

        Args:
            strike: The limits.

        Returns:
            What exceeds them, and what to lower; empty if nothing does.
        """
        advice = "lower strike.speed and arm.acceleration, or take a lighter tool"
        ratios = {
            "joint position deviation ratio": (self.position_deviation_ratio, f"{advice}; toolee arm lag tunes servoj"),
            "collision detection ratio": (self.collision_ratio, f"{advice}, or a softer mount"),
        }
        for name, (ratio, change) in ratios.items():
            if ratio is not None and not ratio <= strike.max_load:  # NaN included
                return (
                    f"the last strike took the robot's {name} to {ratio:.2f}; at 1 it stops itself, strike.max_load "
                    f"allows {strike.max_load:g}: {change}"
                )
        if not self.torque_share <= strike.max_torque_share:
            return (
                f"the last strike took {self.torque_share:.2f} of a joint's largest torque, strike.max_torque_share "
                f"allows {strike.max_torque_share:g}: {advice}, or move the block nearer to the arm"
            )
        return ""


def strike_load(
    report: MotionReport, robot: RobotModel, q_hand: Array, payload: Payload, model: ArmModel
) -> StrikeLoad:
    """Compute the load of an executed strike.

    Args:
        report: The executed motion.
        robot: Kinematic model of arm and hand.
        q_hand: Joint positions of the hand, wrist first, (n,) [rad].
        payload: What the flange carries, hand and tool together.
        model: Model of the arm.

    Returns:
        The load.
    """
    t, q = report.stamps, report.q_commanded
    share = 0.0
    if len(t) >= 3:
        # The commands have an even period; the stamps jitter by the delay of their arrival.
        period = float(t[-1] - t[0]) / (len(t) - 1)
        rows = min(2 * round(SMOOTHING / period / 2) + 1, len(t) - 1 + len(t) % 2)
        qd, qdd = (savgol_filter(q, rows, 2, deriv=n, delta=period, axis=0) for n in (1, 2))
        torques = ArmDynamics.with_payload(robot, q_hand, payload).torques(q, qd, qdd)
        torques -= np.einsum("nij,ni->nj", robot.arm.fk_jacobian(q)[1], report.wrenches)
        share = float(np.max(np.abs(torques) / ARM_DATA[model].torque))
    impulse = 0.0
    if report.contact is not None and len(t) >= 2:
        near = (t >= report.contact.stamp - BEFORE) & (t <= report.contact.stamp + AFTER)
        impulse = float(np.linalg.norm(np.trapezoid(report.wrenches[near, :3], t[near], axis=0)))
    return StrikeLoad(impulse, share, _largest(report.position_deviation_ratios), _largest(report.collision_ratios))


def _largest(ratios: Array | None) -> float | None:
    return None if ratios is None or len(ratios) == 0 else float(np.max(ratios))

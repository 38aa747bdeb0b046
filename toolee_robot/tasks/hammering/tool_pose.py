"""The pose of the tool in the hand: looked at from several views, and tracked as it slips."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.control.contact import merge, slip
from toolee_robot.control.planning.views import plan_views
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import PerceptionError
from toolee_robot.frames import Array, angle_between, inverse, transform
from toolee_robot.hal import Station
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.look import Look, Perceiver
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import JobEnded, Outcome, Stage
from toolee_robot.tasks.common.stages import Stages
from toolee_robot.types import InHandEstimate, RgbdFrame

SETTLE = 0.3
"""Time at standstill before a frame is taken, so that arm, wrist and tool have stopped swinging [s]."""
STEADY, STEADY_ANGLE = 0.00075, np.deg2rad(0.5)
"""Largest slip per strike of a tool that is held steadily: in the plane of the face [m], since touches measure the slip
along its normal, and of its normal [rad]."""

WELL_SEEN = 0.04
"""Distance of a face from where the views were planned to see it, up to which they see it as well [m]."""
OWN_ERRORS = 0.5
"""Share of the variances of two looks that is in their difference: what is left of the camera's error, and what the
network makes of this tool, are in both. Assumed."""


@dataclass(frozen=True)
class Holding:
    """How the hand holds the tool, by the last two looks at it.

    Attributes:
        steady: Whether it has hardly slipped.
        turn: How a strike turns the face's normal, a rotation vector in the face's axes, (3,) [rad].
    """

    steady: bool = False
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def struck(self, X_hand_ee: Array) -> Array:
        """Pose of the face in the hand after one more strike, (4, 4), from that before it."""
        return X_hand_ee @ transform(Rotation.from_rotvec(self.turn))


class ToolPose:
    """Looks at the tool in the hand, and keeps the estimates.

    Args:
        station: The devices of the station.
        perceiver: Estimates poses from frames.
        config: Configuration of the station.
        robot: Kinematic model of arm and hand.
        motions: The arm and what it carries; a look sets its `X_hand_ee`.
        stages: Times the stages of the job.
        observer: Receives frames, estimates and messages.
        X_hand_ee: Pose of the end effector in the hand in the nominal grasp, (4, 4).
        ee_off: How far it may be from there beside what any grasp leaves open [m]; 0 where the tool was measured.
        strikes_since_look: Returns the number of strikes since the last look.

    Attributes:
        estimates: Fused pose of each look, with its time on the station's clock [s].
        frames: What the camera took at the last look.
    """

    def __init__(
        self,
        station: Station,
        perceiver: Perceiver,
        config: StationConfig,
        robot: RobotModel,
        motions: Motions,
        stages: Stages,
        observer: TaskObserver,
        X_hand_ee: Array,
        ee_off: float,
        strikes_since_look: Callable[[], int],
    ) -> None:
        self.estimates: list[tuple[float, InHandEstimate]] = []
        self.frames: Sequence[RgbdFrame] = ()
        self._station, self._perceiver, self._config, self._robot = station, perceiver, config, robot
        self._motions, self._stages, self._observer = motions, stages, observer
        self._X_hand_ee, self._ee_off = X_hand_ee, ee_off
        self._strikes_since_look = strikes_since_look
        self._related = False

    def forget(self) -> None:
        """Believe the next look alone: what was known of the pose no longer holds, for instance after a stop."""
        self._related = False

    def look(self, views: int) -> Holding:
        """Estimate the pose of the face in the hand; on failure once more, from other views.

        Args:
            views: Number of views.

        Returns:
            How the tool is held since the look before.

        Raises:
            PerceptionError: The tool was not found, or its pose cannot be trusted.
            JobEnded: The tool has slipped too far since the last look.
            TooleeError: A motion or a device failed.
        """
        known = self.estimates[-1][1].camera if self._related else None
        look = Look(
            self._config, self._robot, self._perceiver, self._observer, self._X_hand_ee, known, ee_off=self._ee_off
        )
        for attempt in (1, 2):
            with self._stages(Stage.VIEW):
                self._motions.rise_from_among_nails()
                q_hand = self._motions.q_hand
                # Another seed gives other views; the same views would give the same result.
                plan = plan_views(
                    self._robot,
                    self._config,
                    self._motions.world(),
                    self._motions.q,
                    q_hand,
                    self._X_hand_ee,
                    count=views,
                    seed=attempt - 1,
                )
            for view in plan.views:
                with self._stages(Stage.VIEW):
                    self._motions.transfer("to a view", view.transfer)
                    self._station.clock.sleep(SETTLE)
                with self._stages(Stage.PERCEIVE):
                    look.take(self._station)
            try:
                holding = Holding()
                with self._stages(Stage.PERCEIVE):
                    estimate = look.fuse(self._station.clock.now())
                    if self._related:
                        strikes = max(self._strikes_since_look(), 1)
                        usual = self._config.task.slip_angle_per_strike
                        holding = holding_between(self.estimates[-1][1], estimate, strikes, usual)
                        estimate = self._after_slip(self.estimates[-1][1], estimate)
                break
            except (PerceptionError, JobEnded) as error:
                # Not usable, or slipped too far: look once more, from other views.
                if attempt == 2:
                    raise
                self._observer.message(f"{error}; looking again")
        if self._found(estimate.X_hand_ee):
            return self.look(views)
        self.estimates.append((self._station.clock.now(), estimate))
        self.frames = look.frames
        self._motions.X_hand_ee = estimate.X_hand_ee
        self._related = True
        return holding

    def _found(self, X_hand_ee: Array) -> bool:
        """Whether to look once more: a face of which nothing was known is far from where the views expected it."""
        if not self._ee_off:
            return False
        away = float(np.linalg.norm(X_hand_ee[:3, 3] - self._X_hand_ee[:3, 3]))
        self._observer.message(f"the face is {away * 1e3:.0f} mm from where it was looked for first")
        self._X_hand_ee = self._motions.X_hand_ee = X_hand_ee
        self._ee_off = self._motions.tool_off = 0.0
        return away > WELL_SEEN

    def _after_slip(self, before: InHandEstimate, now: InHandEstimate) -> InHandEstimate:
        """Fuse the estimates of two looks; ends the job when the tool has slipped too far."""
        task = self._config.task
        distance, angle = slip(before, now)
        self._observer.message(f"slip in the hand {distance * 1e3:.1f} mm, {np.rad2deg(angle):.1f}°")
        if distance > task.abort_slip or angle > task.abort_slip_angle:
            raise JobEnded(
                Outcome.TOOL_SLIPPED,
                f"the tool slipped {distance * 1e3:.0f} mm and {np.rad2deg(angle):.0f}° in the hand: grip it again",
            )
        strikes = max(self._strikes_since_look(), 1)
        return merge(before, now, strikes * task.slip_per_strike, strikes * task.slip_angle_per_strike)


def holding_between(before: InHandEstimate, now: InHandEstimate, strikes: int, usual: float) -> Holding:
    """Compare two looks: how the hand holds the tool.

    The turn of a strike is the most probable one: what the looks tell counts the less, the less certain they are.

    Args:
        before: The earlier look.
        now: The later look.
        strikes: Number of strikes between them.
        usual: Standard deviation of the turn of a strike before anything is seen [rad].

    Returns:
        How it is held.
    """
    moved = inverse(before.X_hand_ee) @ now.X_hand_ee
    angle = angle_between(before.X_hand_ee[:3, 2], now.X_hand_ee[:3, 2])
    steady = np.linalg.norm(moved[:2, 3]) <= strikes * STEADY and angle <= strikes * STEADY_ANGLE
    axis = np.array([-moved[1, 2], moved[0, 2], 0.0])  # of the turn from one normal to the other
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return Holding(bool(steady))
    expected = (strikes * usual) ** 2
    share = expected / (expected + OWN_ERRORS * (before.sigma_axis**2 + now.sigma_axis**2))
    x, y, z = (axis * (share * angle / (sine * strikes))).tolist()
    return Holding(bool(steady), (x, y, z))

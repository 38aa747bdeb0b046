"""Look at the held tool from several views: its end effector's pose in the hand, and how it slips there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from toolee_robot.control.contact import merge, slip
from toolee_robot.control.planning.views import DISTANCE, plan_views
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import DeviceError, PerceptionError, StaleDataError, UserError
from toolee_robot.frames import Array, angle_between, inverse, transform
from toolee_robot.hal import Station
from toolee_robot.station import StationConfig
from toolee_robot.symmetry import SymmetryKind
from toolee_robot.tasks.common.held_tool import HeldTool, held_region
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import JobEnded, Outcome, Stage
from toolee_robot.types import CameraError, HoldingHand, InHandEstimate, RgbdFrame, ToolEstimate

HELD = {
    Category.HAMMER_HEAD: ("hammer", "face towards the fingers"),
    Category.WRENCH_HEAD: ("wrench", "jaw beyond the thumb"),
}
"""What a message calls the tool, and how a person hands it over."""
LEAST_DISPLACEMENT = 0.10
"""Distance from its nominal position in the hand that is plausible for any face [m]."""
SLIDE = 0.04
"""A handle lies farther up or down in the hand by so much [m], and is turned in it by TURN."""
TURN = 0.30
"""Tilt of a handle in the hand [rad]."""
MAX_MISALIGNMENT = np.deg2rad(60.0)
"""Largest plausible angle of the face's normal from its nominal direction in the hand [rad]."""
CAMERA_OFF = 0.004
"""Displacement of the tool by the camera's error beyond which a calibration is to be repeated [m]."""
MIN_DEPTH = 0.3
"""Least share of a frame's pixels with a known depth; with less, the camera is blinded or covered."""

SETTLE = 0.3
"""Time at standstill before a frame is taken, so that arm, wrist and tool have stopped swinging [s]."""
STEADY, STEADY_ANGLE = 0.00075, np.deg2rad(0.5)
"""Largest slip per strike of a tool that is held steadily: in the plane of the face [m], since touches measure the slip
along its normal, and of its normal [rad]."""
STEADY_STRIKES = 4
"""Number of strikes whose slip a steadily held tool may have between two looks, however many lie between them."""
WELL_SEEN = 0.04
"""Distance of a face from where the views were planned to see it, up to which they see it as well [m]."""
OWN_ERRORS = 0.5
"""Share of the variances of two looks that is in their difference: what is left of the camera's error, and what the
network makes of this tool, are in both. Assumed."""


def largest_displacement(X_hand_ee: Array) -> float:
    """How far the face may plausibly be from its nominal position in the hand.

    A tilted handle moves the face by the more, the farther it is from the hand.

    Args:
        X_hand_ee: Nominal pose of the face in the hand, (4, 4).

    Returns:
        The distance [m].
    """
    return max(LEAST_DISPLACEMENT, SLIDE + TURN * float(np.linalg.norm(X_hand_ee[:3, 3])))


class Perceiver(Protocol):
    """Perception as a task uses it; implemented by `toolee_robot.perception.ToolPerception`."""

    def estimate(
        self, frame: RgbdFrame, hand: HoldingHand | None = None, categories: Sequence[Category] = CATEGORIES
    ) -> list[ToolEstimate]:
        """Detect the end effectors in a frame and estimate their poses.

        Args:
            frame: The frame.
            hand: The hand that holds the tool; None if unknown.
            categories: The categories wanted.

        Returns:
            One estimate per detection, in the camera frame.

        Raises:
            UserError: The frame is unusable.
        """

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],
        Xs_camera_hand: Sequence[Array],
        category: Category | None = None,
        camera: CameraError | None = None,
    ) -> InHandEstimate:
        """Fuse the estimates of several frames.

        Args:
            estimates_per_frame: Estimates of each frame.
            Xs_camera_hand: Pose of the hand in the camera frame at each frame, (4, 4).
            category: Category to fuse; None for the one seen most.
            camera: What an earlier result says of the error of the camera's calibration; None: nothing is known.

        Returns:
            The pose of the end effector in the hand.

        Raises:
            PerceptionError: No frame shows the end effector.
        """


class Views:
    """The frames of one look at the held tool, and their fusion.

    Args:
        config: Configuration of the station.
        robot: Kinematic model of arm and hand.
        perceiver: Estimates poses from frames.
        observer: Receives frames and estimates.
        held: The tool as it was known before.
        category: Category of its end effector.

    Attributes:
        frames: The frames taken.
    """

    def __init__(
        self,
        config: StationConfig,
        robot: RobotModel,
        perceiver: Perceiver,
        observer: TaskObserver,
        held: HeldTool,
        category: Category = Category.HAMMER_HEAD,
    ) -> None:
        self._camera = None if held.seen is None else held.seen.camera
        self._X_camera_base = inverse(config.camera.X_base_camera)
        self._robot, self._perceiver, self._observer, self._category = robot, perceiver, observer, category
        self._R_hand_tool = robot.description.hand.grasp.R_hand_tool
        self._nominal = held.X_nominal
        self._largest = largest_displacement(held.X_nominal) + held.off
        self._device = config.camera.device
        self._region = held_region(config, held.X_nominal, self._largest)
        self.frames: list[RgbdFrame] = []
        self._seen: list[list[ToolEstimate]] = []
        self._hands: list[Array] = []

    def take(self, station: Station) -> None:
        """Read a frame at the arm's present configuration and estimate the poses in it.

        Args:
            station: The devices of the station.

        Raises:
            StaleDataError: The camera repeated an old frame.
            DeviceError: The frame is unusable, or a device does not answer.
        """
        asked = station.clock.now()
        frame = station.camera.read()
        if frame.stamp < asked:
            raise StaleDataError(
                f"the camera returned a frame {asked - frame.stamp:.2f} s older than the request: it repeats old "
                "frames. Restart it",
                code="stale_data.camera_repeats",
            )
        q_arm = station.arm.state().joints.q
        q_hand = station.hand.state().joints.q
        self.add(frame, self._X_camera_base @ self._robot.fk(q_arm, q_hand)[1])

    def add(self, frame: RgbdFrame, X_camera_hand: Array) -> None:
        """Estimate the poses in a frame.

        Args:
            frame: The frame.
            X_camera_hand: Pose of the hand in the camera frame at the exposure, (4, 4).

        Raises:
            DeviceError: The frame is unusable.
        """
        hand = HoldingHand(X_camera_hand, self._R_hand_tool, self._region)
        try:
            estimates = self._perceiver.estimate(frame, hand, [self._category])
        except UserError as error:  # the frame is the camera's, not the user's
            raise DeviceError(f"the camera's frame is unusable: {error}") from error
        self._observer.frame(frame, estimates, X_camera_hand)
        self.frames.append(frame)
        known = float(np.mean(frame.depth > 0.0))  # NaN included
        if known < MIN_DEPTH:
            self._observer.message(
                f"depth is known in only {100 * known:.0f} % of the pixels: the frame does not count"
            )
            estimates = []
        self._seen.append([e for e in estimates if self._plausible(e, X_camera_hand)])
        self._hands.append(X_camera_hand)

    def fuse(self, stamp: float) -> InHandEstimate:
        """Fuse the frames into the pose of the face in the hand.

        Args:
            stamp: Present time on the station's clock [s].

        Returns:
            The pose of the face in the hand.

        Raises:
            PerceptionError: The face was not seen, its pose is too uncertain, or it is implausible for a held hammer;
                `perception.too_near` where it is nearer to the camera than that can measure.
        """
        try:
            return self._fuse(stamp)
        except PerceptionError as error:
            if (near := self._too_near()) is None:
                raise
            # Where nothing was seen, perception advises to come closer, which would be wrong.
            said = f"; {error}" if error.code in ("perception.not_usable", "perception.implausible") else ""
            raise PerceptionError(f"{near}{said}", code="perception.too_near") from error

    def _fuse(self, stamp: float) -> InHandEstimate:
        estimate = self._perceiver.fuse(self._seen, self._hands, self._category, self._camera)
        estimate = replace(estimate, X_hand_ee=self._as_held(estimate.X_hand_ee))
        self._observer.in_hand(stamp, estimate)
        if not estimate.usable:
            raise PerceptionError(
                f"the {self._category.label}'s pose is not reliable: {estimate.reason}", code="perception.not_usable"
            )
        self._tell_of_camera(estimate)
        displacement, misalignment = self._off_nominal(estimate.X_hand_ee)
        if not (displacement <= self._largest and misalignment <= MAX_MISALIGNMENT):  # NaN included
            (held, how), angle = HELD[self._category], np.rad2deg(misalignment)
            raise PerceptionError(
                f"the {self._category.label} seems {displacement * 1e3:.0f} mm and {angle:.0f}° outside of where a "
                f"held {held} can be. Hand it over again, {how}",
                code="perception.implausible",
            )
        return estimate

    def _too_near(self) -> str | None:
        """What to say if the camera cannot measure the depth of a face where the nominal grasp has it; None if it can.

        Moving the camera is no remedy: the planner puts the views before it, wherever it is.
        """
        if self._device is None or not self._hands:
            return None
        least = self._device.least_range
        depths = [float((X_camera_hand @ self._nominal)[2, 3]) for X_camera_hand in self._hands]
        near = [depth for depth in depths if depth < least]
        if not near:
            return None
        return (
            f"the camera is too near to the tool. In {len(near)} of {len(depths)} views the face is only "
            f"{min(near):.2f} m away. The camera measures from {least:.2f} m (camera.device.least_range). Views "
            f"are always planned {DISTANCE[0]:.2f} to {DISTANCE[1]:.2f} m from the camera. Use a smaller depth "
            "image, which sees nearer things (camera.width, camera.height, intrinsics and least_range), or another "
            "camera"
        )

    def _tell_of_camera(self, estimate: InHandEstimate) -> None:
        if estimate.camera is None or self._camera is not None:
            return
        distance, sigma = estimate.camera.at((self._hands[-1] @ estimate.X_hand_ee)[:3, 3])
        advice = ". Calibrate it again" if distance - 2.0 * sigma > CAMERA_OFF else ""
        off = f"{distance * 1e3:.0f} ± {sigma * 1e3:.0f} mm"
        self._observer.message(f"estimated error of the camera's calibration: {off} at the tool (corrected){advice}")

    def _plausible(self, estimate: ToolEstimate, X_camera_hand: Array) -> bool:
        """Whether it can be the striking face, not a club hammer's other face or a hammer on the table."""
        if not np.all(np.isfinite(estimate.X_camera_ee)):
            return True  # a detection without a pose: keep it, since its reason is reported
        displacement, misalignment = self._off_nominal(inverse(X_camera_hand) @ estimate.X_camera_ee)
        return displacement < 1.5 * self._largest and misalignment < 1.25 * MAX_MISALIGNMENT

    def _as_held(self, X_hand_ee: Array) -> Array:
        """The pose itself; of an end effector that looks the same turned over, the one nearer to the nominal grasp."""
        symmetry = self._category.symmetry
        if symmetry.kind is not SymmetryKind.C2 or not np.all(np.isfinite(X_hand_ee)):
            return X_hand_ee
        return transform(symmetry.canonical(X_hand_ee[:3, :3], self._nominal[:3, :3]), X_hand_ee[:3, 3])

    def _off_nominal(self, X_hand_ee: Array) -> tuple[float, float]:
        """Distance of the face's centre [m] and angle of its normal [rad] from those of the nominal grasp."""
        X_hand_ee = self._as_held(X_hand_ee)
        return (
            float(np.linalg.norm(X_hand_ee[:3, 3] - self._nominal[:3, 3])),
            angle_between(X_hand_ee[:3, 2], self._nominal[:3, 2]),
        )


class Look:
    """Looks at the held tool: `held = look(held, views=3)`.

    Args:
        motions: The arm and its motions.
        perceiver: Estimates poses from frames.
        category: Category of the tool's end effector.

    Attributes:
        estimates: Fused pose of each look, with its time on the station's clock [s].
    """

    def __init__(self, motions: Motions, perceiver: Perceiver, category: Category) -> None:
        self.estimates: list[tuple[float, InHandEstimate]] = []
        self._motions, self._perceiver, self._category = motions, perceiver, category

    def __call__(self, held: HeldTool, views: int) -> HeldTool:
        """Estimate the pose of the end effector in the hand; on failure once more, from other views.

        Args:
            held: The tool as it was known before.
            views: Number of views.

        Returns:
            The tool as it was seen.

        Raises:
            PerceptionError: The tool was not found, or its pose cannot be trusted.
            JobEnded: The tool has slipped too far since the last look.
            TooleeError: A motion or a device failed.
        """
        m = self._motions
        taken = Views(m.config, m.robot, self._perceiver, m.observer, held, self._category)
        try:
            seen = self._seen(held, taken, views, seed=0)
        except (PerceptionError, JobEnded) as error:
            # Not usable, or slipped too far. The same views would give the same result: another seed gives others.
            m.observer.message(f"{error}; looking again")
            seen = self._seen(held, taken, views, seed=1)
        if held.off:  # a face of which nothing was known
            away = float(np.linalg.norm(seen.X_hand_ee[:3, 3] - held.X_nominal[:3, 3]))
            m.observer.message(f"the face is {away * 1e3:.0f} mm from where the first look found it")
            if away > WELL_SEEN:
                return self(replace(held.moved(seen.X_hand_ee), X_nominal=seen.X_hand_ee, off=0.0), views)
            seen = replace(seen, X_nominal=seen.X_hand_ee, off=0.0)
        assert seen.seen is not None
        self.estimates.append((m.station.clock.now(), seen.seen))
        m.carry(seen := replace(seen, frames=tuple(taken.frames), strikes=0))
        return seen

    def _seen(self, held: HeldTool, taken: Views, views: int, seed: int) -> HeldTool:
        """Take frames from so many views, and fuse all that were taken."""
        m = self._motions
        with m.stages(Stage.VIEW):
            m.rise_from_among_nails(held)
            plan = plan_views(m.robot, m.config, m.world(held), m.q, m.q_hand, held.X_nominal, count=views, seed=seed)
        for view in plan.views:
            with m.stages(Stage.VIEW):
                m.transfer("to a view", view.transfer, held)
                m.station.clock.sleep(SETTLE)
            with m.stages(Stage.PERCEIVE):
                taken.take(m.station)
        with m.stages(Stage.PERCEIVE):
            now = taken.fuse(m.station.clock.now())
            if held.seen is None:
                return replace(held.moved(now.X_hand_ee), seen=now, steady=False, turn=(0.0, 0.0, 0.0))
            strikes, task = max(held.strikes, 1), m.config.task
            steady, turn = holding_between(held.seen, now, strikes, task.slip_angle_per_strike)
            self._check_slip(held.seen, now)
            drift = strikes * task.slip_per_strike, strikes * task.slip_angle_per_strike
            merged = merge(held.seen, now, *drift)
            return replace(held.moved(merged.X_hand_ee), seen=merged, steady=steady, turn=turn)

    def _check_slip(self, before: InHandEstimate, now: InHandEstimate) -> None:
        """End the job when the tool has slipped too far."""
        task = self._motions.config.task
        distance, angle = slip(before, now)
        self._motions.observer.message(f"slip in the hand {distance * 1e3:.1f} mm, {np.rad2deg(angle):.1f}°")
        if distance > task.abort_slip or angle > task.abort_slip_angle:
            raise JobEnded(
                Outcome.TOOL_SLIPPED,
                f"the tool slipped {distance * 1e3:.0f} mm and {np.rad2deg(angle):.0f}° in the hand: grip it again",
            )


def holding_between(
    before: InHandEstimate, now: InHandEstimate, strikes: int, usual: float
) -> tuple[bool, tuple[float, float, float]]:
    """Compare two looks: whether the hand holds the tool steadily, and how a strike turns it there.

    The turn of a strike is the most probable one: what the looks tell counts the less, the less certain they are. A
    steady tool has none: at 27 looks after 7 to 12 strikes a turn foretold by the two looks before was 1.9° off, and
    none was 1.0° off (root mean square).

    Args:
        before: The earlier look.
        now: The later look.
        strikes: Number of strikes between them.
        usual: Standard deviation of the turn of a strike before anything is seen [rad].

    Returns:
        Both, as `HeldTool` has them.
    """
    moved = inverse(before.X_hand_ee) @ now.X_hand_ee
    angle = angle_between(before.X_hand_ee[:3, 2], now.X_hand_ee[:3, 2])
    counted = min(strikes, STEADY_STRIKES)
    steady = np.linalg.norm(moved[:2, 3]) <= counted * STEADY and angle <= counted * STEADY_ANGLE
    axis = np.array([-moved[1, 2], moved[0, 2], 0.0])  # of the turn from one normal to the other
    sine = float(np.linalg.norm(axis))
    if steady or sine < 1e-9:
        return bool(steady), (0.0, 0.0, 0.0)
    expected = (strikes * usual) ** 2
    share = expected / (expected + OWN_ERRORS * (before.sigma_axis**2 + now.sigma_axis**2))
    x, y, z = (axis * (share * angle / (sine * strikes))).tolist()
    return bool(steady), (x, y, z)

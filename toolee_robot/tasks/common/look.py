"""Look at the held tool from several views and fuse the estimates into its pose in the hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from toolee_robot.control.planning.views import DISTANCE
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import DeviceError, PerceptionError, StaleDataError, UserError
from toolee_robot.frames import Array, angle_between, inverse
from toolee_robot.hal import Station
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.held_region import held_region
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.types import CameraError, HoldingHand, InHandEstimate, RgbdFrame, ToolEstimate

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


class Look:
    """One look at the held tool: the frames taken, and their fusion.

    Args:
        config: Configuration of the station.
        robot: Kinematic model of arm and hand.
        perceiver: Estimates poses from frames.
        observer: Receives frames and estimates.
        X_hand_ee_nominal: Pose of the end effector in the hand in a nominal grasp, (4, 4).
        camera: What an earlier look says of the error of the camera's calibration; None for the first.
        ee_off: How far the end effector may be from its nominal pose beside what any grasp leaves open [m].

    Attributes:
        frames: The frames taken.
    """

    def __init__(
        self,
        config: StationConfig,
        robot: RobotModel,
        perceiver: Perceiver,
        observer: TaskObserver,
        X_hand_ee_nominal: Array,
        camera: CameraError | None = None,
        ee_off: float = 0.0,
    ) -> None:
        self._camera = camera
        self._X_camera_base = inverse(config.camera.X_base_camera)
        self._robot = robot
        self._R_hand_tool = robot.description.hand.grasp.R_hand_tool
        self._perceiver = perceiver
        self._observer = observer
        self._nominal = X_hand_ee_nominal
        self._largest = largest_displacement(X_hand_ee_nominal) + ee_off
        self._device = config.camera.device
        self._region = held_region(config, X_hand_ee_nominal, self._largest)
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
                f"the camera gave a frame {asked - frame.stamp:.2f} s older than it was asked: it repeats old ones; "
                "restart it",
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
            estimates = self._perceiver.estimate(frame, hand, [Category.HAMMER_HEAD])
        except UserError as error:  # the frame is the camera's, not the user's
            raise DeviceError(f"the camera's frame is unusable: {error}", code="device.camera_frame") from error
        self._observer.frame(frame, estimates, X_camera_hand)
        self.frames.append(frame)
        known = float(np.mean(frame.depth > 0.0))  # NaN included
        if known < MIN_DEPTH:
            self._observer.message(f"only {100 * known:.0f} % of the frame's depth is known: it does not count")
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
        estimate = self._perceiver.fuse(self._seen, self._hands, Category.HAMMER_HEAD, self._camera)
        self._observer.in_hand(stamp, estimate)
        if not estimate.usable:
            raise PerceptionError(
                f"the hammer head's pose is not to be relied on: {estimate.reason}", code="perception.not_usable"
            )
        self._tell_of_camera(estimate)
        displacement, misalignment = self._off_nominal(estimate.X_hand_ee)
        if not (displacement <= self._largest and misalignment <= MAX_MISALIGNMENT):  # NaN included
            raise PerceptionError(
                f"the hammer head seems to be {displacement * 1e3:.0f} mm and {np.rad2deg(misalignment):.0f}° away "
                "from where a held hammer can have it: hand it over again, face towards the fingers",
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
            f"the camera is too near to the tool: the face is {min(near):.2f} m before it in {len(near)} of "
            f"{len(depths)} views, and it measures from {least:.2f} m on (camera.device.least_range). Views are "
            f"planned {DISTANCE[0]:.2f} to {DISTANCE[1]:.2f} m before the camera, wherever it stands: take a smaller "
            "depth image, which sees nearer things (camera.width and camera.height with its intrinsics and "
            "least_range), or another camera"
        )

    def _tell_of_camera(self, estimate: InHandEstimate) -> None:
        if estimate.camera is None or self._camera is not None:
            return
        distance, sigma = estimate.camera.at((self._hands[-1] @ estimate.X_hand_ee)[:3, 3])
        advice = "; calibrate it again" if distance - 2.0 * sigma > CAMERA_OFF else ""
        off = f"{distance * 1e3:.0f} ± {sigma * 1e3:.0f} mm"
        self._observer.message(f"by the views the camera is {off} off at the tool, allowed for{advice}")

    def _plausible(self, estimate: ToolEstimate, X_camera_hand: Array) -> bool:
        """Whether it can be the striking face, not a club hammer's other face or a hammer on the table."""
        if not np.all(np.isfinite(estimate.X_camera_ee)):
            return True  # a detection without a pose: keep it, since its reason is reported
        displacement, misalignment = self._off_nominal(inverse(X_camera_hand) @ estimate.X_camera_ee)
        return displacement < 1.5 * self._largest and misalignment < 1.25 * MAX_MISALIGNMENT

    def _off_nominal(self, X_hand_ee: Array) -> tuple[float, float]:
        """Distance of the face's centre [m] and angle of its normal [rad] from those of the nominal grasp."""
        return (
            float(np.linalg.norm(X_hand_ee[:3, 3] - self._nominal[:3, 3])),
            angle_between(X_hand_ee[:3, 2], self._nominal[:3, 2]),
        )

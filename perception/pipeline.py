"""The perception pipeline: from frames to the poses of the end effectors, in the camera and in the hand.

perception = ToolPerception.load()
estimates = perception.estimate(frame, HoldingHand(X_camera_hand, R_hand_tool))  # one frame
in_hand = perception.fuse([estimates_1, estimates_2], [X_camera_hand_1, X_camera_hand_2])
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import PerceptionError, UserError
from toolee_robot.frames import Array, inverse
from toolee_robot.perception.cloud import check_depth_unit, ee_cloud
from toolee_robot.perception.detection.passes import Crop, hand_crop
from toolee_robot.perception.detection.segmenter import Segmenter
from toolee_robot.perception.pose import UNKNOWN_CAMERA, CloudEstimator, PoseEstimator, fuse_in_hand
from toolee_robot.perception.pose.tooleenet import PaperEstimator
from toolee_robot.perception.trust import Trust
from toolee_robot.types import CameraError, Detection, HoldingHand, InHandEstimate, RgbdFrame, ToolEstimate


class EeDetector(Protocol):
    """A detector of end effectors in RGB-D images; `Segmenter` is one."""

    def detect(
        self, frame: RgbdFrame, categories: Sequence[Category] = CATEGORIES, crop: Crop | None = None
    ) -> list[Detection]:
        """Detect end effectors.

        Args:
            frame: The frame.
            categories: The categories wanted.
            crop: The part of the frame to look at; None: all of it.

        Returns:
            The end effectors, with scores, and with masks in the whole frame's pixels.
        """


@dataclass(frozen=True)
class StageTimes:
    """Wall-clock time of the stages of one frame.

    Attributes:
        segmentation_ms: Detection and instance segmentation [ms].
        cloud_ms: Making the clouds of all detections [ms].
        pose_ms: Estimating the poses of all detections [ms].
        whole_image: Whether the detector looked at the whole image: because it was not told where the held tool can
            be, or found nothing usable there.
    """

    segmentation_ms: float
    cloud_ms: float
    pose_ms: float
    whole_image: bool


class ToolPerception:
    """Detector, cloud extraction and pose estimator in one.

    Stateless: the same frame gives the same estimates.

    Args:
        detector: Finds the end effectors and their masks.
        pose: Estimates a pose from a cloud.
        trust: The trust model fitted for this detector with this estimator; None: unfitted, the odds of both
            multiplied.
    """

    def __init__(self, detector: EeDetector, pose: CloudEstimator, trust: Trust | None = None) -> None:
        self.detector = detector
        self.pose = pose
        self.trust = trust or Trust()

    @classmethod
    def load(
        cls, weights_dir: Path | None = None, device: str = "cpu", estimator: Literal["ours", "tooleenet"] = "ours"
    ) -> ToolPerception:
        """The pipeline with trained weights.

        Args:
            weights_dir: Folder of weights; None: the shipped ones.
            device: torch device, e.g. "cpu" or "cuda".
            estimator: "tooleenet": the paper's pose estimator, to compare with. It learnt 42 tools in the published
                views, an upright tool in the middle of the image, and fails on others. It has no trust model.

        Returns:
            Detector, pose estimator and trust model, loaded.

        Raises:
            AssetError: A weight file is missing or damaged; the message names it.
            UserError: There is no such estimator.
        """
        if estimator not in ("ours", "tooleenet"):
            raise UserError(f'there is no estimator {estimator!r}: give "ours" or "tooleenet"')
        detector = Segmenter.load(weights_dir, device)
        if estimator == "tooleenet":
            return cls(detector, PaperEstimator.load_for_job(weights_dir, device))
        return cls(detector, PoseEstimator.load(weights_dir, device), Trust.load(weights_dir, weights_dir))

    def estimate(
        self, frame: RgbdFrame, hand: HoldingHand | None = None, categories: Sequence[Category] = CATEGORIES
    ) -> list[ToolEstimate]:
        """Estimate the pose of every detected end effector of the given categories.

        With a `HoldingHand.region` only the part of the image that shows it is looked at, and the whole image where
        nothing usable is found there.

        Args:
            frame: Colour image with registered depth [m].
            hand: The hand that holds the tool; fixes the spin of symmetric end effectors.
            categories: Categories to estimate; detections of others are skipped.

        Returns:
            One estimate per detection, the most trusted first; empty when nothing is detected. A detection without
            enough depth is listed as not usable, with the reason and a pose of NaN.

        Raises:
            UserError: The depth is not in metres.
        """
        return self.estimate_timed(frame, hand, categories)[0]

    def estimate_timed(
        self, frame: RgbdFrame, hand: HoldingHand | None = None, categories: Sequence[Category] = CATEGORIES
    ) -> tuple[list[ToolEstimate], StageTimes]:
        """Like `estimate`, and measure the stages.

        Args:
            frame: See `estimate`.
            hand: See `estimate`.
            categories: See `estimate`.

        Returns:
            The estimates, and the time that each stage took.

        Raises:
            UserError: The depth is not in metres.
        """
        check_depth_unit(frame.depth)
        crop = None
        if hand is not None and hand.region is not None:
            crop = hand_crop(hand.X_camera_hand, hand.region, frame.intrinsics)
        estimates, times = self._look(frame, hand, categories, crop)
        if crop is None or any(e.usable for e in estimates):
            return estimates, times
        estimates, more = self._look(frame, hand, categories, None)
        return estimates, StageTimes(
            times.segmentation_ms + more.segmentation_ms,
            times.cloud_ms + more.cloud_ms,
            times.pose_ms + more.pose_ms,
            whole_image=True,
        )

    def _look(
        self, frame: RgbdFrame, hand: HoldingHand | None, categories: Sequence[Category], crop: Crop | None
    ) -> tuple[list[ToolEstimate], StageTimes]:
        """Estimates from a crop of a frame, or from all of it, and the time that each stage took."""
        start = time.perf_counter()
        detections = self.detector.detect(frame, categories, crop)
        segmentation = time.perf_counter() - start
        estimates, cloud, pose = self.poses(frame, detections, hand)
        return estimates, StageTimes(1000 * segmentation, 1000 * cloud, 1000 * pose, crop is None)

    def poses(
        self, frame: RgbdFrame, detections: Sequence[Detection], hand: HoldingHand | None = None
    ) -> tuple[list[ToolEstimate], float, float]:
        """Estimate the poses of detections.

        Args:
            frame: The frame.
            detections: What was detected in it.
            hand: See `estimate`.

        Returns:
            The estimates as `estimate` gives them, and the time that clouds and poses took [s].
        """
        cloud_time = pose_time = 0.0
        estimates = []
        for detection in detections:
            start = time.perf_counter()
            cloud = ee_cloud(frame, detection)
            cloud_time += time.perf_counter() - start
            if not cloud.usable:
                estimates.append(_without_pose(detection, cloud.reason))
                continue
            start = time.perf_counter()
            try:
                result = self.pose.estimate(
                    cloud.points, detection.category, cloud.rest, hand, completed=cloud.completed
                )
            except PerceptionError as error:
                estimates.append(_without_pose(detection, str(error)))
                continue
            finally:
                pose_time += time.perf_counter() - start
            trust, usable, reason = self.trust.judge(detection.score, detection.tool_score, result)
            estimates.append(
                ToolEstimate(
                    detection,
                    result.X_camera_ee,
                    result.covariance,
                    result.confidence,
                    usable,
                    reason,
                    result.hypotheses,
                    trust,
                )
            )
        estimates.sort(key=_rank, reverse=True)
        return estimates, cloud_time, pose_time

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],
        Xs_camera_hand: Sequence[Array],
        category: Category | None = None,
        camera: CameraError | None = None,
        X_hand_ee_expected: Array | None = None,
    ) -> InHandEstimate:
        """Fuse estimates from several frames into one end effector's pose in the hand.

        A frame may show several end effectors of a category (both faces of a club hammer, a second tool); the one on
        which most frames agree is taken.

        Args:
            estimates_per_frame: The estimates of each frame, as `estimate` returns them.
            Xs_camera_hand: Pose of the hand in the camera frame, 4x4, at the exposure of each frame.
            category: The end effector wanted; None: the category with the largest summed confidence over all frames.
            camera: What an earlier result says of the error of the camera's calibration (its `camera`); None for a
                camera with which nothing was seen yet.
            X_hand_ee_expected: Rough guess of the result, 4x4, which tells two alike ends of a tool apart: poses more
                than 90 deg (modulo the symmetry) or 25 cm from it are discarded.

        Returns:
            The fused pose in the hand frame with its covariance, and the camera's error; see `fuse_in_hand`.

        Raises:
            PerceptionError: No frame has a pose of the end effector.
            ValueError: The numbers of frames and of hand poses differ.
        """
        if len(estimates_per_frame) != len(Xs_camera_hand):
            raise ValueError(f"{len(estimates_per_frame)} frames but {len(Xs_camera_hand)} hand poses")
        posed = [[e for e in frame if np.isfinite(e.X_camera_ee).all()] for frame in estimates_per_frame]
        if category is None:
            weights = {c: sum(e.confidence for f in posed for e in f if e.category == c) for c in Category}
            category = max(weights, key=lambda c: weights[c])
        candidates = [
            _Candidate(i, e, inverse(Xs_camera_hand[i]) @ e.X_camera_ee)
            for i, estimates in enumerate(posed)
            for e in estimates
            if e.category == category
        ]
        if X_hand_ee_expected is not None:
            candidates = [c for c in candidates if _near(c.X_hand_ee, X_hand_ee_expected, category)]
        if not candidates:
            reasons = {e.reason for f in estimates_per_frame for e in f if e.category == category}
            detail = f" ({'; '.join(sorted(reasons))})" if reasons else ""
            raise PerceptionError(
                f"none of {len(estimates_per_frame)} frames shows the {category.label}{detail}: move it into the "
                "camera's view, closer and unoccluded",
                code="perception.not_seen",
            )
        chosen = _same_end(candidates)
        hands = [Xs_camera_hand[c.frame] for c in chosen]
        fused = fuse_in_hand([c.estimate for c in chosen], hands, camera=camera or UNKNOWN_CAMERA)
        return replace(fused, frames_seen=len(estimates_per_frame))


@dataclass(frozen=True)
class _Candidate:
    """An estimate with its pose in the hand.

    Attributes:
        frame: Index of the frame it comes from.
        estimate: The estimate in the camera frame.
        X_hand_ee: Pose in the hand frame, 4x4.
    """

    frame: int
    estimate: ToolEstimate
    X_hand_ee: Array


def _near(X: Array, X_expected: Array, category: Category) -> bool:
    """Whether a pose is within 90 deg (modulo the symmetry) and 25 cm of the expected one."""
    angle = category.symmetry.rotation_error(X[:3, :3], X_expected[:3, :3])
    return bool(angle < np.pi / 2 and np.linalg.norm(X[:3, 3] - X_expected[:3, 3]) < 0.25)


def _same_end(candidates: list[_Candidate], radius: float = 0.02) -> list[_Candidate]:
    """One candidate per frame, all of the same end: the nearest to the position with the most support over all frames.

    Args:
        candidates: All candidates of one category, from all frames.
        radius: Candidates within this distance [m] of a position support it.
    """

    def nearest(center: _Candidate) -> list[_Candidate]:
        best: dict[int, _Candidate] = {}
        for c in sorted(candidates, key=lambda c: float(np.linalg.norm((c.X_hand_ee - center.X_hand_ee)[:3, 3]))):
            best.setdefault(c.frame, c)
        return list(best.values())

    def support(center: _Candidate) -> tuple[float, tuple[bool, float]]:
        inside = [c for c in nearest(center) if np.linalg.norm((c.X_hand_ee - center.X_hand_ee)[:3, 3]) < radius]
        return sum(c.estimate.usable + c.estimate.confidence for c in inside), _rank(center.estimate)

    return sorted(nearest(max(candidates, key=support)), key=lambda c: c.frame)


def _rank(estimate: ToolEstimate) -> tuple[bool, float]:
    return estimate.usable, estimate.trust


def _without_pose(detection: Detection, reason: str) -> ToolEstimate:
    nothing = np.full((4, 4), np.nan)
    return ToolEstimate(detection, nothing, np.full((6, 6), np.nan), 0.0, False, reason)

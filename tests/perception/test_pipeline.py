"""The pipeline: order of the stages, reasons for unusable estimates, fusion of the right end effector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.errors import raises
from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import PerceptionError, UserError
from toolee_robot.frames import transform
from toolee_robot.perception import ToolPerception
from toolee_robot.perception.detection.passes import Crop
from toolee_robot.perception.pose import PoseEstimator
from toolee_robot.perception.pose.confidence import FEATURES, ConfidenceModel
from toolee_robot.perception.pose.network import NetworkConfig, PoseNet
from toolee_robot.perception.pose.weights import Calibration
from toolee_robot.types import CameraIntrinsics, Detection, HeldRegion, HoldingHand, RgbdFrame, ToolEstimate

CAMERA = CameraIntrinsics(365.5, 365.5, 254.9, 205.4, 512, 424)


class ColourDetector:
    """Finds what is painted in one colour a category: a real, if simple, detector."""

    def __init__(self, score: float = 0.9) -> None:
        self._score = score
        self.crops: list[Crop | None] = []

    def detect(
        self,
        frame: RgbdFrame,
        categories: Sequence[Category] = CATEGORIES,
        crop: Crop | None = None,
    ) -> list[Detection]:
        self.crops.append(crop)
        shown, found = np.zeros(frame.depth.shape, bool), []
        shown[np.s_[:] if crop is None else np.s_[crop.y0 : crop.y1, crop.x0 : crop.x1]] = True
        for k, category in enumerate(Category):
            mask = (frame.rgb[:, :, 0] == 50 * (k + 1)) & shown
            if mask.any() and category in categories:
                found.append(Detection(category, self._score, mask, (0.0, 0.0, 1.0, 1.0), None))
        return found


@pytest.fixture(scope="module")
def perception() -> ToolPerception:
    torch.manual_seed(0)
    return ToolPerception(ColourDetector(), PoseEstimator(PoseNet(NetworkConfig())))


def frame(*discs: tuple[int, int, int], depth: float = 0.8) -> RgbdFrame:
    """Discs (category index, column, radius) at row 200."""
    rgb, z = np.zeros((424, 512, 3), np.uint8), np.full((424, 512), 2.0, np.float32)
    v, u = np.mgrid[:424, :512]
    for k, column, radius in discs:
        inside = (v - 200) ** 2 + (u - column) ** 2 <= radius**2
        rgb[inside], z[inside] = 50 * (k + 1), depth
    return RgbdFrame(rgb, z, CAMERA)


def test_every_detection_gets_a_pose_near_its_cloud(perception: ToolPerception) -> None:
    estimates, times = perception.estimate_timed(frame((0, 150, 14), (2, 350, 14)))
    assert {e.category for e in estimates} == {Category.HAMMER_HEAD, Category.SCREWDRIVER_HEAD}
    for e in estimates:
        np.testing.assert_allclose(e.X_camera_ee[2, 3], 0.8, atol=0.15)
        assert e.hypotheses is not None
    assert min(times.segmentation_ms, times.cloud_ms, times.pose_ms) > 0


def test_a_pose_under_a_doubtful_detection_is_not_usable() -> None:
    """However well the pose fits the cloud: the cloud may be of something else."""
    torch.manual_seed(0)
    n = len(FEATURES)
    sure = Calibration(confidence=ConfidenceModel((0.0,) * n, (1.0,) * n, (0.0,) * n, 2.0))
    pose = PoseEstimator(PoseNet(NetworkConfig()), sure)
    assert pose.calibration.confidence.probability(np.zeros(n)) == pytest.approx(0.88, abs=0.01)
    for score, usable in ((0.9, True), (0.2, True), (0.1, False), (0.01, False)):
        (estimate,) = ToolPerception(ColourDetector(score), pose).estimate(frame((0, 150, 14)))
        assert estimate.confidence == pytest.approx(0.88, abs=0.01), "the pose's own, if the detection is right"
        assert estimate.usable is usable is (estimate.trust >= 0.5)
        assert estimate.reason == "ok" if usable else f"score {score:.2f}" in estimate.reason


def test_the_same_frame_gives_the_same_estimates(perception: ToolPerception) -> None:
    a, b = perception.estimate(frame((0, 150, 14))), perception.estimate(frame((0, 150, 14)))
    np.testing.assert_array_equal(a[0].X_camera_ee, b[0].X_camera_ee)


def test_only_the_wanted_categories_are_estimated(perception: ToolPerception) -> None:
    estimates = perception.estimate(frame((0, 150, 14), (2, 350, 14)), categories=[Category.HAMMER_HEAD])
    assert [e.category for e in estimates] == [Category.HAMMER_HEAD]


def held_at(column: float) -> HoldingHand:
    """A hand at 0.8 m whose tool projects to `column` and row 200."""
    p = [(column - CAMERA.cx) / CAMERA.fx * 0.8, (200 - CAMERA.cy) / CAMERA.fy * 0.8, 0.8]
    return HoldingHand(transform(p=p), np.eye(3), HeldRegion(np.zeros((1, 3)), 0.1))


def sure_perception(detector: ColourDetector, logit: float = 2.0) -> ToolPerception:
    """Every pose that it estimates is usable, or with a negative logit none."""
    torch.manual_seed(0)
    n = len(FEATURES)
    sure = Calibration(confidence=ConfidenceModel((0.0,) * n, (1.0,) * n, (0.0,) * n, logit))
    return ToolPerception(detector, PoseEstimator(PoseNet(NetworkConfig()), sure))


def test_a_held_tool_is_looked_for_about_the_hand_only() -> None:
    """A second hammer in view costs no time and cannot be mistaken for the held one."""
    detector = ColourDetector()
    estimates, times = sure_perception(detector).estimate_timed(frame((0, 150, 14), (0, 400, 14)), held_at(150))
    assert [c is None for c in detector.crops] == [False]
    assert not times.whole_image
    (estimate,) = estimates
    assert estimate.usable
    assert estimate.detection.mask.shape == (CAMERA.height, CAMERA.width)
    columns = np.nonzero(estimate.detection.mask.any(0))[0]
    assert 130 < columns.min() < columns.max() < 170


@pytest.mark.parametrize("logit", [2.0, -2.0])
def test_where_nothing_usable_is_about_the_hand_the_whole_image_is_looked_at(logit: float) -> None:
    """The hand's pose may be wrong, or what is seen there not to be relied on."""
    detector = ColourDetector()
    seen = frame((0, 400, 14)) if logit > 0 else frame((0, 150, 14), (0, 400, 14))
    estimates, times = sure_perception(detector, logit).estimate_timed(seen, held_at(150))
    assert [c is None for c in detector.crops] == [False, True]
    assert times.whole_image
    assert [e.usable for e in estimates] == [logit > 0]


def test_a_hand_out_of_view_is_no_place_to_look() -> None:
    detector = ColourDetector()
    assert sure_perception(detector).estimate(frame((0, 150, 14)), held_at(1000))
    assert detector.crops == [None]


def test_a_mask_without_depth_is_listed_with_its_reason(perception: ToolPerception) -> None:
    seen = frame((0, 150, 14))
    depth = np.where(seen.rgb[:, :, 0] > 0, np.float32(np.nan), seen.depth)
    (estimate,) = perception.estimate(RgbdFrame(seen.rgb, depth, CAMERA))
    assert not estimate.usable
    assert "depth" in estimate.reason
    assert np.isnan(estimate.X_camera_ee).all()


def test_an_empty_view_and_millimetres(perception: ToolPerception) -> None:
    assert perception.estimate(frame()) == []
    seen = frame((0, 150, 14))
    with raises(UserError, code="user.depth_unit"):
        perception.estimate(RgbdFrame(seen.rgb, seen.depth * 1000, CAMERA))


def estimate(category: Category, x: float, usable: bool = True) -> ToolEstimate:
    found = Detection(category, 0.9, np.zeros((2, 2), bool), (0, 0, 1, 1))
    X = transform(None, [x, 0.0, 0.7])
    return ToolEstimate(found, X, np.eye(6) * 1e-5, 0.9 if usable else 0.2, usable, "ok" if usable else "spread")


def test_fusion_takes_the_wanted_end_effector_of_each_frame(perception: ToolPerception) -> None:
    head, claw = Category.HAMMER_HEAD, Category.HAMMER_GRIP
    frames = [
        [estimate(claw, 0.3), estimate(head, 0.10)],
        [estimate(head, 0.5, usable=False), estimate(head, 0.10)],
        [],
    ]
    fused = perception.fuse(frames, [np.eye(4)] * 3, head)
    assert fused.category == head
    assert fused.usable
    assert (fused.frames_used, fused.frames_seen) == (2, 3)
    np.testing.assert_allclose(fused.X_hand_ee[:3, 3], [0.10, 0, 0.7], atol=1e-6)
    assert perception.fuse(frames, [np.eye(4)] * 3).category == head, "seen with the most confidence"


def test_fusion_stays_on_one_of_two_like_ends(perception: ToolPerception) -> None:
    """A club hammer has two faces; each frame trusts another one more, but most frames show the first."""
    head = Category.HAMMER_HEAD
    near, far = [estimate(head, x) for x in (0.10, 0.101, 0.099)], [estimate(head, 0.2) for _ in range(2)]
    frames = [[near[0]], [far[0], near[1]], [far[1], near[2]]]
    fused = perception.fuse(frames, [np.eye(4)] * 3, head)
    np.testing.assert_allclose(fused.X_hand_ee[:3, 3], [0.10, 0, 0.7], atol=2e-3)
    assert fused.frames_used == 3


def test_an_expected_pose_rules_out_the_opposite_end(perception: ToolPerception) -> None:
    head = Category.HAMMER_HEAD
    back = estimate(head, 0.1)
    flipped = replace(back, X_camera_ee=transform(np.diag([1.0, -1.0, -1.0]), [0.1, 0.0, 0.7]))
    expected = transform(None, [0.1, 0.0, 0.7])
    fused = perception.fuse([[flipped, back], [flipped]], [np.eye(4)] * 2, head, X_hand_ee_expected=expected)
    assert (fused.frames_used, fused.frames_seen) == (1, 2)
    np.testing.assert_allclose(fused.X_hand_ee[:3, 2], [0, 0, 1], atol=1e-6)


def test_fusing_frames_without_the_tool_is_refused(perception: ToolPerception) -> None:
    with raises(PerceptionError, code="perception.not_seen"):
        perception.fuse([[], []], [np.eye(4)] * 2)

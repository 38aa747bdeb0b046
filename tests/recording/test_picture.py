"""The picture shows the frame, the masks and the nail, and copes with whatever a job leaves to be shown."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from toolee_robot.end_effectors import Category
from toolee_robot.frames import transform
from toolee_robot.recording.picture import NailCurve, draw
from toolee_robot.types import CameraIntrinsics, Detection, PoseHypotheses, RgbdFrame, ToolEstimate

_K = CameraIntrinsics(365.5, 365.5, 254.9, 205.4, 512, 424)
_BLUE = (40, 60, 200)


def _frame() -> RgbdFrame:
    return RgbdFrame(np.full((424, 512, 3), _BLUE, np.uint8), np.full((424, 512), 0.6, np.float32), _K)


def _estimate(category: Category = Category.HAMMER_HEAD, *, points: int = 200) -> ToolEstimate:
    rng = np.random.default_rng(1)
    X = transform(None, [0.05, 0.04, 0.6])
    mask = np.zeros((424, 512), np.bool_)
    mask[210:250, 270:310] = True
    cloud = X[:3, 3] + rng.normal(0.0, 0.01, (points, 3))
    Xs = np.stack([X @ transform(None, rng.normal(0, 0.002, 3)) for _ in range(8)])
    detection = Detection(category, 0.9, mask, (270.0, 210.0, 310.0, 250.0))
    return ToolEstimate(detection, X, np.eye(6) * 1e-6, 0.8, True, "ok", PoseHypotheses(Xs, cloud, 1e-3, 0.02, 0.1))


def _pixels(png: bytes) -> NDArray[np.uint8]:
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image[:, :, ::-1], dtype=np.uint8)


def _share(image: NDArray[np.uint8], colour: tuple[int, int, int], tolerance: int = 6) -> float:
    return float(np.mean(np.all(np.abs(image.astype(int) - colour) <= tolerance, axis=-1)))


def test_the_camera_image_is_there_and_the_mask_is_tinted() -> None:
    plain, found = _pixels(draw(_frame(), [])), _pixels(draw(_frame(), [_estimate()]))
    assert _share(plain, _BLUE) > 0.25
    tint = tuple((c + t) // 2 for c, t in zip(_BLUE, (0xFF, 0x9F, 0x1C), strict=True))
    assert _share(plain, tint) < 1e-4  # type: ignore[arg-type]
    assert _share(found, tint) > 0.003  # type: ignore[arg-type]


def test_the_nail_takes_a_panel_of_its_own() -> None:
    two = _pixels(draw(_frame(), [_estimate()]))
    three = _pixels(draw(_frame(), [_estimate()], [NailCurve((20.0, 12.0, 5.0, 0.8), 1.0)]))
    assert three.shape[1] == pytest.approx(1.5 * two.shape[1], abs=2)
    wood = (0xD9, 0xB4, 0x8A)
    assert _share(two, wood) < 1e-4
    assert _share(three, wood) > 0.01


@pytest.mark.parametrize("protrusion", [(), (20.0,), (20.0, 20.0), (20.0, None, None, -0.3)])
def test_any_number_of_strikes_can_be_drawn(protrusion: tuple[float | None, ...]) -> None:
    assert _pixels(draw(_frame(), [], [NailCurve(protrusion, 1.0)])).size


def test_a_box_over_the_edge_a_tiny_cloud_and_several_tools_can_be_drawn() -> None:
    head, claw = _estimate(points=3), _estimate(Category.HAMMER_GRIP)
    edge = Detection(Category.HAMMER_GRIP, 0.5, claw.detection.mask, (-5.0, 400.0, 9.0, 424.0))
    behind = ToolEstimate(edge, transform(None, [0.0, 0.0, 0.01]), claw.covariance, 0.1, True, "ok")
    assert _pixels(draw(_frame(), [head, claw, behind], title="t", note="n")).size


def test_a_job_that_took_no_image_has_a_picture_too() -> None:
    assert _pixels(draw(None, [], [NailCurve((20.0,), 1.0)], title="Person near after 0 strikes")).size


def test_a_detection_without_a_pose_says_why_instead() -> None:
    detection = _estimate().detection
    nothing = ToolEstimate(detection, np.full((4, 4), np.nan), np.full((6, 6), np.nan), 0.0, False, "only 12 points")
    assert _pixels(draw(_frame(), [nothing], [NailCurve((20.0,), 1.0)])).size

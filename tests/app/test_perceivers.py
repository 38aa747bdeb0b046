"""What a variant of a job leaves out of its perception, and what it keeps."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.errors import raises
from toolee_robot.app.perceivers import AlteredPoses, job_perceiver
from toolee_robot.app.variant import Variant
from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, transform
from toolee_robot.station import sim_station
from toolee_robot.types import (
    CameraError,
    CameraIntrinsics,
    Detection,
    HoldingHand,
    InHandEstimate,
    RgbdFrame,
    ToolEstimate,
)

NOMINAL = transform(Rotation.from_rotvec([0.1, 0.2, 0.3]), [0.24, 0.0, 0.03])
SEEN = transform(Rotation.from_rotvec([0.3, 0.1, 0.2]), [0.25, 0.01, 0.02])


class Sees:
    """A perceiver that has seen the face."""

    def estimate(
        self, frame: RgbdFrame, hand: HoldingHand | None = None, categories: Sequence[Category] = CATEGORIES
    ) -> list[ToolEstimate]:
        raise NotImplementedError

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],  # noqa: ARG002
        Xs_camera_hand: Sequence[Array],  # noqa: ARG002
        category: Category | None = None,  # noqa: ARG002
        camera: CameraError | None = None,  # noqa: ARG002
    ) -> InHandEstimate:
        return InHandEstimate(Category.HAMMER_HEAD, SEEN, np.eye(6) * 1e-6, 0.9, 6, 6, True, "ok")


def opened() -> Any:
    """What a perceiver needs of the open devices of a real station."""
    grasp = SimpleNamespace(X_hand_ee=NOMINAL, ee_off=None)
    return SimpleNamespace(config=sim_station(), grasp=grasp, truth=None, shape=None)


@pytest.mark.parametrize(
    ("variant", "place", "turn"),
    [
        (Variant.FULL, SEEN, SEEN),
        (Variant.POSITION_ONLY, SEEN, NOMINAL),
        (Variant.NORMAL_ONLY, NOMINAL, SEEN),
        (Variant.ONE_VIEW, SEEN, SEEN),
        (Variant.PAPER, SEEN, SEEN),
    ],
)
def test_the_rest_of_the_pose_is_nominal(variant: Variant, place: Array, turn: Array) -> None:
    perceiver, config = job_perceiver(variant, Sees(), opened())
    X = perceiver.fuse([], []).X_hand_ee
    np.testing.assert_array_equal(X[:3, 3], place[:3, 3])
    np.testing.assert_allclose(X[:3, :3], turn[:3, :3], atol=1e-12)
    assert (config.task.views == 1) == (variant is Variant.ONE_VIEW)


@pytest.mark.parametrize(("variant", "networks"), [(Variant.PERFECT_PERCEPTION, None), (Variant.ICP, Sees())])
def test_what_only_a_simulation_knows_is_refused_on_a_robot(variant: Variant, networks: Sees | None) -> None:
    with raises(UserError, code="user.no_truth") as refused:
        job_perceiver(variant, networks, opened())
    assert "only a simulation knows" in str(refused.value)


class SeesTwo(Sees):
    """A perceiver that sees one end effector with a pose and one without."""

    def estimate(
        self,
        frame: RgbdFrame,  # noqa: ARG002
        hand: HoldingHand | None = None,  # noqa: ARG002
        categories: Sequence[Category] = CATEGORIES,  # noqa: ARG002
    ) -> list[ToolEstimate]:
        detections = [
            Detection(Category.HAMMER_HEAD, score, np.zeros((2, 2), bool), (0, 0, 1, 1)) for score in (0.9, 0.1)
        ]
        poses = SEEN, np.full((4, 4), np.nan)
        return [ToolEstimate(d, X, np.eye(6), 0.9, True, "ok") for d, X in zip(detections, poses, strict=True)]


def test_another_estimator_gets_the_nominal_pose_and_replaces_the_networks() -> None:
    X_camera_hand = transform(Rotation.from_rotvec([0.0, 0.4, 0.0]), [0.0, 0.1, 0.5])
    shift = transform(p=[0.0, 0.0, 0.01])
    depth = np.ones((2, 2), np.float32)
    frame = RgbdFrame(np.zeros((2, 2, 3), np.uint8), depth, CameraIntrinsics(2.0, 2.0, 1.0, 1.0, 2, 2), 0.0)
    perceiver = AlteredPoses(SeesTwo(), NOMINAL, lambda _, __, nominal: nominal @ shift)
    posed, unposed = perceiver.estimate(frame, HoldingHand(X_camera_hand, np.eye(3)))
    np.testing.assert_allclose(posed.X_camera_ee, X_camera_hand @ NOMINAL @ shift)
    assert posed.detection.score == 0.9
    assert np.isnan(unposed.X_camera_ee).all(), "what has no pose keeps the reason why"
    np.testing.assert_array_equal(perceiver.fuse([], []).X_hand_ee, SEEN)

"""What an ablation leaves out, and what it keeps."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.errors import raises
from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, transform
from toolee_robot.station import sim_station
from toolee_robot.tasks.hammering.ablation import Ablation, ablated
from toolee_robot.tasks.hammering.learnt_grasp import LEAST_JOBS, learn_shift
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


@pytest.mark.parametrize(
    ("ablation", "place", "turn"),
    [
        (None, SEEN, SEEN),
        (Ablation.POSITION_ONLY, SEEN, NOMINAL),
        (Ablation.NORMAL_ONLY, NOMINAL, SEEN),
        (Ablation.ONE_VIEW, SEEN, SEEN),
        (Ablation.PAPER, SEEN, SEEN),
    ],
)
def test_the_rest_of_the_pose_is_nominal(ablation: Ablation | None, place: Array, turn: Array) -> None:
    perceiver, config = ablated(ablation, Sees(), sim_station(), NOMINAL)
    X = perceiver.fuse([], []).X_hand_ee
    np.testing.assert_array_equal(X[:3, 3], place[:3, 3])
    np.testing.assert_allclose(X[:3, :3], turn[:3, :3], atol=1e-12)
    assert (config.task.views == 1) == (ablation is Ablation.ONE_VIEW)


def _run(folder: Path, X_hand_ee: Array, seed: int, hand: str = "inspire", **other: Any) -> None:
    folder.mkdir(parents=True)
    looks = {"looks": [{"X_hand_ee": X_hand_ee.tolist()}], "nominal_X_hand_ee": NOMINAL.tolist()}
    whole = {"correction": True, "perfect_perception": False, "ablation": None}
    (folder / "summary.json").write_text(json.dumps({"hand": hand, "seed": seed, **looks, **whole, **other}))


def test_a_job_believes_where_the_hand_moved_earlier_tools_in_the_mean(tmp_path: Path) -> None:
    """Fingers that close move every tool by 8 mm and 0.1 rad; hand-overs scatter about that."""
    shift = transform(Rotation.from_rotvec([0.0, 0.0, 0.1]), [0.0, 0.008, 0.0])
    for i in range(12):
        by = 1 if i % 2 else -1
        scatter = transform(Rotation.from_rotvec([0.05 * by, 0.0, 0.0]), [0.02 * by, 0.0, 0.0])
        _run(tmp_path / "trials" / f"run{i}", shift @ scatter @ NOMINAL, i)
    _run(tmp_path / "trials" / "other", SEEN, 20, hand="shadow")
    learnt = learn_shift(tmp_path, "inspire")
    assert learnt.jobs == 12
    assert learnt.spread == pytest.approx((0.02, 0.05), rel=0.01)
    perceiver, _ = ablated(Ablation.LEARNT_GRASP, Sees(), sim_station(), NOMINAL, shift=learnt)
    np.testing.assert_allclose(perceiver.fuse([], []).X_hand_ee, shift @ NOMINAL, atol=1e-4)
    with raises(UserError, code="user.too_few_runs"):
        learn_shift(tmp_path, "shadow")


@pytest.mark.parametrize(
    "other",
    [
        {"correction": False},
        {"perfect_perception": True},
        {"ablation": "normal_only"},
        {"nominal_X_hand_ee": None},
        {"seed": 0},
        {"looks": []},
    ],
)
def test_a_job_that_does_not_tell_of_another_hand_over_does_not_count(tmp_path: Path, other: dict[str, Any]) -> None:
    for i in range(LEAST_JOBS):
        _run(tmp_path / f"run{i}", SEEN, i)
    before = learn_shift(tmp_path, "inspire").figures
    _run(tmp_path / "the_last", NOMINAL, **{"seed": 99, **other})
    _run(tmp_path / ".unfinished", NOMINAL, 98)
    assert learn_shift(tmp_path, "inspire").figures == before


def test_a_mean_of_too_few_jobs_is_refused(tmp_path: Path) -> None:
    for i in range(LEAST_JOBS - 1):
        _run(tmp_path / f"run{i}", SEEN, i)
    with raises(UserError, code="user.too_few_runs"):
        learn_shift(tmp_path, "inspire")
    _run(tmp_path / "last", SEEN, LEAST_JOBS)
    assert learn_shift(tmp_path, "inspire").jobs == LEAST_JOBS
    (tmp_path / "last" / "summary.json").write_text("{")
    with raises(UserError, code="user.unreadable_run"):
        learn_shift(tmp_path, "inspire")


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


@pytest.mark.parametrize("ablation", [Ablation.MASK_CENTROID, Ablation.ICP])
def test_another_estimator_gets_the_nominal_pose_and_replaces_the_networks(ablation: Ablation) -> None:
    X_camera_hand = transform(Rotation.from_rotvec([0.0, 0.4, 0.0]), [0.0, 0.1, 0.5])
    shift = transform(p=[0.0, 0.0, 0.01])
    depth = np.ones((2, 2), np.float32)
    frame = RgbdFrame(np.zeros((2, 2, 3), np.uint8), depth, CameraIntrinsics(2.0, 2.0, 1.0, 1.0, 2, 2), 0.0)
    perceiver, _ = ablated(ablation, SeesTwo(), sim_station(), NOMINAL, lambda _, __, nominal: nominal @ shift)
    posed, unposed = perceiver.estimate(frame, HoldingHand(X_camera_hand, np.eye(3)))
    np.testing.assert_allclose(posed.X_camera_ee, X_camera_hand @ NOMINAL @ shift)
    assert posed.detection.score == 0.9
    assert np.isnan(unposed.X_camera_ee).all(), "what has no pose keeps the reason why"
    np.testing.assert_array_equal(perceiver.fuse([], []).X_hand_ee, SEEN)

"""What an ablation leaves out, and what it keeps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toolee_robot.config import StationConfig
from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import Array, transform
from toolee_robot.tasks.hammering.ablation import Ablation, ablated
from toolee_robot.types import HoldingHand, InHandEstimate, RgbdFrame, ToolEstimate

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
    ) -> InHandEstimate:
        return InHandEstimate(Category.HAMMER_HEAD, SEEN, np.eye(6) * 1e-6, 0.9, 6, 6, True, "ok")


@pytest.mark.parametrize(
    ("ablation", "place", "turn"),
    [
        (None, SEEN, SEEN),
        (Ablation.POSITION_ONLY, SEEN, NOMINAL),
        (Ablation.NORMAL_ONLY, NOMINAL, SEEN),
        (Ablation.ONE_VIEW, SEEN, SEEN),
        (Ablation.MASK_CENTROID, SEEN, SEEN),
        (Ablation.ICP, SEEN, SEEN),
    ],
)
def test_the_rest_of_the_pose_is_nominal(ablation: Ablation | None, place: Array, turn: Array) -> None:
    perceiver, config = ablated(ablation, Sees(), StationConfig(), NOMINAL)
    X = perceiver.fuse([], []).X_hand_ee
    np.testing.assert_array_equal(X[:3, 3], place[:3, 3])
    np.testing.assert_allclose(X[:3, :3], turn[:3, :3], atol=1e-12)
    assert (config.task.views == 1) == (ablation is Ablation.ONE_VIEW)

"""Which images of a board that somebody holds count: still ones, each in a new way, from all over the image."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.calibration.pictures import BOARD, CAMERA, picture
from toolee_robot.frames import transform
from toolee_robot.tasks.calibration.collect import HandHeldViews, Offered

SIZE = (CAMERA.width, CAMERA.height)


def held(u: float, v: float, tilt: float = 0.4) -> NDArray[np.uint8]:
    """The board with its middle at a place in the image, as shares of its size."""
    R = Rotation.from_rotvec([0.1, tilt, 0.0])
    center = 0.55 * CAMERA.intrinsics.rays(np.array([u * SIZE[0], v * SIZE[1]]))
    return np.repeat(picture(BOARD, transform(R, center - R.as_matrix() @ BOARD.center))[..., None], 3, axis=2)


@pytest.fixture
def views() -> HandHeldViews:
    return HandHeldViews(BOARD, SIZE, 6)


def test_only_a_still_board_in_a_new_place_counts(views: HandHeldViews) -> None:
    empty = np.full((SIZE[1], SIZE[0], 3), 120, np.uint8)
    here, there = held(0.5, 0.5), held(0.3, 0.3)
    offered = [views.offer(image) for image in (empty, here, here, here, there, there, here, here)]
    assert offered == [
        Offered.UNSEEN, Offered.MOVING, Offered.TAKEN, Offered.KNOWN,
        Offered.MOVING, Offered.TAKEN, Offered.MOVING, Offered.KNOWN,
    ]  # fmt: skip
    assert len(views.views) == 2


def test_it_ends_when_every_corner_of_the_image_was_seen(views: HandHeldViews) -> None:
    for u, v in ((0.12, 0.14), (0.12, 0.86), (0.5, 0.4), (0.5, 0.6), (0.88, 0.14), (0.88, 0.86)):
        assert not views.complete
        assert "lower right" in views.lacking
        views.offer(held(u, v))
        assert views.offer(held(u, v)) is Offered.TAKEN
    assert views.complete
    assert views.lacking == []
    assert views.covered > 0.8

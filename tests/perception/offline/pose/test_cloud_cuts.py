"""What synthetic clouds show: cuts, borders and splats."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from toolee_robot.frames import transform
from toolee_robot.perception.offline.synthesis.example import _Reach
from toolee_robot.perception.offline.synthetic_clouds.point_splatting import GRID, measure
from toolee_robot.perception.offline.synthetic_clouds.scene import Cut
from toolee_robot.perception.offline.synthetic_clouds.surface_samples import NOWHERE
from toolee_robot.types import CameraIntrinsics

CAMERA = CameraIntrinsics(365.0, 365.0, 31.5, 31.5, 64, 64)


@given(st.integers(0, 2**31), st.booleans(), st.floats(0.05, 0.14))
@examples(40)
def test_a_cut_holds_the_pixels_that_the_data_sets_mask_shows(seed: int, circle: bool, apart: float) -> None:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.5, 0.62, (64, 64)).astype(np.float32)
    direction = rng.normal(size=3)
    origins = np.array([[0.0, 0.0, 0.56], [0.0, 0.0, 0.56] + apart * direction / np.linalg.norm(direction)])
    radii = np.array([rng.uniform(0.02, 0.06)] * 2 if circle else rng.uniform(0.02, 0.06, 2))
    pixels = CAMERA.fx * radii[0] / origins[0, 2] if circle else None
    v, u = np.indices(depth.shape)
    Xs = [transform(np.eye(3), p) for p in origins]
    rows, columns, own = _Reach(Xs, radii, pixels).within(depth, v.ravel(), u.ravel(), CAMERA)
    first = np.zeros(depth.shape, bool)
    first[rows[own == 0], columns[own == 0]] = True

    points = np.stack([(u - CAMERA.cx) / CAMERA.fx * depth, (v - CAMERA.cy) / CAMERA.fy * depth, depth], -1)
    focus, other = torch.as_tensor(origins, dtype=torch.float32)[:, None]
    radius, other_radius = torch.as_tensor(radii, dtype=torch.float32)[:, None]
    cut = Cut(focus, radius, other, other_radius, torch.tensor([circle]))
    held = cut.holds(torch.as_tensor(points.reshape(1, -1, 3), dtype=torch.float32))[0].numpy().reshape(64, 64)
    # Rounding decides of a pixel on the very edge.
    assert np.count_nonzero(held != first) <= 3


@given(st.integers(0, 2**31))
@examples(20)
def test_a_tool_with_one_end_loses_nothing_to_another(seed: int) -> None:
    focus = torch.tensor([[0.1, 0.0, 0.6]])
    points = focus[:, None] + 0.03 * torch.randn(1, 50, 3, generator=torch.Generator().manual_seed(seed)).clamp(-1, 1)
    # Behind the focus as the camera sees it, and a little beside.
    other = NOWHERE * focus / focus[:, 2:] + torch.tensor([[NOWHERE / 40, 0.0, 0.0]])
    for circle in (False, True):
        cut = Cut(focus, torch.tensor([0.1]), other, torch.tensor([0.05]), torch.tensor([circle]))
        assert bool(cut.holds(points).all())


@pytest.mark.parametrize("z", [0.5, 0.8, 1.1])
@pytest.mark.parametrize("degrees", [0.0, 40.0, 65.0])
def test_axial_noise_has_the_published_deviation(z: float, degrees: float) -> None:
    depth = torch.full((4, GRID, GRID), z)
    theta = np.deg2rad(degrees)
    cosine = torch.full_like(depth, float(np.cos(theta)))
    generator = torch.Generator().manual_seed(1)
    read = measure(depth, cosine, torch.zeros(4), torch.full((4,), 365.0), generator, level=1.0)
    expected = 1e-3 * (1.5 - 0.5 * z + 0.3 * z**2 + 0.1 * z**1.5 * theta**2 / (np.pi / 2 - theta) ** 2)
    inner = read[:, 8:-8, 8:-8]
    assert float(inner[inner > 0].std()) == pytest.approx(expected, rel=0.05)

"""The sensor of the training clouds has the noise of `depth_noise`, as the renderer's has."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from toolee_robot.perception.offline.synthetic_clouds.point_splatting import GRID, measure


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


def test_without_noise_the_depth_is_read_as_it_is() -> None:
    depth = torch.full((1, GRID, GRID), 0.8)
    generator = torch.Generator().manual_seed(1)
    read = measure(depth, torch.ones_like(depth), torch.zeros(1), torch.tensor([365.0]), generator, level=0.0)
    torch.testing.assert_close(read, depth)

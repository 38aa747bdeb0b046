"""Depth completion: pixels of a mask without measured depth take it from their measured neighbours.

A depth camera loses shiny, steep and edge pixels: in `hard` scenes 32 % of the EEs' pixels, three quarters of them
within two pixels of the outline, which shows where a wrench's jaws point.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

RINGS = 3
"""Pixels up to so far from a measured one are completed; farther ones would be extrapolated."""
_STEP, _RELATIVE_STEP = 0.012, 0.01
_Depth = TypeVar("_Depth", Tensor, NDArray[np.float32])


def surface_step(depth: _Depth) -> _Depth:
    """Largest depth difference [m] between neighbouring pixels of one surface at `depth` [m]: 12 mm + 1 %."""
    return _STEP + _RELATIVE_STEP * depth


def complete_depth(depth: Tensor, known: Tensor, wanted: Tensor, rings: int = RINGS) -> Tensor:
    """Complete the depth of pixels without a measurement.

    Ring by ring, an unknown pixel takes the mean of the nearest surface among its eight neighbours: those within
    `surface_step` of the nearest one, so that a pixel on the outline belongs to the tool and not to the background.

    Args:
        depth: (B, H, W) [m], valid at the known pixels.
        known: Pixels with a measured depth, (B, H, W) bool.
        wanted: Pixels to complete, (B, H, W) bool.
        rings: Largest distance [px] from a known pixel.

    Returns:
        Completed depths (B, H, W) [m]; 0 elsewhere and where no known pixel is within reach.
    """
    height, width = depth.shape[-2:]
    z = torch.where(known, depth, torch.inf)
    for _ in range(rings):
        padded = F.pad(z, (1, 1, 1, 1), value=torch.inf)
        around = torch.stack([padded[:, i : i + height, j : j + width] for i in range(3) for j in range(3)], 1)
        nearest = around.min(1, keepdim=True)[0]
        same = around < nearest + surface_step(nearest)
        mean = torch.where(same, around, 0.0).sum(1) / same.sum(1).clamp(min=1)
        z = torch.where(wanted & torch.isinf(z) & torch.isfinite(nearest[:, 0]), mean, z)
    return torch.where(wanted & ~known & torch.isfinite(z), z, 0.0)

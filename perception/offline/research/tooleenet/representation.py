"""The paper's pose vector: [Rx | Ry | S | T] in R^12, or [Rx | Ry | T] in R^9 without symmetry. T in metres."""

from __future__ import annotations

import torch
from torch import Tensor

from toolee_robot.end_effectors import Category
from toolee_robot.symmetry import SymmetryKind


def class_ambiguity() -> Tensor:
    """S (4, 3) of each category: a constant of the class, 1 about the axis of its symmetry group."""
    rows = [
        [0.0, 0.0, 0.0] if c.symmetry.kind is SymmetryKind.NONE else [float(a != 0) for a in c.symmetry.axis]
        for c in Category
    ]
    return torch.tensor(rows)


def encode(R: Tensor, p: Tensor, ambiguous: Tensor | None) -> Tensor:
    """Encode poses as vectors: the first two columns of the rotation, the ambiguity, the translation.

    Args:
        R: Rotations, (..., 3, 3).
        p: Translations, (..., 3) [m].
        ambiguous: Ambiguity vectors S, (..., 3); None: without.

    Returns:
        Pose vectors u, (..., 12); (..., 9) without S.
    """
    parts = [R[..., :, 0], R[..., :, 1], p] if ambiguous is None else [R[..., :, 0], R[..., :, 1], ambiguous, p]
    return torch.cat(parts, dim=-1)


def decode(u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """R (..., 3, 3) by Gram-Schmidt with x first, p (..., 3) [m] and S (..., 3), zero for u (..., 9)."""
    x = _unit(u[..., 0:3])
    b = u[..., 3:6]
    y = _unit(b - (b * x).sum(-1, keepdim=True) * x)
    R = torch.stack([x, y, torch.cross(x, y, dim=-1)], dim=-1)
    S = u[..., 6:9] if u.shape[-1] == 12 else torch.zeros_like(u[..., 6:9])
    return R, u[..., -3:], S


def _unit(v: Tensor) -> Tensor:
    return v / v.norm(dim=-1, keepdim=True).clamp_min(1e-8)

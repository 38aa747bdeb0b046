"""A point of what hangs on the flange, by touches of one fixed point in several orientations; lists of touches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from toolee_robot.calibration.hand_eye.motion_spread import MIN_ROTATION, motion_spread
from toolee_robot.calibration.record import Row
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.yaml_files import read_record

MIN_TOUCHES = 5
"""Fewest touches: four determine the tip, one more tells whether they agree."""
LARGEST_RESIDUAL = 2e-3
"""Root mean square distance of the tips from their common point above which something has slipped [m]."""


@dataclass(frozen=True)
class Touches:
    """Joint positions at which a tip was on what it touched.

    Attributes:
        touches: Joint positions as the robot reports them, (6,) [rad] each.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012  (read by pydantic, not a field)
    touches: tuple[Row, ...]

    def __post_init__(self) -> None:
        if any(len(q) != 6 for q in self.touches):
            raise ValueError("every touch has six joint positions")


@dataclass(frozen=True, eq=False)
class Tip:
    """A tip on the flange.

    Attributes:
        p_flange_tip: Its place in the flange, (3,) [m].
        p_base_point: Place of the fixed point in `base`, (3,) [m].
        covariance: Covariance of `p_flange_tip`, (3, 3) [m^2].
        residual: Root mean square distance of the tips from the fixed point [m].
        residuals: The distance at each touch, (N,) [m].
    """

    p_flange_tip: Array
    p_base_point: Array
    covariance: Array
    residual: float
    residuals: Array


def read_touches(path: Path) -> Touches:
    """Read a list of touches.

    Args:
        path: A YAML or JSON file.

    Returns:
        The touches.

    Raises:
        ConfigError: It cannot be read, or is no list of six joint positions each.
    """
    return read_record(path, Touches, "list of touches")


def add_touch(path: Path, q: Array) -> int:
    """Add a touch to a list of touches, which is begun where there is none.

    Args:
        path: The YAML file; comments in it are not kept.
        q: Joint positions at the touch, (6,) [rad].

    Returns:
        Number of touches in the list now.

    Raises:
        ConfigError: There is a file, and it is no list of touches.
        UserError: The file cannot be written.
    """
    touches = [list(row) for row in read_touches(path).touches] if path.exists() else []
    touches.append([round(float(v), 6) for v in q])
    rows = "".join(f"  - [{', '.join(str(v) for v in row)}]\n" for row in touches)
    write_atomic(path, f"touches:\n{rows}".encode())
    return len(touches)


def locate_tip(Xs_base_flange: Sequence[Array]) -> Tip:
    """Locate the tip: R_i p_flange_tip + p_i = p_base_point for every touch i, by least squares.

    Args:
        Xs_base_flange: Poses of the flange with the tip on the fixed point, (4, 4) each.

    Returns:
        The tip.

    Raises:
        UserError: There are too few touches (`user.tip_few_touches`), they turn the flange too little
            (`user.tip_degenerate`), or do not agree (`user.tip_residual`).
    """
    if len(Xs_base_flange) < MIN_TOUCHES:
        raise UserError(f"{len(Xs_base_flange)} touches: give {MIN_TOUCHES} or more", code="user.tip_few_touches")
    spread = motion_spread(Xs_base_flange)
    if not spread.sufficient:
        raise UserError(
            f"the touches turn the flange by {np.rad2deg(spread.first):.0f}° and by {np.rad2deg(spread.second):.0f}° "
            f"about an axis across it: {np.rad2deg(MIN_ROTATION):.0f}° about both are needed, or the tip is "
            "undetermined along an axis",
            code="user.tip_degenerate",
        )
    X = np.asarray(Xs_base_flange)
    A = np.concatenate([X[:, :3, :3], np.tile(-np.eye(3), (len(X), 1, 1))], axis=2).reshape(-1, 6)
    solution, *_ = np.linalg.lstsq(A, -X[:, :3, 3].ravel(), rcond=None)
    off = (A @ solution + X[:, :3, 3].ravel()).reshape(-1, 3)
    residuals = np.linalg.norm(off, axis=1)
    residual = float(np.sqrt(np.mean(residuals**2)))
    if residual > LARGEST_RESIDUAL:
        raise UserError(
            f"the touches are {residual * 1e3:.1f} mm apart, touch {int(np.argmax(residuals)) + 1} the most: did the "
            "tip leave the point, or are these another arm's kinematics?",
            code="user.tip_residual",
        )
    variance = float(np.sum(off**2)) / (A.shape[0] - A.shape[1])
    covariance = variance * np.linalg.inv(A.T @ A)[:3, :3]
    return Tip(solution[:3], solution[3:], covariance, residual, residuals)

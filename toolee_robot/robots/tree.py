"""A kinematic tree of links with shapes and inertia, and its forward kinematics in plain numpy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from toolee_robot.frames import Array

FLANGE_FRAME = "tool0"
"""Name of the arm's last link, which carries the hand."""


def _rotations(axes: Array, angles: Array) -> Array:
    """Rodrigues' formula, (n, 3, 3) of axes (n, 3) and angles (n,); scipy's Rotation costs ten times as much."""
    x, y, z = axes.T
    c, s = np.cos(angles), np.sin(angles)
    t = 1.0 - c
    rows = [
        [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
        [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
        [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
    ]
    return np.array(rows).transpose(2, 0, 1)


@dataclass(frozen=True)
class Shape:
    """A shape on a link. kind: "box" (size: full extents), "cylinder" (radius, length; along z), "sphere" (radius)
    or "mesh" (size: empty; `mesh` names an STL file, `scale` turns it into metres). X_link_shape: 4x4."""

    kind: str
    size: tuple[float, ...]
    X_link_shape: Array
    mesh: Path | None = None
    scale: float = 1.0


@dataclass(frozen=True)
class Inertial:
    """mass [kg], centre of mass and principal axes X_link_com, principal moments (3,) [kg m^2]."""

    mass: float
    X_link_com: Array
    moments: tuple[float, float, float]


@dataclass(frozen=True)
class Link:
    """A link and the joint that carries it.

    X_parent_joint: the joint's frame in the parent, which is the link's frame at q = 0. axis: (3,) unit vector of a
    revolute joint, or None for a fixed one. lower, upper [rad], effort [Nm], velocity [rad/s]: the joint's limits.
    """

    name: str
    parent: str | None
    X_parent_joint: Array
    joint: str
    axis: Array | None = None
    lower: float = 0.0
    upper: float = 0.0
    effort: float = 0.0
    velocity: float = 0.0
    inertial: Inertial | None = None
    visuals: tuple[Shape, ...] = ()
    collisions: tuple[Shape, ...] = ()


@dataclass(frozen=True)
class Tree:
    """Links, parents before children."""

    links: tuple[Link, ...]
    by_name: Mapping[str, Link] = field(init=False)
    _axes: Array = field(init=False)
    _levels: tuple[tuple[slice, NDArray[np.int64]], ...] = field(init=False)
    _rows: dict[str, int] = field(init=False)
    _movable: NDArray[np.int64] = field(init=False)
    _Xs_parent_joint: Array = field(init=False)

    def __post_init__(self) -> None:
        set_ = partial(object.__setattr__, self)
        set_("by_name", {link.name: link for link in self.links})
        axes = [link.axis for link in self.links if link.axis is not None]
        set_("_axes", np.reshape(axes, (-1, 3)))
        # Links as deep as each other (the fingers' joints) are computed together: rows by depth.
        depth: dict[str, int] = {}
        for link in self.links:
            depth[link.name] = depth[link.parent] + 1 if link.parent in depth else 0
        ordered = sorted(self.links, key=lambda link: depth[link.name])
        rows = {link.name: i for i, link in enumerate(ordered)}
        ends = np.cumsum(np.bincount([*depth.values()])).tolist()
        levels = [
            (slice(first, end), np.array([rows[link.parent] for link in ordered[first:end] if link.parent]))
            for first, end in pairwise(ends)
        ]
        set_("_levels", tuple(levels))
        set_("_rows", {link.name: rows[link.name] for link in self.links})
        set_("_movable", np.array([rows[link.name] for link in self.links if link.axis is not None], np.int64))
        set_("_Xs_parent_joint", np.stack([link.X_parent_joint for link in ordered]))

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the movable joints, in tree order."""
        return tuple(link.joint for link in self.links if link.axis is not None)

    def carried_by(self, joint: str) -> str:
        """Name of the link that a joint carries."""
        return next(link.name for link in self.links if link.joint == joint)

    def ancestors(self, link: str) -> list[str]:
        """Names of the links from this one up to the root, itself first."""
        found = [link]
        while (parent := self.by_name[found[-1]].parent) in self.by_name:
            found.append(parent or "")
        return found

    def limits(self) -> tuple[Array, Array]:
        """Lower and upper position limits [rad] of the movable joints, (n,) each."""
        movable = [link for link in self.links if link.axis is not None]
        return np.array([link.lower for link in movable]), np.array([link.upper for link in movable])

    def link_poses(self, q: Array) -> dict[str, Array]:
        """Pose (4x4) of every link in the root's parent frame at q (n,) [rad], in the order of `joints`."""
        q = np.asarray(q, dtype=np.float64)
        if q.shape != (len(self._axes),):
            raise ValueError(f"q must have shape ({len(self._axes)},), got {q.shape}")
        X = self._Xs_parent_joint.copy()
        X[self._movable, :3, :3] = X[self._movable, :3, :3] @ _rotations(self._axes, q)
        for level, parents in self._levels:
            X[level] = X[parents] @ X[level]
        return {name: X[row] for name, row in self._rows.items()}

"""Boxes in a station that nothing may touch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, transform
from toolee_robot.station.values import STRICT, Extent, JointAngle, Point


@dataclass(frozen=True)
class Obstacle:
    """A box that arm, hand and tool keep clear of, such as a fence, a shelf or a fixture."""

    __pydantic_config__ = STRICT
    name: Annotated[str, Field(pattern=r"^\w[\w -]{0,39}$")]
    """Name, for messages and pictures."""
    center: Point
    """Centre in `base`."""
    size: tuple[Extent, Extent, Extent]
    """Edge lengths along the box's own axes."""
    rotation: tuple[JointAngle, JointAngle, JointAngle] = (0.0, 0.0, 0.0)
    """Rotation vector of the box's axes in `base`, as the teach pendant shows rotations; zero: along the axes of
    `base`."""

    @property
    def X_base_box(self) -> Array:
        """Pose of the box's centre and axes in `base`, (4, 4)."""
        if not np.any(self.rotation):
            return transform(p=self.center)
        return transform(Rotation.from_rotvec(self.rotation), self.center)

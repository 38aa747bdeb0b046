"""Record of how a hand is screwed on the flange."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.frames import Array, frame_from_axes
from toolee_robot.types.mount import SQUARE, Three


@dataclass(frozen=True)
class HandMounting:
    """Place of the hand frame in the flange: origin at the root of the palm, z to the fingertips, x to the thumb.

    All in the flange's axes, z out of the flange. No field has a default: a lab measures how its adapter holds the
    hand.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012  (read by pydantic, not a field)
    position: Three
    """Origin of the hand frame [m]."""
    fingers: Three
    """Direction in which the stretched fingers point; any length."""
    thumb: Three
    """Direction across the palm to the side of the thumb, at a right angle to `fingers`; any length."""

    def __post_init__(self) -> None:
        for name in ("fingers", "thumb"):
            if np.linalg.norm(getattr(self, name)) < 1e-6:
                raise ValueError(f"{name} is no direction")
        cosine = np.dot(self.fingers, self.thumb) / (np.linalg.norm(self.fingers) * np.linalg.norm(self.thumb))
        if abs(cosine) > SQUARE:
            raise ValueError("fingers and thumb must be at a right angle to each other")

    @property
    def X_flange_hand(self) -> Array:
        """Pose of the hand frame in the flange, (4, 4) [m]."""
        return frame_from_axes(z=np.array(self.fingers), x=np.array(self.thumb), p=self.position)

"""How a hand or a tool mount sits on the flange, and the efforts of its fingers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from toolee_robot.frames import Array, frame_from_axes
from toolee_robot.types.units import Direction, Kilograms, Metres, NearPoint, Radians, Unit


@dataclass(frozen=True)
class HandMounting:
    """Place of the hand frame in the flange: origin at the root of the palm, z to the fingertips, x to the thumb.

    All in the flange's axes, z out of the flange. No field has a default: a lab measures how its adapter holds the
    hand.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012  (read by pydantic, not a field)
    position: NearPoint
    """Origin of the hand frame."""
    fingers: Direction
    """Direction in which the stretched fingers point; any length."""
    thumb: Direction
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


@dataclass(frozen=True)
class HandEfforts:
    """Efforts of a hand's motors, in the unit in which it reports them. No field has a default: a lab measures them."""

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012  (read by pydantic, not a field)
    touch: Annotated[float, Unit("effort", 1.0, 2000.0, "a Shadow Hand reports up to 1023")]
    """Effort above which a motor counts as touching; more than any has while its finger moves freely."""
    grip: Annotated[float, Unit("effort", 1.0, 2000.0, "a Shadow Hand reports up to 1023")]
    """Effort at which a motor stops to close further."""
    newtons_per_unit: Annotated[float, Unit("N by effort", 0.001, 10.0, "fingertips press with 0.5 to 50 N")]
    """Force at the fingertip by the effort."""

    def __post_init__(self) -> None:
        if self.grip <= self.touch:
            raise ValueError("grip must be more than touch")


MOUNT = "mount"
"""What a station file's `hand.model` calls a tool mount."""
Edge = Annotated[float, Metres(0.005, 1.0)]
"""Edge length of a box on the flange."""
SQUARE = 0.05
"""Largest cosine of the angle between handle and working side: 3 deg off a right angle."""
TURNED = 0.7
"""Least cosine of the angle between the hinge's axis and a strike's torque: 45 deg."""


@dataclass(frozen=True)
class ToolMount:
    """A tool mount on the flange: a body, and a clamp that yields about one hinge when the tool strikes.

    All positions and directions are in the flange's axes, the mount at rest. No field has a default: a lab measures its
    mount. The hinge stands for whatever gives way: a bushing, a spring, a breakaway. At rest it lies against a stop; a
    strike that exceeds `hand.yield_torque` turns it away from there.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012  (read by pydantic, not a field)
    position: NearPoint
    """Middle of the clamp, on the axis of a handle in it."""
    handle: Direction
    """Direction of a handle in the clamp, from its butt to the tool's head; any length."""
    working_side: Direction
    """Direction in which the tool works, of a hammer its face's normal; at a right angle to `handle`, any length."""
    mass: Annotated[float, Kilograms(0.1, 12.5, "a UR10e carries 12.5 kg")]
    """Mass of the whole mount, without a tool."""
    center_of_mass: NearPoint
    """Centre of mass of the whole mount."""
    clamp_mass: Annotated[float, Kilograms(0.01, 12.5)]
    """Mass of the part that yields together with the tool; its centre is taken to be at `position`."""
    body_size: tuple[Edge, Edge, Edge]
    """Edge lengths of the box, along the flange's axes, that encloses the mount in collision checks."""
    body_position: NearPoint
    """Centre of that box."""
    hinge_position: NearPoint
    """A point on the axis about which the clamp yields."""
    hinge_axis: Direction
    """Direction of that axis, about at a right angle to `handle` and `working_side`; any length, either sign."""
    stiffness: Annotated[float, Unit("Nm/rad", 0.0, 10_000.0)]
    """Torque beyond the yield torque by angle; 0 for a mount that yields at a constant torque."""
    travel: Annotated[float, Radians(0.01, 3.15, "half a turn")]
    """Angle by which the clamp yields before it meets its end stop."""

    def __post_init__(self) -> None:
        if self.clamp_mass >= self.mass:
            raise ValueError(f"clamp_mass {self.clamp_mass} is part of mass {self.mass}: it must be less")
        for name in ("handle", "working_side", "hinge_axis"):
            if np.linalg.norm(getattr(self, name)) < 1e-6:
                raise ValueError(f"{name} is no direction")
        handle, side, axis = (_unit(v) for v in (self.handle, self.working_side, self.hinge_axis))
        if abs(handle @ side) > SQUARE:
            raise ValueError("handle and working_side must be at a right angle to each other")
        if abs(axis @ np.cross(side, handle)) < TURNED:
            raise ValueError(
                "hinge_axis is not at a right angle to handle and working_side: a strike would not turn it"
            )

    @property
    def X_flange_mount(self) -> Array:
        """Pose of the clamp in the flange at rest, (4, 4) [m]: x along the handle, z towards the working side."""
        return frame_from_axes(z=np.array(self.working_side), x=np.array(self.handle), p=self.position)

    @property
    def axis(self) -> Array:
        """Unit vector of the hinge in the flange, (3,), about which a strike turns the clamp in the positive sense."""
        axis = _unit(self.hinge_axis)
        return axis if axis @ np.cross(self.working_side, self.handle) > 0.0 else -axis


def _unit(v: tuple[float, float, float]) -> Array:
    return np.asarray(v) / np.linalg.norm(v)

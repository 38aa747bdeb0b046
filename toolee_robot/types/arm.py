"""Records of the arm: model, calibration, joint states, motions, payload, and how a hand or a mount sits on it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

import numpy as np

from toolee_robot.frames import Array, frame_from_axes
from toolee_robot.types.units import Direction, Kilograms, Metres, NearPoint, Radians, Unit


class ArmModel(StrEnum):
    """The supported arm models."""

    UR10 = "UR10"
    UR10E = "UR10e"


Six = tuple[float, float, float, float, float, float]
_Turn = Annotated[float, Radians(-6.2832, 6.2832)]
_Link = Annotated[float, Metres(-1.0, 1.0)]
_Along = Annotated[float, Metres(-10_000.0, 10_000.0, "of parallel axes a controller tells hundreds of metres")]
"""One value per joint, base to wrist 3."""


@dataclass(frozen=True)
class DhCalibration:
    """Factory calibration of an arm: offsets of its Denavit-Hartenberg parameters from the model's nominal ones.

    The fields are the entries of the same names in the controller's calibration.conf, base to wrist 3.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012  (read by pydantic, not a field)
    delta_theta: tuple[_Turn, _Turn, _Turn, _Turn, _Turn, _Turn]
    """Offsets of the joint angles [rad]."""
    delta_a: tuple[_Link, _Link, _Link, _Link, _Link, _Link]
    """Offsets of the link lengths along x [m]."""
    delta_d: tuple[_Along, _Along, _Along, _Along, _Along, _Along]
    """Offsets of the link offsets along z [m]."""
    delta_alpha: tuple[_Turn, _Turn, _Turn, _Turn, _Turn, _Turn]
    """Offsets of the link twists about x [rad]."""


@dataclass(frozen=True)
class JointState:
    """Positions and velocities of n joints at one time.

    Attributes:
        q: Joint positions, (n,) [rad].
        qd: Joint velocities, (n,) [rad/s].
        stamp: Time on the station's clock [s].
    """

    q: Array
    qd: Array
    stamp: float


@dataclass(frozen=True)
class Trajectory:
    """A motion of n joints, sampled at N times.

    Attributes:
        times: Times of the samples from 0, increasing, (N,) [s].
        q: Joint positions, (N, n) [rad].
        qd: Joint velocities, (N, n) [rad/s].
        qdd: Joint accelerations, (N, n) [rad/s^2].
        braking: Largest deceleration along the path in joint space that a stop on it may use, at rest and at the
            planned speed, (N, 2) [rad/s^2]; None where only the joints' own limits bound it. See
            `control.dynamics.torque_room.permitted_braking`.

    Raises:
        ValueError: The shapes do not agree, or the times do not start at 0 and increase.
    """

    times: Array
    q: Array
    qd: Array
    qdd: Array
    braking: Array | None = None

    def __post_init__(self) -> None:
        n = len(self.times)
        if self.braking is not None and self.braking.shape != (n, 2):
            raise ValueError(f"the permitted braking has the shape {self.braking.shape}, expected {(n, 2)}")
        if n < 2 or not (self.q.shape == self.qd.shape == self.qdd.shape) or self.q.shape[0] != n:
            shapes = (self.times.shape, self.q.shape, self.qd.shape, self.qdd.shape)
            raise ValueError(f"inconsistent trajectory shapes (times, q, qd, qdd): {shapes}")
        if self.times[0] != 0.0 or not np.all(np.diff(self.times) > 0):
            raise ValueError("trajectory times must start at 0 and increase")

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.times[-1])

    def sample(self, t: float) -> tuple[Array, Array]:
        """Interpolate between the samples with cubic Hermite polynomials.

        Args:
            t: Time [s]; clipped to the duration.

        Returns:
            Joint positions (n,) [rad] and velocities (n,) [rad/s].
        """
        # In Python's floats: a controller's cycle asks for this, and numpy takes several times as long for one number.
        t = min(max(t, 0.0), float(self.times[-1]))
        i = min(max(int(self.times.searchsorted(t, side="right")) - 1, 0), len(self.times) - 2)
        start, end = self.times[i : i + 2].tolist()
        h = end - start
        s = (t - start) / h
        ends = np.array([self.q[i], self.qd[i] * h, self.q[i + 1], self.qd[i + 1] * h])
        q = np.array([2 * s**3 - 3 * s**2 + 1, s**3 - 2 * s**2 + s, 3 * s**2 - 2 * s**3, s**3 - s**2]).dot(ends)
        qd = np.array([6 * s**2 - 6 * s, 3 * s**2 - 4 * s + 1, 6 * s - 6 * s**2, 3 * s**2 - 2 * s]).dot(ends) / h
        return q, qd


@dataclass(frozen=True)
class HandWeight:
    """What hangs on the flange without a tool, as weighed: adapter, hand, cables' share.

    The robot's own payload estimation measures both (PolyScope, *Payload*), with the hand open.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012  (read by pydantic, not a field)
    mass: Annotated[float, Kilograms(0.05, 12.5, "a UR10e carries 12.5 kg")]
    """Mass."""
    center_of_mass: NearPoint
    """Centre of mass in the flange frame."""


@dataclass(frozen=True)
class Payload:
    """Mass properties of what the flange carries, or of a tool.

    Attributes:
        mass: Mass [kg].
        center_of_mass: Centre of mass, (3,) [m]; in the flange frame unless said otherwise.
    """

    mass: float
    center_of_mass: Array = field(default_factory=lambda: np.zeros(3))

    def seen_from(self, X_frame_this: Array) -> Payload:
        """The same mass with its centre in another frame.

        Args:
            X_frame_this: Pose of the present frame in the other one, (4, 4).

        Returns:
            The mass properties in the other frame.
        """
        return Payload(self.mass, (X_frame_this @ np.append(self.center_of_mass, 1.0))[:3])


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
    """Mass of all that is on the flange, plates, cables and screws included, without a tool."""
    center_of_mass: NearPoint
    """Its centre of mass."""
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

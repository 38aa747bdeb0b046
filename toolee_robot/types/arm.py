"""Records of the arm: model, calibration, joint states, motions, payload."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.types.units import Kilograms, Metres, NearPoint, Radians


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

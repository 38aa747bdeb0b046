"""Frozen records that travel between the stages. SI units, radians; poses are 4x4 arrays named X_AB."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import Array


class ArmModel(StrEnum):
    """The arms whose kinematics and controller are known."""

    UR10 = "UR10"
    UR10E = "UR10e"


Six = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class DhCalibration:
    """How an arm's own Denavit-Hartenberg parameters differ from its model's, as the factory measured them: the
    entries of the same names in the controller's calibration.conf, base to wrist 3. theta, alpha [rad], a, d [m]."""

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012  (read by pydantic, not a field)
    delta_theta: Six
    delta_a: Six
    delta_d: Six
    delta_alpha: Six


@dataclass(frozen=True)
class CameraIntrinsics:
    """Pinhole camera without distortion [px]; pixel centres are at integer coordinates (OpenCV)."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @property
    def matrix(self) -> Array:
        """K, 3x3."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class RgbdFrame:
    """A colour image and the depth registered to it.

    rgb: (H, W, 3) uint8. depth: (H, W) float32 [m] along the optical axis, 0 or NaN where unknown.
    stamp: time of exposure on the station's clock [s].
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    intrinsics: CameraIntrinsics
    stamp: float = 0.0

    def __post_init__(self) -> None:
        if self.rgb.ndim != 3 or self.rgb.shape[2] != 3 or self.rgb.dtype != np.uint8:
            raise UserError(
                f"rgb must be (H, W, 3) uint8, got {self.rgb.shape} {self.rgb.dtype}: convert grey or RGBA images"
            )
        if self.depth.shape != self.rgb.shape[:2]:
            raise UserError(
                f"depth {self.depth.shape} and rgb {self.rgb.shape[:2]} differ in size: register depth to colour"
            )
        if not np.issubdtype(self.depth.dtype, np.floating):
            raise UserError(f"depth must be float [m], got {self.depth.dtype}: multiply it by the camera's depth scale")
        size = (self.intrinsics.height, self.intrinsics.width)
        if self.rgb.shape[:2] != size:
            raise UserError(f"image is {self.rgb.shape[:2]} but the intrinsics are for {size} (height, width)")


@dataclass(frozen=True, eq=False)
class HoldingHand:
    """The hand that holds a tool before the camera: what is known of the tool's pose without looking at it."""

    X_camera_hand: Array
    """Pose of the hand in the camera's frame, 4x4."""
    R_hand_tool: Array
    """Axes of the tool in the hand as it nominally holds one, 3x3: `HandModel.grasp.R_hand_tool`."""


@dataclass(frozen=True)
class Detection:
    """One EE found in an image.

    mask: (H, W) bool, the EE. tool_mask: (H, W) bool, the whole visible tool it belongs to, or None.
    box: x0, y0, x1, y1 [px]. score in [0, 1]; tool_score: likewise of the tool, 0 without one.
    """

    category: Category
    score: float
    mask: NDArray[np.bool_]
    box: tuple[float, float, float, float]
    tool_mask: NDArray[np.bool_] | None = None
    tool_score: float = 0.0


@dataclass(frozen=True)
class PoseHypotheses:
    """Candidate poses of one EE in the camera frame, as sampled, before pooling.

    Xs_camera_ee: (K, 4, 4). points: (N, 3) the EE's cloud [m], camera frame.
    sigma_position [m], sigma_angle [rad]: the network's own prediction of its error.
    spin_observable: probability that the spin about the symmetry axis can be told from this view.
    """

    Xs_camera_ee: Array
    points: Array
    sigma_position: float
    sigma_angle: float
    spin_observable: float


@dataclass(frozen=True)
class ToolEstimate:
    """The EE's pose as one frame tells it.

    X_camera_ee: 4x4, pooled, and with the spin fixed by the hand where the hand's pose was given.
    covariance: 6x6, position [m] then rotation vector [rad], both in the camera frame's axes; a free spin shows
    as a variance of (pi)^2/3 about the axis. confidence in [0, 1]: probability of being within 10 deg and 2 cm if the
    detection is right; trust: that both are.
    usable: whether to act on it; reason says why not (or "ok").
    """

    detection: Detection
    X_camera_ee: Array
    covariance: Array
    confidence: float
    usable: bool
    reason: str
    hypotheses: PoseHypotheses | None = None
    trust: float = 0.0

    @property
    def category(self) -> Category:
        return self.detection.category


@dataclass(frozen=True)
class InHandEstimate:
    """The EE's pose in the hand, fused over frames.

    X_hand_ee: 4x4. covariance: 6x6, position [m] then rotation vector [rad], hand axes.
    frames_used of frames_seen. usable, reason: as in ToolEstimate.
    """

    category: Category
    X_hand_ee: Array
    covariance: Array
    confidence: float
    frames_used: int
    frames_seen: int
    usable: bool
    reason: str

    @property
    def sigma_position(self) -> float:
        """Root of the largest position variance [m]."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))


@dataclass(frozen=True)
class JointState:
    """Joint positions [rad] and velocities [rad/s], (n,), at `stamp` [s] on the station's clock."""

    q: Array
    qd: Array
    stamp: float


@dataclass(frozen=True)
class Trajectory:
    """Timed joint motion: times (N,) [s] from 0, increasing; q, qd, qdd (N, n) [rad, rad/s, rad/s^2]."""

    times: Array
    q: Array
    qd: Array
    qdd: Array

    def __post_init__(self) -> None:
        n = len(self.times)
        if n < 2 or not (self.q.shape == self.qd.shape == self.qdd.shape) or self.q.shape[0] != n:
            shapes = (self.times.shape, self.q.shape, self.qd.shape, self.qdd.shape)
            raise ValueError(f"inconsistent trajectory shapes (times, q, qd, qdd): {shapes}")
        if self.times[0] != 0.0 or not np.all(np.diff(self.times) > 0):
            raise ValueError("trajectory times must start at 0 and increase")

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.times[-1])

    def sample(self, t: float) -> tuple[Array, Array]:
        """q, qd at time t [s], cubic Hermite between samples, held outside."""
        t = float(np.clip(t, 0.0, self.times[-1]))
        i = int(np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2))
        h = self.times[i + 1] - self.times[i]
        s = (t - self.times[i]) / h
        ends = np.stack([self.q[i], self.qd[i] * h, self.q[i + 1], self.qd[i + 1] * h])
        q = np.array([2 * s**3 - 3 * s**2 + 1, s**3 - 2 * s**2 + s, 3 * s**2 - 2 * s**3, s**3 - s**2]) @ ends
        qd = np.array([6 * s**2 - 6 * s, 3 * s**2 - 4 * s + 1, 6 * s - 6 * s**2, 3 * s**2 - 2 * s]) @ ends / h
        return q, qd


@dataclass(frozen=True)
class Payload:
    """What the flange carries: mass [kg], centre of mass (3,) [m] in the flange frame."""

    mass: float
    center_of_mass: Array = field(default_factory=lambda: np.zeros(3))

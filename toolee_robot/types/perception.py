"""Records of the perception: images, detections, pose estimates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, skew

LENSES = (0.3, 4.0)
"""Smallest and largest focal length, in widths of the image."""
ASPECT = 2.0
"""Largest ratio of the two focal lengths."""
OFF_CENTRE = 0.25
"""Largest distance of the principal point from the image's middle, in sizes of the image."""


@dataclass(frozen=True)
class CameraIntrinsics:
    """Pinhole camera; pixel centres are at integer coordinates (OpenCV).

    It has no distortion: a driver's images are undistorted before they are a frame (`hardware.cameras.StreamedCamera`).

    Attributes:
        fx: Focal length along x [px].
        fy: Focal length along y [px].
        cx: Principal point, x [px].
        cy: Principal point, y [px].
        width: Width of the image [px].
        height: Height of the image [px].
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def problems(self, longest: float = LENSES[1]) -> list[tuple[str, str]]:
        """Find what no camera's pinhole model has.

        Args:
            longest: Largest focal length, in widths of the image; more of a part that was cut out.

        Returns:
            Names of fields, and what is wrong with each; none of a camera's.
        """
        wrong = [
            (name, f"{value:g} px is no focal length of a {self.width} px wide image")
            for name, value in (("fx", self.fx), ("fy", self.fy))
            if not LENSES[0] <= value / self.width <= longest
        ]
        if not wrong and not 1.0 / ASPECT <= self.fx / self.fy <= ASPECT:
            wrong = [("fy", f"{self.fy:g} px beside fx {self.fx:g} px: pixels are about square")]
        return wrong + [
            (name, f"{value:g} px is far from the middle of {size} px: of another size of the image, or in wrong order")
            for name, value, size in (("cx", self.cx, self.width), ("cy", self.cy, self.height))
            if not abs(value / size - 0.5) <= OFF_CENTRE
        ]

    @property
    def matrix(self) -> Array:
        """Camera matrix K, (3, 3) [px]."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: Array) -> Array:
        """Project points onto the image.

        Args:
            points: In the camera frame, in front of it, (..., 3) [m].

        Returns:
            Their pixels, (..., 2).
        """
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        return np.stack([self.fx * x / z + self.cx, self.fy * y / z + self.cy], axis=-1)

    def rays(self, pixels: NDArray[Any]) -> Array:
        """Follow the rays through pixels, the other way round than `project`.

        Args:
            pixels: Pixels, (..., 2).

        Returns:
            Points on their rays at a depth of 1 m, in the camera frame, (..., 3) [m].
        """
        u, v = pixels[..., 0], pixels[..., 1]
        return np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones_like(u, dtype=float)], axis=-1)

    def agrees(self, other: CameraIntrinsics, tolerance: float = 0.01) -> bool:
        """Whether two intrinsics are the same but for rounding, as in a station file.

        Args:
            other: The other intrinsics.
            tolerance: Largest difference of a number [px]; the sizes must be equal.

        Returns:
            Whether they are.
        """
        same_size = (self.width, self.height) == (other.width, other.height)
        return same_size and bool(np.allclose(self.matrix, other.matrix, rtol=0.0, atol=tolerance))


@dataclass(frozen=True)
class RgbdFrame:
    """A colour image and the depth image registered to it.

    Attributes:
        rgb: Colour image, (H, W, 3) uint8.
        depth: Depth along the optical axis, (H, W) float32 [m]; 0 or NaN where unknown.
        intrinsics: Pinhole model of both images.
        stamp: Time of exposure on the station's clock [s].

    Raises:
        UserError: The arrays' shapes or types do not fit each other or the intrinsics.
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
class HeldRegion:
    """The part of space, fixed to the hand, in which the held tool is looked for."""

    points: Array
    """Points in the hand's frame, (N, 3) [m]: the tool is near their convex hull."""
    radius: float
    """Largest distance of the tool from that hull [m], all uncertainty included."""


@dataclass(frozen=True, eq=False)
class HoldingHand:
    """The hand that holds a tool in front of the camera: prior knowledge of the tool's pose."""

    X_camera_hand: Array
    """Pose of the hand in the camera's frame, (4, 4)."""
    R_hand_tool: Array
    """Axes of the tool in the hand in a nominal grasp, (3, 3): `HandModel.grasp.R_hand_tool`."""
    region: HeldRegion | None = None
    """Where the tool is looked for first; None: in the whole image."""


@dataclass(frozen=True)
class Detection:
    """One end effector (EE) detected in an image.

    Attributes:
        category: Category of the EE.
        score: Detection score, 0 to 1.
        mask: Pixels of the EE, (H, W) bool.
        box: Bounding box x0, y0, x1, y1 [px].
        tool_mask: Pixels of the whole visible tool that the EE belongs to, (H, W) bool, or None.
        tool_score: Detection score of the tool, 0 to 1; 0 without a tool.
    """

    category: Category
    score: float
    mask: NDArray[np.bool_]
    box: tuple[float, float, float, float]
    tool_mask: NDArray[np.bool_] | None = None
    tool_score: float = 0.0


@dataclass(frozen=True)
class PoseHypotheses:
    """Candidate poses of one EE as sampled from the network, before pooling.

    Attributes:
        Xs_camera_ee: The K poses of the EE in the camera frame, (K, 4, 4).
        points: Point cloud of the EE in the camera frame, (N, 3) [m].
        sigma_position: The network's prediction of its position error [m].
        sigma_angle: The network's prediction of its rotation error [rad].
        spin_observable: Probability that the spin about the symmetry axis is observable in this view.
    """

    Xs_camera_ee: Array
    points: Array
    sigma_position: float
    sigma_angle: float
    spin_observable: float


@dataclass(frozen=True)
class ToolEstimate:
    """Pose of one EE, estimated from one frame.

    Attributes:
        detection: The detection whose pose was estimated.
        X_camera_ee: Pooled pose of the EE in the camera frame, (4, 4); the spin about a symmetry axis is fixed by the
            hand where the hand's pose was given.
        covariance: Covariance of position [m] and rotation vector [rad], (6, 6), in the camera frame's axes; a free
            spin has a variance of pi^2/3 about the symmetry axis.
        confidence: Probability that the pose is within 10 deg and 2 cm if the detection is correct, 0 to 1.
        usable: Whether the estimate may be acted on.
        reason: Why it is not usable, or "ok".
        hypotheses: The samples that were pooled, or None.
        trust: Probability that the detection is correct and the pose is within 10 deg and 2 cm, 0 to 1.
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
        """Category of the EE."""
        return self.detection.category


@dataclass(frozen=True, eq=False)
class CameraError:
    """What is known of the error of a camera's calibration, with the arm's own where the tool was seen.

    With the translation d and the rotation vector w of `mean` a point that the calibration has at p truly is at
    p + d + w x p, in the camera's frame.

    Attributes:
        mean: Translation [m] and rotation vector [rad], camera's axes, (6,).
        covariance: Its covariance, (6, 6).
    """

    mean: Array
    covariance: Array

    def at(self, p_camera: Array) -> tuple[float, float]:
        """How far a point is off.

        Args:
            p_camera: The point in the camera's frame, (3,) [m].

        Returns:
            Distance [m], and the standard deviation of its least certain direction [m].
        """
        J = np.hstack([np.eye(3), -skew(p_camera)])
        sigma = np.sqrt(np.linalg.eigvalsh(J @ self.covariance @ J.T)[-1])
        return float(np.linalg.norm(J @ self.mean)), float(sigma)


@dataclass(frozen=True)
class InHandEstimate:
    """Pose of the EE in the hand, fused over several frames.

    Attributes:
        category: Category of the EE.
        X_hand_ee: Pose of the EE in the hand, (4, 4).
        covariance: Covariance of position [m] and rotation vector [rad], (6, 6), in the hand's axes.
        confidence: Probability that the pose is within 10 deg and 2 cm, 0 to 1.
        frames_used: Number of frames that contributed.
        frames_seen: Number of frames that were given.
        usable: Whether the estimate may be acted on.
        reason: Why it is not usable, or "ok".
        camera: What the frames tell of the camera's error; None where it was not estimated.
    """

    category: Category
    X_hand_ee: Array
    covariance: Array
    confidence: float
    frames_used: int
    frames_seen: int
    usable: bool
    reason: str
    camera: CameraError | None = None

    @property
    def sigma_position(self) -> float:
        """Square root of the largest eigenvalue of the position covariance [m]."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))

    @property
    def sigma_axis(self) -> float:
        """Standard deviation of the direction of the EE's z axis [rad], root mean square of both ways to tilt it."""
        R = self.X_hand_ee[:3, :3]
        covariance = R.T @ self.covariance[3:, 3:] @ R
        return float(np.sqrt(0.5 * np.trace(covariance[:2, :2])))

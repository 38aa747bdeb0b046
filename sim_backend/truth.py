"""Ground truth of a run: pose errors, strikes, the verdict; and a perception from it, for tests and ablation only."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import PerceptionError
from toolee_robot.frames import Array, angle_between, inverse
from toolee_robot.types import CameraError, Detection, HoldingHand, InHandEstimate, RgbdFrame, ToolEstimate


@dataclass(frozen=True)
class PoseError:
    """Error of an estimated EE pose.

    Attributes:
        position_mm: Distance of the EE's origins [mm] (hammer: of the face's centres).
        angle_deg: Rotation error modulo the category's symmetry group [deg] (hammer: between the face's normals).
    """

    position_mm: float
    angle_deg: float


def pose_error(X_estimated: Array, X_true: Array, category: Category) -> PoseError:
    """Error between two poses of one EE.

    Args:
        X_estimated: Estimated pose, 4x4.
        X_true: True pose, 4x4, in the same frame.
        category: Category of the EE, which determines the symmetry.

    Returns:
        The error.
    """
    return PoseError(
        float(np.linalg.norm(X_estimated[:3, 3] - X_true[:3, 3]) * 1e3),
        float(np.rad2deg(category.symmetry.rotation_error(X_estimated[:3, :3], X_true[:3, :3]))),
    )


def strike_offset(X_base_nail: Array, X_base_ee: Array) -> float:
    """Distance of the face's centre from the nail's axis.

    Args:
        X_base_nail: Pose of the nail, (4, 4).
        X_base_ee: Pose of the face at the contact, (4, 4).

    Returns:
        The distance [m].
    """
    p_nail_ee = (inverse(X_base_nail) @ X_base_ee)[:3, 3]
    return float(np.hypot(p_nail_ee[0], p_nail_ee[1]))


def strike_tilt(X_base_nail: Array, X_base_ee: Array) -> float:
    """Angle between the face's normal and the nail's axis.

    Args:
        X_base_nail: Pose of the nail, (4, 4).
        X_base_ee: Pose of the face at the contact, (4, 4).

    Returns:
        The angle [rad].
    """
    return angle_between(X_base_ee[:3, 2], X_base_nail[:3, 2])


class StruckBy(StrEnum):
    """What met the nail's head.

    Attributes:
        FACE: The tool's striking face.
        OTHER_PART: Another part of the tool: a cheek, the claw, the handle.
        HAND: The hand or the arm.
        NOTHING: Nothing: a miss.
    """

    FACE = "face"
    OTHER_PART = "other_part"
    HAND = "hand"
    NOTHING = "nothing"


@dataclass(frozen=True)
class StrikeTruth:
    """One strike at its first contact, or one miss when the face passed the head's height.

    Attributes:
        stamp: Time [s].
        struck_by: What met the nail's head; the face, if it did so at any time of the strike.
        offset_mm: Distance of the face's centre from the nail's axis [mm].
        tilt_deg: Angle between the face's normal and the nail's axis [deg].
        nail_bend_deg: Angle between the nail and its hole [deg].
        normal_in_hand: Direction of the face's normal in the hand's frame.
        speed: Speed of the face's centre along the nail before the contact [m/s].
        energy: Kinetic energy of the tool alone at that speed [J].
        work: Work done on the nail against the wood [J].
        peak_force: Largest force between tool and nail [N].
        protrusion_before_mm: Protrusion of the nail before the strike [mm].
        protrusion_mm: Protrusion of the nail after the strike [mm].
        nail: Name of the nail.
    """

    stamp: float
    struck_by: StruckBy
    offset_mm: float
    tilt_deg: float
    nail_bend_deg: float
    normal_in_hand: tuple[float, float, float]
    speed: float
    energy: float
    work: float
    peak_force: float
    protrusion_before_mm: float
    protrusion_mm: float
    nail: str

    @property
    def hit(self) -> bool:
        """Whether the face hit the nail, which alone counts."""
        return self.struck_by is StruckBy.FACE


OFF_FACE = 1.0
"""Depth [mm] from which on it counts that strikes which did not meet a nail with the face have driven it."""
NOT_BY_FACE = "not_by_face"
"""Outcome of a nail that is down, and that strikes without the face have driven by `OFF_FACE` or more."""


@dataclass(frozen=True)
class NailTruth:
    """How a nail stands.

    Attributes:
        name: Its name.
        outcome: Value of `NailOutcome`, or `NOT_BY_FACE`.
        protrusion_mm: Its protrusion [mm].
        bend_deg: Its bend against its hole [deg].
        lean_deg: Its lean against the normal of the wood's surface [deg].
        shift_mm: Largest distance of its head from the axis of its hole so far [mm].
    """

    name: str
    outcome: str
    protrusion_mm: float
    bend_deg: float
    lean_deg: float
    shift_mm: float


@dataclass(frozen=True)
class Verdict:
    """Figures of a run; None where they do not apply.

    The pose error is that of the last usable estimate before the first strike, or of the last one if none is usable.

    Attributes:
        nails: How each nail stands.
        pose_error_mm: Position error of the in-hand estimate [mm].
        pose_error_deg: Rotation error of the in-hand estimate [deg].
        strike_offset_mm: Median offset of the strikes [mm].
        strike_tilt_deg: Median tilt of the strikes [deg].
        contact_speed: Median speed of the strikes [m/s].
        hits: Number of strikes in which the face met the nail's head.
        off_face_strikes: Number of strikes in which only something else met it.
        misses: Number of strikes in which nothing did.
    """

    nails: tuple[NailTruth, ...]
    pose_error_mm: float | None
    pose_error_deg: float | None
    strike_offset_mm: float | None
    strike_tilt_deg: float | None
    contact_speed: float | None
    hits: int
    off_face_strikes: int
    misses: int

    def worst(self, names: Collection[str] = ()) -> NailTruth:
        """The nail that stands worst: of those that are not flush, else of all, the highest.

        Args:
            names: Names of the nails that count; empty for all.

        Returns:
            How it stands.
        """
        nails = [nail for nail in self.nails if not names or nail.name in names]
        return max(nails, key=lambda nail: (nail.outcome != "flush", nail.protrusion_mm))


def driven_off_face(strikes: Sequence[StrikeTruth], nail: str) -> float:
    """Depth to which strikes have driven a nail that did not meet it with the face.

    Args:
        strikes: The strikes.
        nail: Name of the nail.

    Returns:
        The depth [mm].
    """
    return sum(s.protrusion_before_mm - s.protrusion_mm for s in strikes if s.nail == nail and not s.hit)


class Truth(Protocol):
    """Ground truth about a run."""

    @property
    def strikes(self) -> tuple[StrikeTruth, ...]:
        """All strikes so far; the last one may still be going on."""

    def X_hand_ee(self, stamp: float) -> Array:
        """The true pose (4x4) of the EE in the hand at `stamp` [s]."""

    def verdict(self, estimates: Sequence[tuple[float, InHandEstimate]] = ()) -> Verdict:
        """The figures of the run so far."""


_SIGMA = 1e-4
"""[m, rad] Standard deviation of the reported covariances, which must be positive."""


class PerfectPerception:
    """Replaces `ToolPerception` by the true poses, which no robot has.

    Args:
        judge: The ground truth.
    """

    def __init__(self, judge: Truth) -> None:
        self._judge = judge

    def estimate(
        self,
        frame: RgbdFrame,
        hand: HoldingHand | None = None,
        categories: Sequence[Category] = CATEGORIES,  # noqa: ARG002
    ) -> list[ToolEstimate]:
        """The true pose of the hammer's face, whether it is visible or not.

        Args:
            frame: Frame of whose time the pose is returned.
            hand: The hand that holds the tool; required, since the true pose is known in the hand.
            categories: As of `ToolPerception`; the hammer's face is given in any case.

        Returns:
            One estimate.

        Raises:
            PerceptionError: No hand is given.
        """
        if hand is None:
            raise PerceptionError("perfect perception needs the hand that holds the tool")
        X = hand.X_camera_hand @ self._judge.X_hand_ee(frame.stamp)
        uv = frame.intrinsics.matrix @ X[:3, 3]
        u, v = uv[:2] / uv[2]
        mask = np.zeros(frame.depth.shape, dtype=np.bool_)
        detection = Detection(Category.HAMMER_HEAD, 1.0, mask, (u - 8.0, v - 8.0, u + 8.0, v + 8.0))
        return [ToolEstimate(detection, X, np.eye(6) * _SIGMA**2, 1.0, True, "ok", trust=1.0)]

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],
        Xs_camera_hand: Sequence[Array],
        category: Category | None = None,
        camera: CameraError | None = None,  # noqa: ARG002
    ) -> InHandEstimate:
        """The true in-hand pose at the last frame.

        Args:
            estimates_per_frame: Estimates of each frame.
            Xs_camera_hand: Pose of the hand in the camera, 4x4, for each frame.
            category: Category of the end effector; the hammer's face, or None.
            camera: As of `ToolPerception`; a true pose does not depend on it.

        Returns:
            The in-hand pose.

        Raises:
            PerceptionError: There is no estimate, or another category is requested.
        """
        if category not in (None, Category.HAMMER_HEAD):
            message = f"perfect perception supports the hammer's face only, not the {category}"
            raise PerceptionError(message)
        frames = [(e[0], X) for e, X in zip(estimates_per_frame, Xs_camera_hand, strict=True) if e]
        if not frames:
            message = "the true face lies where a held hammer cannot have it: was the tool dropped?"
            raise PerceptionError(message)
        X_hand_ee = inverse(frames[-1][1]) @ frames[-1][0].X_camera_ee
        covariance = np.eye(6) * _SIGMA**2
        return InHandEstimate(
            Category.HAMMER_HEAD, X_hand_ee, covariance, 1.0, len(frames), len(estimates_per_frame), True, "ok"
        )

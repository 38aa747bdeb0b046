"""Contact of a strike, expected and actual; a mount's yield behind it; the nail's protrusion, the tool's slip."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.control.kinematics import ArmKinematics
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.hal import MotionReport
from toolee_robot.station import SupervisorConfig
from toolee_robot.types import InHandEstimate


class Meeting(StrEnum):
    """How a strike met its target."""

    EXPECTED = "expected"
    EARLY = "early"
    LATE = "late"
    NONE = "none"


@dataclass(frozen=True)
class ExpectedContact:
    """Where and when tool and work should meet.

    Attributes:
        q: Joint positions at the contact, (6,) [rad].
        place: Where the face's centre is then, in `base`, (3,) [m].
        direction: Direction of the face's motion, a unit vector in `base`, (3,).
        time: Time of the contact on the trajectory [s].
    """

    q: Array
    place: Array
    direction: Array
    time: float


@dataclass(frozen=True)
class ContactVerdict:
    """Comparison of an actual contact with the expected one.

    Attributes:
        meeting: How the strike met its target.
        before: Distance before the expected contact at which the tool was stopped [m]; negative beyond it, NaN without
            contact.
    """

    meeting: Meeting
    before: float

    def __str__(self) -> str:
        if self.meeting is Meeting.NONE:
            return "the strike met nothing"
        where = f"{abs(self.before) * 1e3:.0f} mm {'before' if self.before > 0 else 'beyond'} the nail"
        return f"the tool hit something {where}"


def judge_contact(
    report: MotionReport, expected: ExpectedContact, arm: ArmKinematics, config: SupervisorConfig
) -> ContactVerdict:
    """Compare the place of the face at the contact with the expected one, along the strike's direction.

    Args:
        report: The executed strike.
        expected: The expected contact.
        arm: Kinematics of the arm.
        config: Bounds of an early and a late contact.

    Returns:
        How the contact came, and how far before the expected one [m]; NaN without a contact.
    """
    if report.contact is None:
        return ContactVerdict(Meeting.NONE, float("nan"))
    X_base_flange, X_base_met = arm.fk(np.stack([expected.q, report.contact.q]))
    met = (X_base_met @ inverse(X_base_flange) @ np.append(expected.place, 1.0))[:3]
    before = float(expected.direction @ (expected.place - met))
    if before > config.early_contact:
        return ContactVerdict(Meeting.EARLY, before)
    return ContactVerdict(Meeting.LATE if before < -config.late_contact else Meeting.EXPECTED, before)


def yield_lever(robot: RobotModel, q_hand: Array, X_flange_ee: Array) -> float | None:
    """Distance of the face's centre from the yielding joint's axis, across the direction of the strike.

    Args:
        robot: Kinematic model of arm and hand.
        q_hand: Joint positions of the hand, wrist first, (n,) [rad].
        X_flange_ee: Pose of the end effector in the flange, (4, 4); it strikes along its z axis.

    Returns:
        The distance [m]; None where nothing yields.
    """
    description = robot.description
    hand = description.hand
    if hand.yielding is None:
        return None
    link = next(link for link in hand.tree.links if link.joint == hand.joints[hand.yielding])
    assert link.axis is not None, "a wrist joint turns"
    poses = description.link_poses(np.zeros(6), q_hand)
    X_flange_link = inverse(poses[description.flange_frame]) @ poses[link.name]
    turning = np.cross(X_flange_link[:3, :3] @ link.axis, X_flange_ee[:3, 3] - X_flange_link[:3, 3])
    return float(abs(turning @ X_flange_ee[:3, 2]))


def yield_length(robot: RobotModel, q_hand: Array, X_flange_ee: Array) -> float:
    """Way that the arm can go on behind the contact, the face standing still, before a mount meets its end stop.

    Args:
        robot: Kinematic model of arm and hand.
        q_hand: Joint positions of the hand, wrist first, (n,) [rad].
        X_flange_ee: Pose of the end effector in the flange, (4, 4).

    Returns:
        The way [m]; infinite for a hand, whose fingers give way when its wrist cannot.
    """
    lever, hand = yield_lever(robot, q_hand, X_flange_ee), robot.description.hand
    if lever is None or hand.yielding is None or not hand.clamps:
        return np.inf
    return lever * float(robot.description.upper[6 + hand.yielding] - hand.wrist[hand.yielding].rest)


def protrusion(X_base_ee: Array, X_base_wood: Array) -> float:
    """Compute the nail's protrusion from a face that rests on its head: where the face's plane cuts the nail's axis.

    Args:
        X_base_ee: Pose of the end effector at the contact in `base`, (4, 4).
        X_base_wood: Pose of the flush nail in `base`, (4, 4): origin on the wood, z into it.

    Returns:
        Height of the head over the wood [m]; negative when the head is below the surface.

    Raises:
        UserError: The face is more than 60 deg off the nail's axis.
    """
    normal, axis = X_base_ee[:3, 2], X_base_wood[:3, 2]
    cosine = float(normal @ axis)
    if not cosine > 0.5:
        raise UserError(
            "the face points away from the nail: this is no contact of face and nail", code="user.face_direction"
        )
    return -float(normal @ (X_base_ee[:3, 3] - X_base_wood[:3, 3])) / cosine


def slip(before: InHandEstimate, now: InHandEstimate) -> tuple[float, float]:
    """Compute the slip between two estimates of a tool in the hand, modulo the end effector's symmetry.

    Args:
        before: The earlier estimate.
        now: The later estimate.

    Returns:
        Distance [m] and angle [rad].

    Raises:
        UserError: The estimates are of different categories.
    """
    if before.category is not now.category:
        raise UserError(
            f"cannot compare a {before.category.label} with a {now.category.label}: look at the same end of the tool",
            code="user.different_categories",
        )
    distance = float(np.linalg.norm(now.X_hand_ee[:3, 3] - before.X_hand_ee[:3, 3]))
    angle = before.category.symmetry.rotation_error(before.X_hand_ee[:3, :3], now.X_hand_ee[:3, :3])
    return distance, angle


def merge(before: InHandEstimate, now: InHandEstimate, drift_position: float, drift_angle: float) -> InHandEstimate:
    """Fuse the estimates of two looks at a tool that may have drifted in the hand between them.

    The estimates are weighted as in a Kalman update on SO(3) x R^3, modulo the end effector's symmetry. The covariance
    is their weighted mean, since two looks at one tool share systematic errors that averaging does not reduce. Where
    they disagree by more than 3 sigma in the position or the axis, the tool has slipped by more than the drift, and
    only the new look is used.

    Args:
        before: The earlier estimate.
        now: The later estimate.
        drift_position: Standard deviation of the drift [m].
        drift_angle: Standard deviation of the rotational drift [rad].

    Returns:
        The fused estimate.

    Raises:
        UserError: The estimates are of different categories.
    """
    if before.category is not now.category:
        raise UserError(
            f"cannot merge a {before.category.label} with a {now.category.label}: look at the same end of the tool",
            code="user.different_categories",
        )
    R_before = before.X_hand_ee[:3, :3]
    R_now = now.category.symmetry.canonical(now.X_hand_ee[:3, :3], R_before)
    turn = Rotation.from_matrix(R_now @ R_before.T).as_rotvec()
    innovation = np.concatenate([now.X_hand_ee[:3, 3] - before.X_hand_ee[:3, 3], turn])
    prior = before.covariance + np.diag([drift_position**2] * 3 + [drift_angle**2] * 3)
    doubt = np.linalg.inv(prior + now.covariance)
    z = R_before[:, 2]
    across = innovation[3:] - (innovation[3:] @ z) * z
    for part, seen in ((slice(0, 3), innovation[:3]), (slice(3, 6), across)):
        if seen @ np.linalg.inv((prior + now.covariance)[part, part]) @ seen > 9.0:
            return now
    gain = prior @ doubt
    change = gain @ innovation
    R = Rotation.from_rotvec(change[3:]).as_matrix() @ R_before
    mean = (np.eye(6) - gain) @ prior + gain @ now.covariance
    return replace(now, X_hand_ee=transform(R, before.X_hand_ee[:3, 3] + change[:3]), covariance=(mean + mean.T) / 2)

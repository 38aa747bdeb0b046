"""The merged robot: one URDF for Pinocchio and pybullet, joint names, postures, meshes and plain-numpy kinematics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np
import trimesh

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.errors import AssetError
from toolee_robot.frames import HALF_TURN, Array, inverse, transform
from toolee_robot.robots.hands import SHADOW_HAND, HandChoice, HandModel, hand_model
from toolee_robot.robots.tree import FLANGE_FRAME, NEARLY_MASSLESS, UR10_URDF, Inertial, Link, Shape, Tree, link_mesh
from toolee_robot.robots.urdf import DhParameters, joint_origins, read_urdf, write_urdf
from toolee_robot.types import ArmModel, DhCalibration, Payload

ARM_JOINTS = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
)  # fmt: skip

SHAPE_MARGIN: dict[ArmModel, dict[str, float]] = {
    ArmModel.UR10: {},
    ArmModel.UR10E: {
        "base_link": 0.021, "shoulder_link": 0.009, "upper_arm_link": 0.018, "forearm_link": 0.010,
        "wrist_1_link": 0.006, "wrist_2_link": 0.007, "wrist_3_link": 0.006,
    },
}  # fmt: skip
"""By link, how far the real arm stands out of the convex hull of the collision shapes here, at most [m].

Measured on the UR10e collision meshes of Universal_Robots_ROS2_Description (meshes/ur10e), which are not part of this
package."""
_SAME = 0.002
"""Shift of a joint below which a mesh is not moved along [m]; a tenth of the largest margin."""
_ARM_CELL = 0.012
"""Cell size [m] of the vertex clustering that simplifies the meshes of the arm."""


@dataclass(frozen=True, eq=False)
class RobotDescription:
    """Arm and hand as one kinematic tree rooted in `base` (the UR base_link).

    A UR10e has its own kinematics and masses. Its collision shapes are the UR10's meshes at both
    joints of each link (`arm_tree`); `SHAPE_MARGIN` says how far the real links stand out. Pictures show the UR10's
    meshes as they are.
    """

    model: ArmModel
    """Model of the arm."""
    calibrated: bool
    """Whether the kinematics are factory-calibrated; the nominal ones err by 1 to 2 mm at the flange."""
    hand: HandModel
    """Model of the hand on the flange."""
    urdf: str
    """The merged URDF, with absolute mesh paths."""
    tree: Tree
    """All links, those of the arm first."""
    arm_joints: tuple[str, ...]
    """Joint names of the arm (6) in URDF order, as in pybullet. Pinocchio sorts sibling joints: map by name there."""
    flange_frame: str
    """Name of the link that carries the hand."""
    hand_open: Array
    """Joint positions of the open hand (n,) [rad]."""
    hand_closed: Array
    """Joint positions of the closed hand (n,) [rad], flexed further than any handle allows."""
    lower: Array
    """Lower position limits of arm and hand (6 + n,) [rad]."""
    upper: Array
    """Upper position limits (6 + n,) [rad]."""
    effort: Array
    """Torque limits (6 + n,) [Nm]."""
    velocity: Array
    """Velocity limits (6 + n,) [rad/s]."""

    @property
    def hand_joints(self) -> tuple[str, ...]:
        """Names of the hand's joints (n), wrist first."""
        return self.hand.joints

    @property
    def hand_frame(self) -> str:
        """Name of the link that is the hand frame."""
        return self.hand.frame

    @property
    def finger_links(self) -> frozenset[str]:
        """Names of the hand's links that neither are nor carry the hand frame."""
        tree = self.hand.tree
        return frozenset(tree.by_name) - frozenset(tree.ancestors(self.hand.frame))

    def link_poses(self, q_arm: Array, q_hand: Array) -> dict[str, Array]:
        """Forward kinematics of all links.

        Args:
            q_arm: Joint positions of the arm (6,) [rad].
            q_hand: Joint positions of the hand (n,) [rad].

        Returns:
            Link name -> X_base_link (4x4) [m].
        """
        return self.tree.link_poses(np.concatenate([q_arm, q_hand]))

    def X_flange_hand(self, q_hand: Array) -> Array:
        """Pose of the hand frame in the flange, 4x4 [m]; of q_hand (n,) [rad] only the wrist joints matter."""
        poses = self.tree.link_poses(np.concatenate([np.zeros(len(self.arm_joints)), q_hand]))
        return inverse(poses[self.flange_frame]) @ poses[self.hand_frame]

    def hand_payload(self, q_hand: Array) -> Payload:
        """Payload of the flange: the hand with its forearm and mounting plate, as weighed where the station has.

        Args:
            q_hand: Joint positions of the hand (n,) [rad]; what was weighed holds for all.

        Returns:
            Mass [kg] and centre of mass (3,) [m] in the flange frame.
        """
        if (weighed := self.hand.weighed) is not None:
            return Payload(weighed.mass, np.array(weighed.center_of_mass))
        poses = self.tree.link_poses(np.concatenate([np.zeros(len(self.arm_joints)), q_hand]))
        X_flange_base = inverse(poses[self.flange_frame])
        mass, moment = 0.0, np.zeros(3)
        for link in self.tree.links:
            carried = link.name in self.hand.tree.by_name or link.name == self.flange_frame
            if carried and link.inertial is not None:
                mass += link.inertial.mass
                moment += link.inertial.mass * (X_flange_base @ poses[link.name] @ link.inertial.X_link_com)[:3, 3]
        return Payload(mass, moment / mass)


@lru_cache(maxsize=4)
def arm_tree(model: ArmModel = ArmModel.UR10, calibration: DhCalibration | None = None) -> Tree:
    """The links of the arm from base to flange.

    The shapes of a UR10e's link are those of the UR10's twice: where its own joint has them, and where the next joint
    does, which is up to 53 mm from there. The convex hull of both reaches from joint to joint.

    Masses and centres of mass are the maker's (`ARM_DATA`), about which each link has the moments of inertia of the
    UR10's description, in proportion to the mass: the maker gives none.

    Args:
        model: The arm.
        calibration: Factory calibration of the arm; None: nominal kinematics.

    Returns:
        The arm's links.

    Raises:
        AssetError: The model file is missing, unreadable or has other joints.
    """
    links = read_urdf(UR10_URDF, None, np.eye(4)).links
    if model is not ArmModel.UR10 or calibration is not None:
        origins = joint_origins([link.X_parent_joint for link in links[1:]], model, calibration)
        nominal = joint_origins([link.X_parent_joint for link in links[1:]], model, None)
        shifts = [X[:3, 3] - link.X_parent_joint[:3, 3] for link, X in zip(links[1:], nominal, strict=True)]
        origins = [links[0].X_parent_joint, *origins]
        links = tuple(
            replace(link, X_parent_joint=X, collisions=_stretched(link.collisions, shift))
            for link, X, shift in zip(links, origins, [*shifts, np.zeros(3)], strict=True)
        )
    tree = Tree(_weighed(links, model))
    if tree.joints != ARM_JOINTS:
        raise AssetError(f"{UR10_URDF} has unexpected joints: {tree.joints}; reinstall toolee_robot")
    return tree


def _weighed(links: tuple[Link, ...], model: ArmModel) -> tuple[Link, ...]:
    """The arm's links, base and flange among them, with the masses and centres of mass of a model."""
    data = ARM_DATA[model]
    poses = Tree(links).link_poses(np.zeros(6))
    frames = DhParameters.of(model).zero_frames()[1:]
    found = {}
    for link, X_dh, mass, centre in zip(links[1:-1], frames, data.link_mass, data.link_center_of_mass, strict=True):
        was = link.inertial
        if was is None:
            raise AssetError(f"{UR10_URDF}: {link.name} has no inertia; reinstall toolee_robot")
        p = (inverse(poses[link.name]) @ HALF_TURN @ X_dh @ [*centre, 1.0])[:3]
        moments = tuple(moment * mass / was.mass for moment in was.moments)
        found[link.name] = replace(
            link, inertial=Inertial(mass, transform(was.X_link_com[:3, :3], p), (moments[0], moments[1], moments[2]))
        )
    return tuple(found.get(link.name, link) for link in links)


def _stretched(shapes: tuple[Shape, ...], shift: Array) -> tuple[Shape, ...]:
    """The shapes, and again displaced by a shift (3,) [m] in the link's frame."""
    if np.linalg.norm(shift) < _SAME:
        return shapes
    return (*shapes, *(replace(s, X_link_shape=transform(p=shift) @ s.X_link_shape) for s in shapes))


@lru_cache(maxsize=8)
def robot_tree(
    model: ArmModel = ArmModel.UR10, calibration: DhCalibration | None = None, hand: HandModel = SHADOW_HAND
) -> Tree:
    """The merged kinematic tree of arm and hand.

    Args:
        model: The arm.
        calibration: Factory calibration of the arm; None: nominal kinematics.
        hand: The hand on the flange.

    Returns:
        The links of the arm, then those of the hand.

    Raises:
        AssetError: A model file is missing or unreadable, or arm and hand share link names.
    """
    arm = arm_tree(model, calibration)
    shared = arm.by_name.keys() & hand.tree.by_name.keys()
    if shared:
        raise AssetError(f"arm and {hand.label} both have links named {sorted(shared)}: rename them in {hand.source}")
    if hand.clamps:  # the mass of a mount is all that the flange carries, plates included
        bare = (replace(k, inertial=NEARLY_MASSLESS) if k.name == FLANGE_FRAME else k for k in arm.links)
        return Tree((*bare, *hand.tree.links))
    return Tree((*arm.links, *hand.tree.links))


def load_robot(
    model: ArmModel = ArmModel.UR10,
    calibration: DhCalibration | None = None,
    hand: str | HandChoice = SHADOW_HAND.name,
) -> RobotDescription:
    """Build the merged robot.

    Args:
        model: The arm.
        calibration: Factory calibration of the arm; None: nominal kinematics.
        hand: Name of the hand, see `toolee_robot.robots.hands.HANDS`; or what a station file says of it.

    Returns:
        Names, URDF and meshes of arm and hand.

    Raises:
        ConfigError: There is no such hand.
        AssetError: A model file is missing or cannot be read.
    """
    return _load_robot(model, calibration, hand_model(hand))


@lru_cache(maxsize=8)
def _load_robot(model: ArmModel, calibration: DhCalibration | None, hand: HandModel) -> RobotDescription:
    tree = robot_tree(model, calibration, hand)
    lower, upper = tree.limits()
    movable = [link for link in tree.links if link.axis is not None]
    return RobotDescription(
        model=model,
        calibrated=calibration is not None,
        hand=hand,
        urdf=write_urdf(f"{model.lower()}_{hand.name}", tree),
        tree=tree,
        arm_joints=ARM_JOINTS,
        flange_frame=FLANGE_FRAME,
        hand_open=hand.posture("open"),
        hand_closed=hand.posture("closed"),
        lower=lower,
        upper=upper,
        effort=np.array([link.effort for link in movable]),
        velocity=np.array([link.velocity for link in movable]),
    )


def arm_link_poses(q_arm: Array) -> dict[str, Array]:
    """Link name -> X_base_link (4x4) [m] of the nominal UR10 at q_arm (6,) [rad]."""
    return arm_tree().link_poses(q_arm)


@cache
def arm_meshes() -> dict[str, trimesh.Trimesh]:
    """Link name -> simplified mesh of the UR10 in the link frame [m]."""
    found = {}
    for link in arm_tree().links:
        mesh = link_mesh(link, _ARM_CELL)
        if mesh is not None:
            found[link.name] = mesh
    return found

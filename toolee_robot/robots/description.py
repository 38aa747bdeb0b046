"""The merged robot: one URDF for Pinocchio and pybullet, joint names, postures, meshes and plain-numpy kinematics."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh

from toolee_robot.errors import AssetError
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.robots.assets import cache_folder, model_versions, shadow_hand_folder, ur10_urdf
from toolee_robot.robots.dh import joint_origins
from toolee_robot.robots.grasp import posture_vector
from toolee_robot.robots.meshes import link_mesh
from toolee_robot.robots.mjcf import read_shadow_hand
from toolee_robot.robots.tree import Shape, Tree
from toolee_robot.robots.urdf import read_ur10, write_urdf
from toolee_robot.types import ArmModel, DhCalibration, Payload

BASE_FRAME = "base_link"
FLANGE_FRAME = "tool0"
HAND_FRAME = "rh_palm"
ARM_JOINTS = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
)  # fmt: skip
WRIST_JOINTS = ("rh_WRJ2", "rh_WRJ1")
HAND_JOINTS = (
    *WRIST_JOINTS,
    *(f"rh_{finger}J{j}" for finger in ("FF", "MF", "RF") for j in (4, 3, 2, 1)),
    *(f"rh_LFJ{j}" for j in (5, 4, 3, 2, 1)),
    *(f"rh_THJ{j}" for j in (5, 4, 3, 2, 1)),
)

# The forearm's shell begins 40 mm above its frame's origin, 10 mm off its axis; a 10 mm plate joins it to the flange.
X_FLANGE_FOREARM = transform(p=[0.0, -0.010, -0.030])

_HAND_CELL = 0.0042  # [m] of the fingers and the palm
_FOREARM_CELL = 0.018  # [m]
_ARM_CELL = 0.012  # [m]


@dataclass(frozen=True)
class RobotDescription:
    """Arm and Shadow Hand as one kinematic tree rooted in `base` (the UR base_link).

    model: of the arm. calibrated: whether the kinematics are this very arm's, or the model's nominal ones, which are a
    millimetre or two off at the flange. A UR10e has its own kinematics, but the UR10's meshes and inertias, which are
    an approximation: its base stands 53 mm lower in them than the arm does.
    urdf_path: the merged URDF, absolute mesh paths. package_dirs: for Pinocchio's loaders. arm_joints (6) and
    hand_joints (24, wrist first) are the URDF's joint names; pybullet keeps this order, Pinocchio sorts sibling
    fingers by name, so map by name there.
    hand_open, hand_preshape, hand_closed: (24,) [rad]. lower, upper: position limits (30,) [rad]; effort (30,) [Nm];
    velocity (30,) [rad/s]; all arm first.
    """

    model: ArmModel
    calibrated: bool
    urdf_path: Path
    package_dirs: tuple[Path, ...]
    tree: Tree
    arm_joints: tuple[str, ...]
    hand_joints: tuple[str, ...]
    base_frame: str
    flange_frame: str
    hand_frame: str
    hand_open: Array
    hand_preshape: Array
    hand_closed: Array
    lower: Array
    upper: Array
    effort: Array
    velocity: Array

    def link_poses(self, q_arm: Array, q_hand: Array) -> dict[str, Array]:
        """X_base_link of every link; q_arm (6,), q_hand (24,) [rad]."""
        return self.tree.link_poses(np.concatenate([q_arm, q_hand]))

    def X_flange_hand(self, q_hand: Array) -> Array:
        """Pose of the palm in the flange, 4x4; only the wrist of q_hand (24,) matters."""
        poses = self.tree.link_poses(np.concatenate([np.zeros(len(self.arm_joints)), q_hand]))
        return inverse(poses[self.flange_frame]) @ poses[self.hand_frame]

    def hand_payload(self, q_hand: Array) -> Payload:
        """Mass and centre of mass of the hand, its forearm and its mounting plate, as the flange carries them."""
        poses = self.tree.link_poses(np.concatenate([np.zeros(len(self.arm_joints)), q_hand]))
        X_flange_base = inverse(poses[self.flange_frame])
        mass, moment = 0.0, np.zeros(3)
        for link in self.tree.links:
            carried = link.name.startswith("rh_") or link.name == self.flange_frame
            if carried and link.inertial is not None:
                mass += link.inertial.mass
                moment += link.inertial.mass * (X_flange_base @ poses[link.name] @ link.inertial.X_link_com)[:3, 3]
        return Payload(mass, moment / mass)


@lru_cache(maxsize=1)
def hand_tree() -> Tree:
    """The Shadow Hand's links, rooted in its forearm (parent: the flange). Needs gymnasium-robotics' files only, found
    on the import path without importing them."""
    return read_shadow_hand(shadow_hand_folder(), FLANGE_FRAME, X_FLANGE_FOREARM)


@lru_cache(maxsize=4)
def robot_tree(model: ArmModel = ArmModel.UR10, calibration: DhCalibration | None = None) -> Tree:
    """The merged kinematic tree. Raises AssetError naming the pip package when a model is missing."""
    arm = read_ur10(ur10_urdf()).links
    if model is not ArmModel.UR10 or calibration is not None:
        origins = joint_origins([link.X_parent_joint for link in arm[1:]], model, calibration)
        arm = (arm[0], *(replace(link, X_parent_joint=X) for link, X in zip(arm[1:], origins, strict=True)))
    tree = Tree((*arm, *hand_tree().links))
    if tree.joints != (*ARM_JOINTS, *HAND_JOINTS):
        raise AssetError(
            f"the model packages changed their joints: {tree.joints}; install the versions in pyproject.toml"
        )
    return tree


def _install(name: str, tree: Tree) -> Path:
    """Write URDF and meshes into the cache, once per content; returns the URDF's path."""
    probe = write_urdf(name, tree, lambda shape: Path(shape.mesh.name if shape.mesh else ""))
    key = hashlib.sha256((model_versions() + probe).encode()).hexdigest()[:16]
    folder = cache_folder() / f"robot-{key}"
    urdf = folder / f"{name}.urdf"
    if urdf.is_file():
        return urdf
    scratch = Path(tempfile.mkdtemp(dir=folder.parent))

    def place(shape: Shape) -> Path:
        if shape.mesh is None:
            raise ValueError("a mesh shape without a file")
        prefix = "ur10" if "ur10" in shape.mesh.parts else "hand"
        target = scratch / "meshes" / f"{prefix}_{shape.mesh.name}"
        target.parent.mkdir(exist_ok=True)
        if not target.exists():
            shutil.copyfile(shape.mesh, target)
        return folder / "meshes" / target.name

    (scratch / urdf.name).write_text(write_urdf(name, tree, place))
    try:
        scratch.replace(folder)
    except OSError:  # another process was first
        shutil.rmtree(scratch, ignore_errors=True)
        if not urdf.is_file():
            raise
    return urdf


def load_robot(model: ArmModel = ArmModel.UR10, calibration: DhCalibration | None = None) -> RobotDescription:
    """Build (or find in the cache) the merged robot, calibrated where its arm's calibration is given.

    Raises AssetError naming a missing pip package.
    """
    return _load_robot(model, calibration)


@lru_cache(maxsize=4)
def _load_robot(model: ArmModel, calibration: DhCalibration | None) -> RobotDescription:
    tree = robot_tree(model, calibration)
    urdf = _install(f"{model.lower()}_shadow", tree)
    lower, upper = tree.limits()
    movable = [link for link in tree.links if link.axis is not None]
    return RobotDescription(
        model=model,
        calibrated=calibration is not None,
        urdf_path=urdf,
        package_dirs=(urdf.parent,),
        tree=tree,
        arm_joints=ARM_JOINTS,
        hand_joints=HAND_JOINTS,
        base_frame=BASE_FRAME,
        flange_frame=FLANGE_FRAME,
        hand_frame=HAND_FRAME,
        hand_open=posture_vector("open", HAND_JOINTS),
        hand_preshape=posture_vector("preshape", HAND_JOINTS),
        hand_closed=posture_vector("closed", HAND_JOINTS),
        lower=lower,
        upper=upper,
        effort=np.array([link.effort for link in movable]),
        velocity=np.array([link.velocity for link in movable]),
    )


def hand_link_poses(q_hand: Array) -> dict[str, Array]:
    """X_hand_link (4x4) of every link of the hand, forearm included, at q_hand (24,) [rad] in the order HAND_JOINTS."""
    poses = hand_tree().link_poses(q_hand)
    X_hand_flange = inverse(poses[HAND_FRAME])
    return {name: X_hand_flange @ X for name, X in poses.items()}


def arm_link_poses(q_arm: Array) -> dict[str, Array]:
    """X_base_link (4x4) of every link of the arm at q_arm (6,) [rad]."""
    poses = robot_tree().link_poses(np.concatenate([q_arm, np.zeros(len(HAND_JOINTS))]))
    return {name: X for name, X in poses.items() if not name.startswith("rh_")}


@lru_cache(maxsize=2)
def _meshes(hand: bool) -> dict[str, trimesh.Trimesh]:
    links = hand_tree().links if hand else read_ur10(ur10_urdf()).links
    found = {}
    for link in links:
        cell = _FOREARM_CELL if link.name == "rh_forearm" else _HAND_CELL if hand else _ARM_CELL
        mesh = link_mesh(link, cell)
        if mesh is not None:
            found[link.name] = mesh
    return found


def hand_meshes() -> dict[str, trimesh.Trimesh]:
    """Link -> mesh in the link's frame [m], the hand with its forearm, about 8000 faces in all."""
    return _meshes(True)


def arm_meshes() -> dict[str, trimesh.Trimesh]:
    """Link -> mesh in the link's frame [m] of the arm."""
    return _meshes(False)

"""A tool mount on the flange in the place of a hand: a body, a hinge that yields, and a clamp for a handle."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from toolee_robot.frames import Array, inverse, transform
from toolee_robot.robots.hands.model import HandModel, NominalGrasp, WristJoint
from toolee_robot.robots.tree import Inertial, Link, Shape, Tree
from toolee_robot.types import MOUNT, ToolMount

HINGE = "mount_hinge"
_BODY, _CLAMP, _FRAME = "mount_body", "mount_clamp", "mount"
_CLAMP_SIZE = 0.04  # [m] edge of the cube as which the clamp's inertia is taken
_FASTEST = 20.0  # [rad/s]
_MARK = Inertial(1e-3, np.eye(4), (1e-7, 1e-7, 1e-7))  # a link without mass makes the engine assume 1 kg


@lru_cache(maxsize=8)
def mount_model(mount: ToolMount, yield_torque: float) -> HandModel:
    """Build the model of a tool mount: a hand without fingers, whose wrist is the hinge that yields.

    Args:
        mount: The mount's data.
        yield_torque: Torque above which it yields [Nm].

    Returns:
        The model. Its hand frame is the clamp: x along the handle, z towards the tool's working side.
    """
    tree = _tree(mount, yield_torque)
    return HandModel(
        name=MOUNT,
        label="tool mount",
        source=Path("hand.mount"),
        read=lambda *_: tree,
        X_flange_root=np.eye(4),
        frame=_FRAME,
        wrist=(WristJoint(HINGE, rest=0.0, torque=yield_torque, stiffness=mount.stiffness),),
        fingers=(),
        finger_joints=(),
        forearm=(),
        postures={"open": {}, "preshape": {}, "closed": {}},
        closing_order=(),
        wrapping_order=(),
        grasp=NominalGrasp(z=(1.0, 0.0, 0.0), x=(0.0, 0.0, 1.0), p=(0.0, 0.0, 0.0), p_per_radius=(0.0, 0.0, 0.0)),
        holding_links=0,
        finger_force=0.0,
        grip_width=_CLAMP_SIZE,
        clamps=True,
    )


def _tree(mount: ToolMount, yield_torque: float) -> Tree:
    X_flange_mount = mount.X_flange_mount
    X_flange_hinge = transform(X_flange_mount[:3, :3], mount.hinge_position)
    X_hinge_mount = inverse(X_flange_hinge) @ X_flange_mount
    fixed = mount.mass - mount.clamp_mass - _MARK.mass
    moment = mount.mass * np.array(mount.center_of_mass) - (mount.clamp_mass + _MARK.mass) * np.array(mount.position)
    body = Shape("box", mount.body_size, transform(p=mount.body_position))
    return Tree(
        (
            Link(
                _BODY,
                "tool0",
                np.eye(4),
                f"{_BODY}_mount",
                inertial=_box(fixed, moment / fixed, np.array(mount.body_size)),
                visuals=(body,),
                collisions=(body,),
            ),
            Link(
                _CLAMP,
                _BODY,
                X_flange_hinge,
                HINGE,
                axis=X_flange_hinge[:3, :3].T @ mount.axis,
                lower=0.0,
                upper=mount.travel,
                effort=yield_torque + mount.stiffness * mount.travel,
                velocity=_FASTEST,
                inertial=_box(mount.clamp_mass, X_hinge_mount[:3, 3], np.full(3, _CLAMP_SIZE)),
            ),
            Link(_FRAME, _CLAMP, X_hinge_mount, f"{_FRAME}_fixed", inertial=_MARK),
        )
    )


def _box(mass: float, p: Array, size: Array) -> Inertial:
    x, y, z = np.square(size)
    return Inertial(mass, transform(p=p), tuple(mass / 12.0 * np.array([y + z, x + z, x + y])))

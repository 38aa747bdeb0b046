"""The Robotiq 2F-85 and 2F-140: one motor, two jaws that stay parallel, no wrist.

Strokes, forces and the range of positions are the maker's; shapes, masses and the linkage are simple bodies of about
the same size, built here. A jaw is a knuckle that swings and a pad that turns back by as much. How the gripper sits on
the flange is not known to anybody but the lab: `hand.mounting`, with `fingers` along the jaws and `thumb` along the
axis of a handle between the pads.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from toolee_robot.frames import Array, transform
from toolee_robot.robots.hands.model import UNMOUNTED, Finger, HandModel, NominalGrasp, Phalanx
from toolee_robot.robots.tree import Inertial, Link, Shape, Tree

OPEN, SHUT = 3.0, 230.0
"""Positions of the open and of the empty, shut gripper [of 255] (blog.robotiq.com/knowledge/encoder-bytes-adaptive-
gripper; ur_rtde issue 356 of a 2F-140)."""
_AXIS_Y, _AXIS_Z, _PAD = 0.0127, 0.0614, 0.0081  # [m] of a knuckle, and from the pad's link to its face
_FASTEST = 2.0  # [rad/s]


@dataclass(frozen=True)
class Size:
    """What tells the two grippers apart."""

    name: str
    """Name in a station file."""
    stroke: float
    """Distance of the open jaws [m]."""
    force: float
    """Largest force of the grip [N] (instruction manual, *Specifications*)."""
    knuckle: float
    """Length of a knuckle [m]."""
    pad: float
    """Length of a jaw beyond it [m]."""
    mass: float
    """Mass [kg], about."""

    @property
    def swing(self) -> tuple[float, float]:
        """Angles of the knuckles from straight ahead, open and shut [rad]."""
        return self._angle(self.stroke), self._angle(0.0)

    def knuckles(self, position: float) -> float:
        """Angle by which the knuckles have closed at a position [of 255], [rad]."""
        share = float(np.clip((SHUT - position) / (SHUT - OPEN), 0.0, 1.0))
        return self.swing[0] - self._angle(share * self.stroke)

    def _angle(self, width: float) -> float:
        return float(np.arcsin((0.5 * width - _AXIS_Y + _PAD) / self.knuckle))


SIZES = {
    size.name: size
    for size in (
        Size("robotiq_2f85", 0.085, 235.0, 0.0575, 0.045, 0.9),
        Size("robotiq_2f140", 0.140, 125.0, 0.0900, 0.0815, 1.0),
    )
}
"""Name in a station file -> gripper."""
_JOINTS = ("left_knuckle", "left_pad", "right_knuckle", "right_pad")


def joints_of_position(name: str, position: float) -> Array:
    """Convert a gripper's position to those of the model's joints.

    Args:
        name: Its name in a station file.
        position: The position [of 255].

    Returns:
        Of `HandModel.joints`, (4,) [rad].
    """
    return np.full(4, SIZES[name].knuckles(position))


def _tree(size: Size, _: Path, parent: str, X_parent_root: Array) -> Tree:
    body = Shape("box", (0.075, 0.075, _AXIS_Z), transform(p=[0.0, 0.0, 0.5 * _AXIS_Z]))
    links = [_link(size.name, parent, X_parent_root, f"{size.name}_mount", None, body, 0.8 * size.mass)]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        tilt = _about_x(-sign * size.swing[0])
        X_knuckle = transform(tilt, [0.0, sign * _AXIS_Y, _AXIS_Z])
        X_pad = transform(tilt.T, [0.0, 0.0, size.knuckle])
        bar = Shape("box", (0.022, 0.012, size.knuckle), transform(p=[0.0, 0.0, 0.5 * size.knuckle]))
        pad = Shape("box", (0.022, 2.0 * _PAD, size.pad), transform(p=[0.0, 0.0, 0.5 * size.pad]))
        axis = np.array([sign, 0.0, 0.0])
        links += [
            _link(f"{side}_bar", size.name, X_knuckle, f"{side}_knuckle", axis, bar, 0.04 * size.mass, size),
            _link(f"{side}_jaw", f"{side}_bar", X_pad, f"{side}_pad", -axis, pad, 0.06 * size.mass, size),
        ]
    return Tree(tuple(links))


def _link(
    name: str,
    parent: str,
    X: Array,
    joint: str,
    axis: Array | None,
    shape: Shape,
    mass: float,
    size: Size | None = None,
) -> Link:
    x, y, z = np.square(shape.size)
    moments = mass / 12.0 * np.array([y + z, x + z, x + y])
    inertial = Inertial(mass, shape.X_link_shape, (float(moments[0]), float(moments[1]), float(moments[2])))
    if size is None:
        return Link(name, parent, X, joint, inertial=inertial, visuals=(shape,), collisions=(shape,))
    return Link(
        name, parent, X, joint, axis, 0.0, size.knuckles(SHUT) + 0.05, size.force * size.knuckle, _FASTEST, inertial,
        (shape,), (shape,),
    )  # fmt: skip


def _about_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _model(size: Size) -> HandModel:
    reach = _AXIS_Z + size.knuckle * float(np.cos(size.swing[1])) + 0.5 * size.pad
    return HandModel(
        name=size.name,
        label=f"Robotiq 2F-{round(1e3 * size.stroke)}",
        source=Path(size.name),
        read=partial(_tree, size),
        X_flange_root=UNMOUNTED,
        frame=size.name,
        wrist=(),
        fingers=tuple(
            Finger(side, (f"{side}_bar", f"{side}_jaw"), (Phalanx(f"{side}_jaw", _PAD, size.pad - _PAD),))
            for side in ("left", "right")
        ),
        finger_joints=_JOINTS,
        forearm=(),
        postures={
            posture: dict.fromkeys(_JOINTS, size.knuckles(position))
            for posture, position in (("open", OPEN), ("preshape", 0.5 * (OPEN + SHUT)), ("closed", SHUT))
        },
        closing_order=(_JOINTS,),
        wrapping_order=(("left_knuckle", "right_knuckle"), ("left_pad", "right_pad")),
        # The handle lies across the jaws, in the middle of the pads.
        grasp=NominalGrasp(z=(1.0, 0.0, 0.0), x=(0.0, 0.0, 1.0), p=(0.0, 0.0, reach), p_per_radius=(0.0, 0.0, 0.0)),
        holding_links=1,
        finger_force=size.force,
        grip_width=0.022,
    )


ROBOTIQ_2F85, ROBOTIQ_2F140 = map(_model, SIZES.values())

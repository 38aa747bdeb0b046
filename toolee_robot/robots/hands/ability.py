"""The right, large PSYONIC Ability Hand: six motors, ten joints, no wrist.

Joint positions, axes, ranges, speeds and masses are the maker's: `models/ability_hand/README.md`. How the hand sits on
the flange is not known to anybody but the lab: `HandConfig.mounting`.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.robots.hands.model import UNMOUNTED, Finger, HandModel, NominalGrasp, Phalanx
from toolee_robot.robots.tree import ABILITY_HAND_URDF
from toolee_robot.robots.urdf import read_urdf

ABILITY = "ability_hand"
"""Name of the hand in a station file."""
MOTORS = ("index", "middle", "ring", "little", "thumb flexor", "thumb rotator")
"""The motors in the maker's order."""
THUMB_ROTATION = 52.0
"""Where the thumb's rotator stands in every posture [deg]: it bends over a handle beside the index finger there."""
OPEN = (0.0, 0.0, 0.0, 0.0, 0.0, THUMB_ROTATION)
"""Closures of the open hand [deg]: the thumb stands before the palm."""
CLOSED = (95.0, 95.0, 95.0, 95.0, 95.0, THUMB_ROTATION)
"""Closures at which the closing hand aims [deg]."""
RANGE = 100.0
"""Closure of a motor at its end [deg]; the maker's positions are the same but for the rotator's sign."""

_FINGERS = ("index", "middle", "ring", "little")
_MIDDLE_PER_KNUCKLE = 1.05851325
"""The maker's straight line through the four-bar linkage of a finger [rad/rad]."""
_LIMIT = 1.74  # [rad]
_TORQUE = 2.0
"""Torque limit of a joint in simulation [Nm], assumed: with the 6 Nm of the maker's URDF fingers press with up to
330 N, and with 0.7 Nm they do not follow a driver's hand that closes around a handle."""


def joints_of_closures(closures: Array) -> Array:
    """Convert the motors' closures to joint positions.

    Args:
        closures: Of the motors in the order of `MOTORS`, (6,) [deg].

    Returns:
        Positions in the order of the model's joints, (10,) [rad].
    """
    angle = np.clip(np.deg2rad(np.asarray(closures, float)), 0.0, _LIMIT)
    joints = []
    for finger in _FINGERS:
        knuckle = angle[MOTORS.index(finger)]
        joints += [knuckle, _MIDDLE_PER_KNUCKLE * knuckle]
    return np.array([*joints, angle[MOTORS.index("thumb rotator")], angle[MOTORS.index("thumb flexor")]])


_JOINTS = (
    *(f"{finger}_{joint}" for finger in _FINGERS for joint in ("knuckle", "middle")),
    *("thumb_rotation", "thumb_bend"),
)


def _posture(closures: tuple[float, ...]) -> dict[str, float]:
    return dict(zip(_JOINTS, map(float, joints_of_closures(np.array(closures))), strict=True))


def _finger(name: str) -> Finger:
    links = (f"{name}_proximal", f"{name}_distal")
    return Finger(name, links, tuple(map(Phalanx, links, (0.0095, 0.0075), (0.0386, 0.0332))))


def _each(joint: str) -> tuple[str, ...]:
    return tuple(f"{finger}_{joint}" for finger in _FINGERS)


ABILITY_HAND = HandModel(
    name=ABILITY,
    label="PSYONIC Ability Hand (right, large)",
    source=ABILITY_HAND_URDF,
    read=partial(read_urdf, most_effort=_TORQUE),
    X_flange_root=UNMOUNTED,
    frame="ability_palm",
    wrist=(),
    fingers=(
        Finger("thumb", ("thumb_base", "thumb_distal"), (Phalanx("thumb_distal", 0.009, 0.0595),)),
        *(_finger(name) for name in _FINGERS),
    ),
    finger_joints=_JOINTS,
    forearm=(),
    postures={
        "open": _posture(OPEN),
        "preshape": _posture((45.0, 45.0, 45.0, 45.0, 0.0, THUMB_ROTATION)),
        "closed": _posture(CLOSED),
    },
    closing_order=(("thumb_rotation", *_each("knuckle")), _each("middle"), ("thumb_bend",)),
    wrapping_order=(_each("knuckle"), _each("middle"), ("thumb_bend",)),
    # The handle lies across the palm, under the roots of the fingers.
    grasp=NominalGrasp(z=(1.0, 0.0, 0.0), x=(0.0, 0.0, 1.0), p=(0.0, -0.005, 0.090), p_per_radius=(0.0, -1.0, -0.45)),
    holding_links=2,
    finger_force=10.0,  # not published: a guess, the smallest of what comparable hands press with
    grip_width=0.078,
)

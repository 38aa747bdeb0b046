"""The right Inspire RH56 (RH56DFX, RH56BFX): six motors, twelve joints, no wrist.

Joint positions, ranges and couplings are those of the maker's CAD, as the MIT-licensed
github.com/ookkshirsagar/rh56dfx_description gives them for the right hand; shapes and masses here are simple bodies of
about the same size and of 0.54 kg in all, the maker's number. How the hand sits on the flange is not known to anybody
but the lab: `HandConfig.mounting`.
"""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.robots.hands.model import UNMOUNTED, Finger, HandModel, NominalGrasp, Phalanx
from toolee_robot.robots.tree import INSPIRE_RH56_URDF
from toolee_robot.robots.urdf import read_urdf

INSPIRE = "inspire_rh56"
"""Name of the hand in a station file."""
MOTORS = ("little", "ring", "middle", "index", "thumb bend", "thumb rotation")
"""The motors in the maker's order."""
COUNTS = 1000
"""Angle of a stretched finger, and of a thumb that points aside, in the maker's counts; 0 is bent."""
OPEN = (COUNTS, COUNTS, COUNTS, COUNTS, COUNTS, 0)
"""Angles of the open hand [counts]: stretched fingers, and a stretched thumb before the palm, where it does not lie in
the way of a handle as it does at the side of the palm."""
CLOSED = (0, 0, 0, 0, 0, 0)
"""Angles at which the closing hand aims [counts]."""

_FINGERS = ("index", "middle", "ring", "little")
_KNUCKLE_RANGE, _ROTATION_RANGE, _THUMB_RANGE = 1.344, 1.310, 0.523  # [rad]
_MIDDLE_PER_KNUCKLE, _MIDDLE_OFFSET = 1.1169, -0.15  # [rad/rad], [rad]
_THUMB_2_PER_1, _THUMB_3_PER_2 = 1.1425, 0.7508  # [rad/rad]


def joints_of_counts(counts: Array) -> Array:
    """Convert the motors' angles to joint positions; that they are proportional is an assumption.

    Args:
        counts: Angles of the motors in the order of `MOTORS`, (6,) [counts of 0 to COUNTS].

    Returns:
        Positions in the order of the model's joints, (12,) [rad].
    """
    bent = 1.0 - np.clip(np.asarray(counts, float), 0.0, COUNTS) / COUNTS
    joints = []
    for finger in _FINGERS:
        knuckle = _KNUCKLE_RANGE * bent[MOTORS.index(finger)]
        joints += [knuckle, max(0.0, _MIDDLE_PER_KNUCKLE * knuckle + _MIDDLE_OFFSET)]
    first = _THUMB_RANGE * bent[MOTORS.index("thumb bend")]
    second = _THUMB_2_PER_1 * first
    rotation = _ROTATION_RANGE * bent[MOTORS.index("thumb rotation")]
    return np.array([*joints, rotation, first, second, _THUMB_3_PER_2 * second])


def _posture(counts: tuple[int, ...]) -> dict[str, float]:
    return dict(zip(_JOINTS, map(float, joints_of_counts(np.array(counts))), strict=True))


_JOINTS = (
    *(f"{finger}_{joint}" for finger in _FINGERS for joint in ("knuckle", "middle")),
    *("thumb_rotation", "thumb_1", "thumb_2", "thumb_3"),
)
_RADIUS = 0.0085  # [m]
_KNUCKLE_LENGTH = 0.0321  # [m]
_TIP_LENGTHS = {"index": 0.036, "middle": 0.040, "ring": 0.036, "little": 0.031}  # [m] to the centre of the tip


def _finger(name: str) -> Finger:
    links = (f"{name}_proximal", f"{name}_distal")
    lengths = (_KNUCKLE_LENGTH, _TIP_LENGTHS[name])
    return Finger(name, links, tuple(Phalanx(link, _RADIUS, n) for link, n in zip(links, lengths, strict=True)))


def _each(joint: str) -> tuple[str, ...]:
    return tuple(f"{finger}_{joint}" for finger in _FINGERS)


_THUMB_LINKS = ("thumb_proximal", "thumb_middle", "thumb_distal")

INSPIRE_RH56 = HandModel(
    name=INSPIRE,
    label="Inspire RH56 (right)",
    source=INSPIRE_RH56_URDF,
    read=read_urdf,
    X_flange_root=UNMOUNTED,
    frame="inspire_palm",
    wrist=(),
    fingers=(
        Finger(
            "thumb",
            ("thumb_base", *_THUMB_LINKS),
            tuple(map(Phalanx, _THUMB_LINKS, (0.009, 0.0085, 0.008), (0.056, 0.0227, 0.020))),
        ),
        *(_finger(name) for name in _FINGERS),
    ),
    finger_joints=_JOINTS,
    forearm=(),
    postures={
        "open": _posture(OPEN),
        "preshape": _posture((600, 600, 600, 600, COUNTS, 0)),
        "closed": _posture(CLOSED),
    },
    closing_order=(("thumb_rotation", *_each("knuckle")), _each("middle"), ("thumb_1",), ("thumb_2", "thumb_3")),
    wrapping_order=(_each("knuckle"), _each("middle"), ("thumb_rotation",), ("thumb_1",), ("thumb_2",), ("thumb_3",)),
    # The handle lies across the palm, at the roots of the fingers.
    grasp=NominalGrasp(z=(1.0, 0.0, 0.0), x=(0.0, 0.0, 1.0), p=(0.0, -0.012, 0.098), p_per_radius=(0.0, -1.0, -0.6)),
    holding_links=2,
    finger_force=7.0,  # measured at the index finger's tip
    grip_width=0.075,
)

"""The right Shadow Hand with its electric forearm and its two wrist joints, the paper's hand.

The maker's own description (`sr_description`, `hand/xacro`) counts four joints the other way round than the model does:
`MAKER_SIGNS`.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from toolee_robot.frames import Array, transform
from toolee_robot.robots.hands.model import Finger, HandModel, NominalGrasp, Phalanx, WristJoint
from toolee_robot.robots.tree import SHADOW_HAND_URDF
from toolee_robot.robots.urdf import read_urdf

# The maker's prefixes: first, middle, ring, little finger. Joint 1 is a finger's last, joint 4 spreads it.
_FINGERS = {"index": "FF", "middle": "MF", "ring": "RF", "little": "LF"}
_PALM_SURFACE = -0.0111  # [m] y of the palm's face in the hand frame
_KNUCKLE = 0.085  # [m] z of the proximal phalanges' palmar surface when the fingers are bent by 90 deg

_THUMB_AWAY = {"rh_THJ5": -1.0, "rh_THJ4": 1.2, "rh_THJ3": 0.0, "rh_THJ2": 0.0, "rh_THJ1": 0.0}
_THUMB_OVER = {"rh_THJ5": 0.75, "rh_THJ4": 1.2, "rh_THJ3": 0.2, "rh_THJ2": -0.3, "rh_THJ1": -0.6}


def _all(joint: int) -> tuple[str, ...]:
    return tuple(f"rh_{finger}J{joint}" for finger in _FINGERS.values())


def _bent(knuckle: float, middle: float, tip: float, thumb: dict[str, float]) -> dict[str, float]:
    bend = {3: knuckle, 2: middle, 1: tip}
    return {joint: angle for number, angle in bend.items() for joint in _all(number)} | thumb


def _finger(name: str, prefix: str, segments: tuple[str, ...], radii: tuple[float, ...], lengths: tuple[float, ...],
            others: tuple[str, ...]) -> Finger:  # fmt: skip
    phalanges = zip(segments, radii, lengths, strict=True)
    return Finger(
        name,
        tuple(f"rh_{prefix}{part}" for part in (*others, *segments)),
        tuple(Phalanx(f"rh_{prefix}{part}", radius, length) for part, radius, length in phalanges),
    )


_SEGMENTS = ("proximal", "middle", "distal")
_RADII, _LENGTHS = (0.010, 0.00805, 0.00705), (0.045, 0.025, 0.024)  # [m] as in the model's collision capsules

SHADOW = "shadow_right"
"""Name of the hand in a station file."""

SHADOW_HAND = HandModel(
    name=SHADOW,
    label="Shadow Hand (right)",
    source=SHADOW_HAND_URDF,
    read=partial(read_urdf, substitute_shapes=False),
    # The forearm's shell begins 40 mm above its frame's origin, 10 mm off its axis; a 10 mm plate joins it to the
    # flange.
    X_flange_root=transform(p=[0.0, -0.010, -0.030]),
    frame="rh_palm",
    wrist=(
        # Deviation. Its range is -0.489..0.14 rad and a strike turns it towards +: resting at -0.45 leaves 34 deg in
        # which the wrist yields while the arm stops. The forearm then leans away from the nail by as much. 3.3 Nm
        # carry a hammer and are less than the grip can hold against.
        WristJoint("rh_WRJ2", rest=-0.45, torque=3.3, shown=(-0.45, 0.12)),
        WristJoint("rh_WRJ1", rest=0.0, shown=(-0.6, 0.4)),
    ),
    fingers=(
        _finger("thumb", "th", _SEGMENTS, (0.013, 0.011, 0.00918), (0.038, 0.032, 0.026), ("base", "hub")),
        _finger("index", "ff", _SEGMENTS, _RADII, _LENGTHS, ("knuckle",)),
        _finger("middle", "mf", _SEGMENTS, _RADII, _LENGTHS, ("knuckle",)),
        _finger("ring", "rf", _SEGMENTS, _RADII, _LENGTHS, ("knuckle",)),
        _finger("little", "lf", _SEGMENTS, _RADII, _LENGTHS, ("metacarpal", "knuckle")),
    ),
    finger_joints=(
        *(f"rh_{finger}J{j}" for finger in ("FF", "MF", "RF") for j in (4, 3, 2, 1)),
        *(f"rh_LFJ{j}" for j in (5, 4, 3, 2, 1)),
        *(f"rh_THJ{j}" for j in (5, 4, 3, 2, 1)),
    ),
    forearm=("rh_forearm", "rh_wrist"),
    postures={
        "open": _bent(0.0, 0.0, 0.0, _THUMB_AWAY),
        "preshape": _bent(0.9, 0.6, 0.4, _THUMB_AWAY),
        "closed": _bent(1.5, 1.5, 1.2, _THUMB_OVER),
    },
    # The order of a human power grasp: knuckles first, then the finger joints outwards, the thumb over them last.
    closing_order=(_all(3), _all(2), _all(1), ("rh_THJ5", "rh_THJ4", "rh_THJ3"), ("rh_THJ2", "rh_THJ1")),
    wrapping_order=(_all(3), _all(2), _all(1), ("rh_THJ5",), ("rh_THJ2",), ("rh_THJ1",)),
    # The handle's axis is radial, the tool's x axis distal; the handle touches the palm and the bent proximal
    # phalanges.
    grasp=NominalGrasp(
        z=(1.0, 0.0, 0.0), x=(0.0, 0.0, 1.0), p=(0.005, _PALM_SURFACE, _KNUCKLE), p_per_radius=(0.0, -1.0, -1.0)
    ),
    holding_links=3,
    finger_force=25.0,  # a tendon-driven finger's
    grip_width=0.075,
    root_mesh_cell=0.018,
)

MOTORS = (
    *(f"{finger}{joint}" for finger in ("FF", "MF", "RF", "LF") for joint in ("J3", "J0", "J4")),
    *("LFJ5", "THJ5", "THJ4", "THJ3", "THJ2", "THJ1", "WRJ2", "WRJ1"),
)
"""The motors by the maker's names of their joints. "J0" is joints 1 and 2 of a finger together: they have one motor."""
MAKER_SIGNS = np.array([-1.0 if joint[3:] in ("FFJ4", "MFJ4", "THJ2", "THJ1") else 1.0 for joint in SHADOW_HAND.joints])
"""Direction in which the maker counts each joint, in the order of the model's joints, (24,)."""
_OF_MOTOR = np.array([MOTORS.index(f"{j[3:5]}J0" if j[5:] in ("J1", "J2") and j[3:5] not in ("TH", "WR") else j[3:])
                      for j in SHADOW_HAND.joints])  # fmt: skip
_COUPLED = np.array([MOTORS[motor].endswith("J0") for motor in _OF_MOTOR])


def motors_of_joints(q: Array) -> Array:
    """Convert joint positions to the motors'.

    Args:
        q: Positions in the order of the model's joints, (24,) [rad].

    Returns:
        Of the motors in the order of `MOTORS`, as the maker counts them, (20,) [deg]; of two coupled joints the sum.
    """
    motors = np.zeros(len(MOTORS))
    np.add.at(motors, _OF_MOTOR, np.rad2deg(MAKER_SIGNS * q))
    return motors


def joints_of_motors(motors: Array) -> Array:
    """Convert the motors' positions to those of the joints.

    Args:
        motors: Of the motors in the order of `MOTORS`, (20,) [deg].

    Returns:
        Positions in the order of the model's joints, (24,) [rad]; of two coupled joints each has half, which is what
        they do while nothing is in the way of either.
    """
    maker = np.deg2rad(np.asarray(motors, float))[_OF_MOTOR]
    return MAKER_SIGNS * np.where(_COUPLED, 0.5 * maker, maker)


def _motors(posture: str) -> tuple[float, ...]:
    return tuple(float(angle) for angle in motors_of_joints(SHADOW_HAND.posture(posture)))


OPEN, CLOSED = _motors("open"), _motors("closed")
"""Positions of the motors of the open hand, and at which the closing hand aims [deg]; the wrist at rest in both."""

"""How the Shadow Hand holds a handle: postures and the nominal pose of the tool in the hand.

The `hand` frame is the palm link `rh_palm`, after both wrist joints: origin on the wrist's axis, z distal (towards the
fingers), x radial (towards thumb and index), y out of the back of the hand; the palm faces -y.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from toolee_robot.frames import Array, frame_from_axes

FINGERS = ("thumb", "index", "middle", "ring", "little")
_PREFIX = {"rh_th": "thumb", "rh_ff": "index", "rh_mf": "middle", "rh_rf": "ring", "rh_lf": "little"}

PALM_SURFACE = -0.0111  # [m] y of the palm's face in the hand frame
KNUCKLE = 0.085  # [m] z of the proximal phalanges' palmar surface when the fingers are bent by 90 deg

# Deviation of the wrist at rest. Its range is -0.489..0.14 rad and a blow turns it towards +: resting at -0.45 leaves
# 34 deg in which the wrist yields while the arm stops. The forearm then leans away from the nail by as much.
WRIST_REST = {"rh_WRJ2": -0.45, "rh_WRJ1": 0.0}

_THUMB_AWAY = {"rh_THJ5": -1.0, "rh_THJ4": 1.2, "rh_THJ3": 0.0, "rh_THJ2": 0.0, "rh_THJ1": 0.0}
_THUMB_OVER = {"rh_THJ5": 0.75, "rh_THJ4": 1.2, "rh_THJ3": 0.2, "rh_THJ2": -0.3, "rh_THJ1": -0.6}


def finger_of(link: str) -> str:
    """Which of FINGERS, or "palm", a link of the hand belongs to; the forearm and wrist count as "palm"."""
    return _PREFIX.get(link[:5], "palm")


def hand_posture(name: str) -> dict[str, float]:
    """Joint -> position [rad] of a posture; joints not named are at 0.

    "open": palm free, thumb out of the way. "preshape": fingers half bent around a handle that lies in the palm.
    "closed": bent further than any handle allows, so that the fingers press; close to it with limited torque.
    """
    bend = {"open": (0.0, 0.0, 0.0), "preshape": (0.9, 0.6, 0.4), "closed": (1.5, 1.5, 1.2)}[name]
    posture = {f"rh_{f}J{j}": bend[3 - j] for f in ("FF", "MF", "RF", "LF") for j in (3, 2, 1)}
    return {**posture, **(_THUMB_OVER if name == "closed" else _THUMB_AWAY), **WRIST_REST}


def posture_vector(name: str, joints: tuple[str, ...]) -> Array:
    """`hand_posture` as an array in the order of `joints`."""
    posture: Mapping[str, float] = hand_posture(name)
    return np.array([posture.get(joint, 0.0) for joint in joints])


def nominal_X_hand_tool(handle_radius: float) -> Array:
    """4x4: where the handle of radius [m] lies in the closed hand. Tool z is radial (hand x), tool x distal (hand z);
    the handle touches the palm and the bent proximal phalanges."""
    p = [0.005, PALM_SURFACE - handle_radius, KNUCKLE - handle_radius]
    return frame_from_axes(z=np.array([1.0, 0.0, 0.0]), x=np.array([0.0, 0.0, 1.0]), p=p)

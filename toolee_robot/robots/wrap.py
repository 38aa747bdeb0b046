"""Bend the fingers around a handle without a physics engine: for posed hands in synthetic data and for displays."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.robots.description import HAND_JOINTS, hand_link_poses
from toolee_robot.robots.grasp import posture_vector

# (finger, link, radius [m], axis length [m]) of the phalanges' capsules, as in the collision model.
_LONG_FINGERS = ("index", "middle", "ring", "little")
_PREFIX = {"thumb": "TH", "index": "FF", "middle": "MF", "ring": "RF", "little": "LF"}
_PHALANGES = (
    *(
        (finger, f"rh_{_PREFIX[finger].lower()}{part}", radius, length)
        for finger in _LONG_FINGERS
        for part, radius, length in (("proximal", 0.010, 0.045), ("middle", 0.00805, 0.025), ("distal", 0.00705, 0.024))
    ),
    ("thumb", "rh_thproximal", 0.013, 0.038),
    ("thumb", "rh_thmiddle", 0.011, 0.032),
    ("thumb", "rh_thdistal", 0.00918, 0.026),
)


def _clearance(q_hand: Array, X_hand_tool: Array, radius: float, half_length: float) -> dict[str, float]:
    """Smallest distance [m] of each finger's capsules to the handle's (negative: they overlap)."""
    poses = hand_link_poses(q_hand)
    along = np.linspace(0.0, 1.0, 7)
    result: dict[str, float] = {}
    for finger, link, link_radius, length in _PHALANGES:
        X = poses[link]
        points = X[:3, 3] + np.outer(along * length, X[:3, 2]) - X_hand_tool[:3, 3]
        s = np.clip(points @ X_hand_tool[:3, 2], -half_length, half_length)
        distance = np.linalg.norm(points - np.outer(s, X_hand_tool[:3, 2]), axis=1).min() - link_radius - radius
        result[finger] = min(float(distance), result.get(finger, np.inf))
    return result


def wrap_fingers(X_hand_tool: Array, handle_radius: float, half_length: float = 0.06, press: float = 0.0005) -> Array:
    """Joint positions (24,) [rad] of a hand closed around a round handle of radius [m].

    X_hand_tool: 4x4. half_length: how far the handle reaches to each side of the tool's origin [m]. press: depth [m]
    by which a finger may sink in. Joints close in the order of a real grasp: MCP, PIP, DIP, then the thumb.
    """
    q = posture_vector("open", HAND_JOINTS)
    closed = posture_vector("closed", HAND_JOINTS)
    steps: list[tuple[str, tuple[str, ...]]] = [(joint, _LONG_FINGERS) for joint in ("J3", "J2", "J1")]
    steps += [(joint, ("thumb",)) for joint in ("J5", "J2", "J1")]
    for joint, fingers in steps:
        index = {finger: HAND_JOINTS.index(f"rh_{_PREFIX[finger]}{joint}") for finger in fingers}
        low = {finger: q[i] for finger, i in index.items()}
        high = {finger: closed[i] for finger, i in index.items()}
        for k in range(9):
            trial = q.copy()
            for finger, i in index.items():
                trial[i] = high[finger] if k == 0 else 0.5 * (low[finger] + high[finger])
            clearance = _clearance(trial, X_hand_tool, handle_radius, half_length)
            for finger, i in index.items():
                if clearance[finger] > -press:
                    low[finger] = trial[i]
                else:
                    high[finger] = trial[i]
        for finger, i in index.items():
            q[i] = low[finger]
    return q

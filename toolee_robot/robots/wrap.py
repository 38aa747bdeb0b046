"""Bend the fingers around a handle without a physics engine: for posed hands in synthetic data and for displays."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array, inverse
from toolee_robot.robots.description import HAND_FRAME, HAND_JOINTS, hand_tree
from toolee_robot.robots.grasp import posture_vector

_LONG_FINGERS = ("index", "middle", "ring", "little")
_PREFIX = {"thumb": "TH", "index": "FF", "middle": "MF", "ring": "RF", "little": "LF"}
_FINGERS = (*_LONG_FINGERS, "thumb")
_LINKS = tuple(f"rh_{_PREFIX[f].lower()}{part}" for f in _FINGERS for part in ("proximal", "middle", "distal"))
# The phalanges' capsules, as in the collision model.
_RADII = np.array([*[0.010, 0.00805, 0.00705] * 4, 0.013, 0.011, 0.00918])
_LENGTHS = np.array([*[0.045, 0.025, 0.024] * 4, 0.038, 0.032, 0.026])
_ALONG = np.linspace(0.0, 1.0, 7) * _LENGTHS[:, None]


def _clearance(q_hand: Array, X_hand_tool: Array, radius: float, half_length: float) -> dict[str, float]:
    """Smallest distance [m] of each finger's capsules to the handle's (negative: they overlap)."""
    poses = hand_tree().link_poses(q_hand)
    X_tool_links = inverse(poses[HAND_FRAME] @ X_hand_tool) @ np.stack([poses[link] for link in _LINKS])
    points = X_tool_links[:, None, :3, 3] + _ALONG[..., None] * X_tool_links[:, None, :3, 2]
    points[..., 2] -= np.clip(points[..., 2], -half_length, half_length)
    distance = np.sqrt(np.einsum("lpi,lpi->lp", points, points).min(axis=1)) - _RADII - radius
    return dict(zip(_FINGERS, distance.reshape(-1, 3).min(axis=1).tolist(), strict=True))


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

"""Bend the fingers around a handle without a physics engine: for posed hands in synthetic data and for displays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.frames import Array, inverse
from toolee_robot.robots.description import HAND_FRAME, HAND_JOINTS, hand_tree
from toolee_robot.robots.grasp import posture_vector

_PHALANGES = ("proximal", "middle", "distal")


@dataclass(frozen=True, eq=False)
class _Fingers:
    """Fingers that close together: the prefixes of their names; radii and lengths (3,) [m] of the phalanges' capsules,
    as in the collision model; joints: the joints that close, each with the link it turns and its first phalanx."""

    prefixes: tuple[str, ...]
    radii: Array
    lengths: Array
    joints: tuple[tuple[str, str, int], ...]


# In the order of a real grasp: MCP, PIP, DIP, then the thumb.
_GRASP = (
    _Fingers(
        ("FF", "MF", "RF", "LF"),
        np.array([0.010, 0.00805, 0.00705]),
        np.array([0.045, 0.025, 0.024]),
        (("J3", "proximal", 0), ("J2", "middle", 1), ("J1", "distal", 2)),
    ),
    _Fingers(
        ("TH",),
        np.array([0.013, 0.011, 0.00918]),
        np.array([0.038, 0.032, 0.026]),
        (("J5", "base", 0), ("J2", "middle", 1), ("J1", "distal", 2)),
    ),
)
_ALONG = np.linspace(0.0, 1.0, 7)


def wrap_fingers(X_hand_tool: Array, handle_radius: float, half_length: float = 0.06, press: float = 0.0005) -> Array:
    """Joint positions (24,) [rad] of a hand closed around a round handle of radius [m].

    X_hand_tool: 4x4. half_length: how far the handle reaches to each side of the tool's origin [m]. press: depth [m]
    by which a finger may sink in. Joints close one after the other, each as far as the handle lets it.
    """
    q = posture_vector("open", HAND_JOINTS)
    closed = posture_vector("closed", HAND_JOINTS)
    for fingers in _GRASP:
        reach = (fingers.radii + handle_radius - press)[:, None]
        for joint, link, first in fingers.joints:
            index = [HAND_JOINTS.index(f"rh_{prefix}{joint}") for prefix in fingers.prefixes]
            centre, cosine, sine = _circles(q, X_hand_tool, fingers, link, first)
            low, high = q[index], closed[index]
            for k in range(9):
                trial = high if k == 0 else 0.5 * (low + high)
                turn = (trial - q[index])[:, None, None, None]
                points = centre + np.cos(turn) * cosine + np.sin(turn) * sine
                points[..., 2] -= np.clip(points[..., 2], -half_length, half_length)
                free = (np.sqrt(np.einsum("fpni,fpni->fpn", points, points)) > reach).all(axis=(1, 2))
                low, high = np.where(free, trial, low), np.where(free, high, trial)
            q[index] = low
    return q


def _circles(q_hand: Array, X_hand_tool: Array, fingers: _Fingers, link: str, first: int) -> tuple[Array, Array, Array]:
    """Where the points of the capsules' axes go as a joint of each finger turns by `a` from q_hand (24,) [rad]: to
    centre + cos(a) cosine + sin(a) sine, (fingers, 3 phalanges, 7 points, 3) [m] each, in the tool's frame.

    The joint turns `link` and moves the phalanges from `first` on.
    """
    tree = hand_tree()
    poses = tree.link_poses(q_hand)
    X_tool_root = inverse(poses[HAND_FRAME] @ X_hand_tool)
    names = [[f"rh_{prefix.lower()}{phalanx}" for phalanx in _PHALANGES] for prefix in fingers.prefixes]
    Xs = X_tool_root @ np.array([[poses[name] for name in finger] for finger in names])
    along = (fingers.lengths[:, None] * _ALONG)[..., None]
    points = Xs[:, :, None, :3, 3] + along * Xs[:, :, None, :3, 2]
    turned = [f"rh_{prefix.lower()}{link}" for prefix in fingers.prefixes]
    Xs_tool_link = X_tool_root @ np.array([poses[name] for name in turned])
    axes = np.array([tree.by_name[name].axis for name in turned])
    axis = (Xs_tool_link[:, :3, :3] @ axes[..., None])[:, None, None, :, 0]
    arm = points[:, first:] - Xs_tool_link[:, None, None, :3, 3]
    cosine, sine = np.zeros_like(points), np.zeros_like(points)
    cosine[:, first:] = arm - (arm * axis).sum(axis=-1, keepdims=True) * axis
    sine[:, first:] = np.cross(axis, arm)
    return points - cosine, cosine, sine

"""Finger postures around a handle without a physics engine, for synthetic data and displays."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array, inverse
from toolee_robot.robots.hands import Finger, HandModel

_ALONG = np.linspace(0.0, 1.0, 7)


def wrap_fingers(
    hand: HandModel, X_hand_tool: Array, handle_radius: float, half_length: float = 0.06, press: float = 0.0005
) -> Array:
    """Close a hand around a round handle: the joint groups close in turn, each until contact with the handle.

    Args:
        hand: The hand; its `wrapping_order` gives the joint groups.
        X_hand_tool: Pose of the tool in the hand frame, 4x4 [m].
        handle_radius: Radius of the handle [m].
        half_length: Half-length of the handle, centred on the origin of the tool [m].
        press: Permitted penetration of a finger into the handle [m].

    Returns:
        Joint positions (n,) [rad].
    """
    q = hand.posture("open")
    closed = hand.posture("closed")
    for joints in hand.wrapping_order:
        links = [hand.tree.carried_by(joint) for joint in joints]
        fingers = [_finger(hand, link) for link in links]
        radii = np.array([[phalanx.radius for phalanx in finger.phalanges] for finger in fingers])
        reach = (radii + handle_radius - press)[:, :, None]
        index = hand.index(joints)
        centre, cosine, sine = _circles(hand, q, X_hand_tool, fingers, links)
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


def _finger(hand: HandModel, link: str) -> Finger:
    return next(finger for finger in hand.fingers if link in finger.links)


def _circles(
    hand: HandModel, q_hand: Array, X_hand_tool: Array, fingers: list[Finger], links: list[str]
) -> tuple[Array, Array, Array]:
    """Circles of the points on the phalanx axes as one joint of each finger rotates by `a` from q_hand (n,) [rad].

    The point positions are centre + cos(a) cosine + sin(a) sine. The joint of each link in `links` moves the phalanges
    from that link on.

    Returns:
        centre, cosine and sine, each (fingers, phalanges, 7 points, 3) [m], `tool` frame.
    """
    tree = hand.tree
    poses = tree.link_poses(q_hand)
    X_tool_root = inverse(poses[hand.frame] @ X_hand_tool)
    Xs = X_tool_root @ np.array([[poses[phalanx.link] for phalanx in finger.phalanges] for finger in fingers])
    lengths = np.array([[phalanx.length for phalanx in finger.phalanges] for finger in fingers])
    along = (lengths[:, :, None] * _ALONG)[..., None]
    points = Xs[:, :, None, :3, 3] + along * Xs[:, :, None, :3, 2]
    Xs_tool_link = X_tool_root @ np.array([poses[link] for link in links])
    axes = np.array([tree.by_name[link].axis for link in links])
    axis = (Xs_tool_link[:, :3, :3] @ axes[..., None])[:, None, None, :, 0]
    moved = np.array(
        [
            [link in tree.ancestors(phalanx.link) for phalanx in finger.phalanges]
            for finger, link in zip(fingers, links, strict=True)
        ]
    )[:, :, None, None]
    arm = points - Xs_tool_link[:, None, None, :3, 3]
    cosine = np.where(moved, arm - (arm * axis).sum(axis=-1, keepdims=True) * axis, 0.0)
    sine = np.where(moved, np.cross(axis, arm), 0.0)
    return points - cosine, cosine, sine

"""Render bodies of tools, hands and arms. Meshes are cached per process."""

from __future__ import annotations

import atexit
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from toolee_robot.frames import Array, frame_from_axes
from toolee_robot.perception.offline.dataset.records import SHOWN_HAND
from toolee_robot.render import Body, Material, Mesh, Pattern
from toolee_robot.render.material import (
    LookPart,
    any_color,
    any_glove_color,
    any_skin_tone,
    arm_link_parts,
    finish,
    linear,
    skin_tone,
)
from toolee_robot.robots import arm_link_poses, arm_meshes, wrap_fingers
from toolee_robot.robots.description import robot_tree
from toolee_robot.tools import ToolShape, make_tool

_MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


@lru_cache(maxsize=128)
def tool_meshes(tool: ToolShape) -> tuple[Mesh, ...]:
    """Render mesh of each part of a tool that has a share of the outer surface, `tool` frame [m]."""
    faces = np.asarray(tool.mesh.faces)
    return tuple(
        Mesh.build(tool.mesh.vertices, faces[tool.face_parts == part])
        for part in range(len(tool.parts))
        if np.any(tool.face_parts == part)
    )


atexit.register(tool_meshes.cache_clear)  # release before manifold3d is unloaded, as in `tools.catalog`


def forget_tools() -> None:
    """Clear the caches of tools; another block of examples uses other tools."""
    tool_meshes.cache_clear()
    make_tool.cache_clear()


def tool_bodies(
    tool: ToolShape, X_world_tool: Array, body_id: int, rng: np.random.Generator, repaint: bool | None = None
) -> list[Body]:
    """Render bodies of a tool, one for each part.

    Args:
        tool: The tool.
        X_world_tool: Pose of the tool in the world frame, 4x4 [m].
        body_id: Body id of all parts.
        rng: Random generator.
        repaint: Whether to replace its colours by random ones; None: with probability 0.5.

    Returns:
        The bodies, one for each part.
    """
    if repaint is None:
        repaint = bool(rng.random() < 0.5)
    bodies = []
    present = [part for part in range(len(tool.parts)) if np.any(tool.face_parts == part)]
    finishes: dict[str, Material] = {}
    for part, mesh in zip(present, tool_meshes(tool), strict=True):
        m = tool.parts[part].material
        material = finishes.get(m.name)
        if material is None:
            color, roughness = m.color, m.roughness
            if repaint:
                steel = m.metallic > 0.5
                color = _steel_color(rng) if steel else any_color(rng)
                roughness = float(np.clip(rng.uniform(0.15, 0.7) if steel else rng.uniform(0.25, 0.9), 0.0, 1.0))
            material = finish(m.name, color, roughness, m.metallic, rng)
            finishes[m.name] = material
        bodies.append(Body(mesh, X_world_tool, material, body_id))
    return bodies


def _steel_color(rng: np.random.Generator) -> tuple[float, float, float]:
    value = rng.uniform(0.2, 0.85)
    c = np.clip(value * np.exp(rng.normal(0.0, 0.04, 3)), 0.0, 1.0)
    return float(c[0]), float(c[1]), float(c[2])


@dataclass(frozen=True, eq=False)
class Grasp:
    """Grasp of a handle by a right hand.

    Attributes:
        X_hand_tool: Pose of the tool in the hand frame, 4x4 [m].
        q_hand: Joint positions of the hand (n,) [rad].
        radius: Radius of the handle [m] for which the grasp was computed.
    """

    X_hand_tool: Array
    q_hand: Array
    radius: float


def random_grasp(radius: float, rng: np.random.Generator) -> Grasp:
    """Draw a grasp of a handle: shifted, rotated and tilted in the hand; rarely open or half open.

    Args:
        radius: Radius of the handle [m].
        rng: Random generator.

    Returns:
        The grasp.
    """
    p = rng.normal(0.0, [0.006, 0.002, 0.006])
    p[0] += rng.uniform(-0.03, 0.03)
    spin = rng.normal(0.0, 0.25)
    kind = rng.random()
    if kind < 0.25:
        spin = rng.uniform(-np.pi, np.pi)
    elif kind < 0.35:
        spin += np.pi
    tilt = rng.normal(0.0, 0.12, 2)
    axis = np.array([1.0, tilt[0], tilt[1]])
    X = SHOWN_HAND.grasp.X_hand_tool(radius)
    reference = np.array([0.0, -np.sin(spin), np.cos(spin)])
    X = frame_from_axes(z=axis * (1.0 if rng.random() < 0.9 else -1.0), x=reference, p=X[:3, 3] + p)
    q = _closed(wrap_fingers(SHOWN_HAND, X, radius))
    if rng.random() < 0.08:
        # Open or half-open hand with the tool in it, as during a handover.
        q = SHOWN_HAND.posture("open" if rng.random() < 0.5 else "preshape")
    q[len(SHOWN_HAND.wrist) :] += rng.normal(0.0, 0.04, len(SHOWN_HAND.finger_joints))
    q[SHOWN_HAND.wrist_index] = rng.uniform(*np.transpose([joint.shown for joint in SHOWN_HAND.wrist]))
    return Grasp(X, q, radius)


def _closed(q_hand: Array) -> Array:
    """Close fingers that initially penetrate an oblique handle, and therefore stayed open, as far as the others."""
    q = q_hand.copy()
    together = [joints for joints in SHOWN_HAND.wrapping_order if len(joints) == len(SHOWN_HAND.fingers) - 1]
    rows = np.array([SHOWN_HAND.index(joints) for joints in together]).T
    blocked = q[rows[:, 0]] < 0.3
    if blocked.any() and not blocked.all():
        q[rows[blocked]] = np.median(q[rows[~blocked]], axis=0)
    return q


@dataclass(frozen=True, eq=False)
class HandStyle:
    """Appearance of a hand.

    Attributes:
        mirrored: Whether it is a left hand.
        palm: Material of palm and fingers.
        tips: Material of the finger tips.
        sleeve: Material of wrist and forearm.
    """

    mirrored: bool
    palm: Material
    tips: Material
    sleeve: Material

    @staticmethod
    def random(rng: np.random.Generator) -> HandStyle:
        """A random robot hand (black, grey, metal or coloured), human hand with sleeve, or glove."""
        kind = rng.random()
        if kind < 0.4:  # Shadow Hand: dark shells, grey or light finger pads
            palm = finish("plastic", (0.10, 0.10, 0.11), float(rng.uniform(0.3, 0.6)), 0.0, rng)
            tips = finish("rubber", tuple_of(rng.uniform(0.1, 0.8)), 0.7, 0.0, rng)
            sleeve = finish("aluminium", tuple_of(rng.uniform(0.05, 0.7)), 0.4, float(rng.random() < 0.5), rng)
        elif kind < 0.7:
            palm = finish("skin", skin_tone(rng), float(rng.uniform(0.4, 0.7)), 0.0, rng)
            tips = palm
            bare = rng.random() < 0.4
            sleeve = palm if bare else finish("rubber", any_color(rng), 0.9, 0.0, rng)
        else:
            palm = finish("rubber", any_color(rng), float(rng.uniform(0.3, 0.9)), float(rng.random() < 0.25), rng)
            tips = palm if rng.random() < 0.5 else finish("rubber", any_color(rng), 0.7, 0.0, rng)
            sleeve = finish("rubber", any_color(rng), 0.8, 0.0, rng)
        return HandStyle(rng.random() < 0.4, palm, tips, sleeve)

    @staticmethod
    def varied(rng: np.random.Generator) -> HandStyle:
        """A random hand: half of them as `random`, the others people's, of all skin tones and in working gloves."""
        if rng.random() < 0.5:
            return HandStyle.random(rng)
        skin = finish("skin", any_skin_tone(rng), float(rng.uniform(0.4, 0.7)), 0.0, rng)
        cuff = skin if rng.random() < 0.45 else _cloth(rng)
        kind = rng.random()
        if kind < 0.55:
            palm = tips = skin
        elif kind < 0.8:  # thin gloves: nitrile, latex
            palm = finish("plastic", any_glove_color(rng), float(rng.uniform(0.25, 0.6)), 0.0, rng)
            tips = palm
        else:  # knitted or leather gloves, half of them with dipped finger tips
            palm = _cloth(rng)
            tips = palm if rng.random() < 0.5 else finish("rubber", any_glove_color(rng), 0.7, 0.0, rng)
        return HandStyle(rng.random() < 0.4, palm, tips, cuff)


def _cloth(rng: np.random.Generator) -> Material:
    """Cloth of one colour, striped, checked or mottled."""
    cloth = finish("rubber", any_color(rng), float(rng.uniform(0.75, 0.95)), 0.0, rng)
    if rng.random() < 0.5:
        return cloth
    pattern = (Pattern.STRIPES, Pattern.CHECKER, Pattern.SPECKLE)[int(rng.integers(3))]
    second = linear(any_color(rng))
    return replace(cloth, color2=second, pattern=pattern, scale=float(rng.uniform(0.002, 0.02)))


def tuple_of(grey: float) -> tuple[float, float, float]:
    """Grey of an sRGB value in [0, 1] as a colour."""
    return (float(grey), float(grey), float(grey))


@lru_cache(maxsize=2)
def _hand_render_meshes(mirrored: bool) -> dict[str, Mesh]:
    right = {name: Mesh.build(m.vertices, m.faces, crease_deg=50.0) for name, m in SHOWN_HAND.meshes.items()}
    return {name: mesh.mirrored() for name, mesh in right.items()} if mirrored else right


def hand_bodies(grasp: Grasp, style: HandStyle, X_world_hand: Array, body_id: int, forearm: bool = True) -> list[Body]:
    """Render bodies of a hand.

    Args:
        grasp: Grasp, which gives the joint positions.
        style: Appearance.
        X_world_hand: Pose of the hand frame in the world frame, 4x4 [m]; that of the left hand if mirrored.
        body_id: Body id of all links.
        forearm: Whether to include the forearm.

    Returns:
        The bodies, one for each link.
    """
    bodies = []
    meshes = _hand_render_meshes(style.mirrored)
    for name, X in SHOWN_HAND.link_poses(grasp.q_hand).items():
        if name not in meshes or (name == SHOWN_HAND.forearm[0] and not forearm):
            continue
        X_hand_link = _MIRROR @ X @ _MIRROR if style.mirrored else X
        material = style.palm
        if name in SHOWN_HAND.tips:
            material = style.tips
        elif name in SHOWN_HAND.forearm:
            material = style.sleeve
        bodies.append(Body(meshes[name], X_world_hand @ X_hand_link, material, body_id))
    return bodies


def X_hand_tool_of(grasp: Grasp, mirrored: bool) -> Array:
    """Pose of the tool in the hand; a left hand holds the mirrored axis of the handle.

    Args:
        grasp: Grasp of a right hand.
        mirrored: Whether the hand is a left hand.

    Returns:
        Pose of the tool in the hand frame, (4, 4).
    """
    if not mirrored:
        return grasp.X_hand_tool
    # Mirroring in hand x and in tool y gives a proper rotation that keeps z and x of the tool on the handle.
    X = _MIRROR @ grasp.X_hand_tool @ np.diag([1.0, -1.0, 1.0, 1.0])
    return np.asarray(X)


def X_base_hand_of(q_arm: Array, q_hand: Array) -> Array:
    """Pose of the hand on the arm.

    Args:
        q_arm: Joint positions of the arm, (6,) [rad].
        q_hand: Joint positions of the hand, (n,) [rad].

    Returns:
        Pose of the hand frame in `base_link`, (4, 4).
    """
    return robot_tree().link_poses(np.concatenate([q_arm, q_hand]))[SHOWN_HAND.frame]


@lru_cache(maxsize=1)
def _arm_parts() -> dict[str, tuple[LookPart, ...]]:
    return {name: arm_link_parts(name, m.vertices, m.faces) for name, m in arm_meshes().items()}


def arm_bodies(q_arm: Array, X_world_base: Array, body_id: int, rng: np.random.Generator) -> list[Body]:
    """Render bodies of the UR10 in varied original colours or, with probability 0.2, in random ones.

    Args:
        q_arm: Joint positions (6,) [rad].
        X_world_base: Pose of `base_link` in the world frame, 4x4 [m].
        body_id: Body id of all links.
        rng: Random generator.

    Returns:
        The bodies of all links.
    """
    own = rng.random() < 0.8
    bodies = []
    paint = any_color(rng)
    bare = rng.random() < 0.3
    poses = arm_link_poses(q_arm)
    for link, parts in _arm_parts().items():
        for part in parts:
            color = part.color if own or part.finish != "painted_metal" else paint
            name = "aluminium" if bare and part.finish == "painted_metal" else part.finish
            material = finish(name, color, part.roughness, part.metallic, rng)
            bodies.append(Body(part.mesh, X_world_base @ poses[link], replace(material, wear=0.1), body_id))
    return bodies

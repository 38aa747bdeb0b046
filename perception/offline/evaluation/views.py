"""Rendered views beyond the data set: a held hammer in five poses of the hand, and clutter without any tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.end_effectors import Category
from toolee_robot.errors import PerceptionError
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.perception.offline.dataset.catalogue import Catalogue
from toolee_robot.perception.offline.dataset.records import SHOWN_HAND, EeTable
from toolee_robot.perception.offline.evaluation import metrics
from toolee_robot.perception.offline.synthesis.example import Series, expose, render_example
from toolee_robot.perception.offline.synthesis.hard import ARM, HAND, hard_scene
from toolee_robot.perception.offline.synthesis.labels import label
from toolee_robot.perception.offline.synthesis.placement import PlacedTool, Pool, SceneSample
from toolee_robot.perception.pipeline import ToolPerception
from toolee_robot.render.renderer import Shot
from toolee_robot.types import HoldingHand, RgbdFrame

VIEWS = 5
_TURN, _SHIFT = np.deg2rad(60.0), 0.05
_TRIES = 60


@dataclass(frozen=True, eq=False)
class HeldHammer:
    """Frames of a hammer that does not move in the hand.

    Attributes:
        frames: The frames.
        Xs_camera_hand: Pose of the hand in each frame, 4x4.
        Xs_hand_ee: True poses of the striking faces in the hand, 4x4 (a club hammer has two).
    """

    frames: list[RgbdFrame]
    Xs_camera_hand: list[Array]
    Xs_hand_ee: list[Array]


def held_hammer(seed: int, index: int, catalogue: Catalogue, split: str = "test") -> HeldHammer | None:
    """Render a hammer in a right hand among the clutter of the hard scenes.

    The hand is turned by up to 60 deg and moved by up to 5 cm between the frames; a face is a target
    (`EeTable.targets`) in each.

    Args:
        seed: Seed of the scenes.
        index: Number of the scene.
        catalogue: Tools of the scenes.
        split: Split of the tools.

    Returns:
        The frames; None if that scene holds no such hammer.
    """
    taken = render_example(Series(seed, split, catalogue=catalogue), index)
    hammer = _held_hammer(taken.sample, taken.labels[3])
    if hammer is None:
        return None
    frames, Xs = [taken_frame(taken.sample, taken.shot, taken.rng)], [_X_camera_hand(taken.sample, hammer)]
    for _ in range(_TRIES):
        if len(frames) == VIEWS:
            break
        sample = _moved(taken.sample, hammer, taken.rng)
        shot = Shot(sample.scene, sample.intrinsics, sample.X_world_camera)
        moved = _held_hammer(sample, label(sample, shot)[3])
        if moved is not None:
            frames.append(taken_frame(sample, shot, taken.rng))
            Xs.append(_X_camera_hand(sample, moved))
    if len(frames) < VIEWS or hammer.X_world_hand is None:
        return None
    faces = [ee.X_tool_ee for ee in hammer.tool.ees if ee.category is Category.HAMMER_HEAD]
    X_hand_tool = inverse(hammer.X_world_hand) @ hammer.X_world_tool
    return HeldHammer(frames, Xs, [X_hand_tool @ X for X in faces])


def empty_frame(seed: int, index: int, catalogue: Catalogue, split: str = "test") -> RgbdFrame:
    """Render a cluttered frame of the hard scenes without a tool, in many of them an empty hand.

    Args:
        seed: Seed of the scenes.
        index: Number of the frame.
        catalogue: Tools of the other scenes; they are drawn, and so decide what else is.
        split: Split of the textures and backgrounds.

    Returns:
        The frame.
    """
    rng = np.random.default_rng([seed, index, 3])
    sample = hard_scene(rng, Pool.random(rng, split, catalogue), with_tools=False)
    return taken_frame(sample, Shot(sample.scene, sample.intrinsics, sample.X_world_camera), rng)


def taken_frame(sample: SceneSample, shot: Shot, rng: np.random.Generator) -> RgbdFrame:
    """Take a frame with the noise of a random camera and depth sensor.

    Args:
        sample: The scene.
        shot: Its rendering.
        rng: Random numbers.

    Returns:
        The frame.
    """
    exposure, automatic = float(rng.uniform(0.75, 1.35)), float(rng.uniform(0.3, 1.0))
    depth, rgb = expose(shot, sample.intrinsics, exposure, automatic, rng)
    return RgbdFrame(rgb, depth, sample.intrinsics)


@dataclass(frozen=True)
class Fused:
    """Errors of the pose in the hand: angle [rad] modulo the group and position [m], infinite without a pose.

    Attributes:
        one_frame: From the first frame.
        five_frames: From all frames, fused.
        usable: Whether the fused pose is usable.
    """

    one_frame: tuple[float, float]
    five_frames: tuple[float, float]
    usable: bool


def fuse(perception: ToolPerception, hammer: HeldHammer) -> Fused:
    """Estimate the poses in all frames of a hammer and fuse them, as a job would.

    Args:
        perception: The pipeline.
        hammer: The frames with the truth.

    Returns:
        The errors.
    """
    looks = [
        perception.estimate(frame, HoldingHand(X, SHOWN_HAND.grasp.R_hand_tool), [Category.HAMMER_HEAD])
        for frame, X in zip(hammer.frames, hammer.Xs_camera_hand, strict=True)
    ]
    errors, usable = [], False
    for n in (1, VIEWS):
        try:
            estimate = perception.fuse(looks[:n], hammer.Xs_camera_hand[:n], Category.HAMMER_HEAD)
        except PerceptionError:
            errors.append((np.inf, np.inf))
            continue
        usable = n == VIEWS and estimate.usable
        errors.append(_nearest_error(estimate.X_hand_ee, hammer.Xs_hand_ee))
    return Fused(errors[0], errors[1], usable)


def fused(each: Sequence[Fused]) -> dict[str, Any]:
    """Accuracy of the fused pose in the hand, and of the first frame's, over all hammers."""
    count = len(each)
    result: dict[str, Any] = {"hammers": count, "usable_share": sum(f.usable for f in each) / count if count else None}
    for name in ("one_frame", "five_frames"):
        angle, position = np.array([getattr(f, name) for f in each]).reshape(-1, 2).T
        made = np.isfinite(position)
        result[name] = {
            **metrics.shares(angle, position),
            "median_mm": metrics.quantiles(1e3 * position[made])["median"],
            "median_deg": metrics.quantiles(np.rad2deg(angle[made]))["median"],
        }
    return result


def claims(perception: ToolPerception, frame: RgbdFrame) -> tuple[bool, bool]:
    """Run the pipeline on a frame without a tool.

    Args:
        perception: The pipeline.
        frame: The frame.

    Returns:
        Whether there is a detection, and whether there is a usable pose.
    """
    estimates = perception.estimate(frame)
    return bool(estimates), any(e.usable for e in estimates)


def no_tool(each: Sequence[tuple[bool, bool]]) -> dict[str, Any]:
    """How often frames without a tool gave a detection, and how often a usable pose."""
    count, usable = len(each), sum(u for _, u in each)
    quiet = 1 - usable / count if count else None
    detected = sum(d for d, _ in each)
    return {"frames": count, "with_a_detection": detected, "with_a_usable_pose": usable, "share_without": quiet}


def _held_hammer(sample: SceneSample, table: EeTable) -> PlacedTool | None:
    """The one tool in a right hand, if it is a hammer with a face in view and there is no other hand."""
    held = [t for t in sample.tools if t.X_world_hand is not None]
    if len(held) != 1 or held[0].mirrored:
        return None
    row = 0
    for tool in sample.tools:
        for ee in tool.tool.ees:
            if row >= len(table.targets):
                return None
            if tool is held[0] and ee.category is Category.HAMMER_HEAD and table.targets[row]:
                return tool
            row += 1
    return None


def _moved(sample: SceneSample, hammer: PlacedTool, rng: np.random.Generator) -> SceneSample:
    """The scene with hand, arm and hammer rotated about the hammer's face and shifted."""
    pivot = (hammer.X_world_tool @ hammer.tool.ee(Category.HAMMER_HEAD).X_tool_ee)[:3, 3]
    axis = rng.normal(size=3)
    R = Rotation.from_rotvec(axis / np.linalg.norm(axis) * rng.uniform(0.2, 1.0) * _TURN)
    T = transform(R, pivot + rng.uniform(-_SHIFT, _SHIFT, 3)) @ transform(p=-pivot)
    moving = {hammer.body_id, HAND, ARM}
    bodies = [
        replace(body, X_world_body=T @ body.X_world_body) if body.body_id in moving else body
        for body in sample.scene.bodies
    ]
    assert hammer.X_world_hand is not None
    turned = replace(hammer, X_world_tool=T @ hammer.X_world_tool, X_world_hand=T @ hammer.X_world_hand)
    tools = tuple(turned if tool is hammer else tool for tool in sample.tools)
    return replace(sample, scene=replace(sample.scene, bodies=bodies), tools=tools)


def _X_camera_hand(sample: SceneSample, hammer: PlacedTool) -> Array:
    assert hammer.X_world_hand is not None
    return inverse(sample.X_world_camera) @ hammer.X_world_hand


def _nearest_error(X: Array, candidates: list[Array]) -> tuple[float, float]:
    """Angle [rad] modulo the group and distance [m] to the nearest of the true poses."""
    group = Category.HAMMER_HEAD.symmetry
    X_true = min(candidates, key=lambda C: float(np.linalg.norm(C[:3, 3] - X[:3, 3])))
    distance = float(np.linalg.norm(X[:3, 3] - X_true[:3, 3]))
    return group.rotation_error(X[:3, :3], X_true[:3, :3]), distance

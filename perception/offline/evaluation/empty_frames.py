"""Cluttered frames without any tool: how often the perception claims one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from toolee_robot.perception.offline.dataset.catalogue import Catalogue
from toolee_robot.perception.offline.synthesis.example import expose
from toolee_robot.perception.offline.synthesis.hard import hard_scene
from toolee_robot.perception.offline.synthesis.placement import Pool
from toolee_robot.perception.pipeline import ToolPerception
from toolee_robot.render.renderer import Shot
from toolee_robot.types import RgbdFrame


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
    shot = Shot(sample.scene, sample.intrinsics, sample.X_world_camera)
    exposure, automatic = float(rng.uniform(0.75, 1.35)), float(rng.uniform(0.3, 1.0))
    depth, rgb = expose(shot, sample.intrinsics, exposure, automatic, rng)
    return RgbdFrame(rgb, depth, sample.intrinsics)


def claims(perception: ToolPerception, frame: RgbdFrame) -> tuple[bool, bool]:
    """Whether the perception detects something in a frame without a tool, and whether it gives a usable pose."""
    estimates = perception.estimate(frame)
    return bool(estimates), any(e.usable for e in estimates)


def no_tool(each: Sequence[tuple[bool, bool]]) -> dict[str, Any]:
    """How often frames without a tool gave a detection, and how often a usable pose."""
    count, usable = len(each), sum(u for _, u in each)
    quiet = 1 - usable / count if count else None
    detected = sum(d for d, _ in each)
    return {"frames": count, "with_a_detection": detected, "with_a_usable_pose": usable, "share_without": quiet}

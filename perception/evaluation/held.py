"""Perception of held tools with the hand's pose, as in a job: accuracy and time, by where the detector looks.

Every frame of a data set whose tool a right hand holds is perceived in several ways, one after the other, so that their
figures are paired. Only the end effectors of that tool count.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, transform
from toolee_robot.perception.dataset.records import SHOWN_HAND
from toolee_robot.perception.dataset.scene_reader import load_scenes
from toolee_robot.perception.detection.hand_crop import hand_crop
from toolee_robot.perception.evaluation import metrics
from toolee_robot.perception.evaluation.estimates import Ranked
from toolee_robot.perception.evaluation.examples import instances_of, parts
from toolee_robot.perception.evaluation.pose import right_poses
from toolee_robot.perception.evaluation.records import Instance
from toolee_robot.perception.pipeline import StageTimes
from toolee_robot.perception.pose.confidence import RIGHT
from toolee_robot.types import HeldRegion, HoldingHand, RgbdFrame, ToolEstimate

DISPLACEMENT = 0.10
"""Largest distance of an end effector from its nominal place in the hand [m]; a job refuses more (`tasks.common.look`).
"""
SPIN, TILT = np.deg2rad(25.0), np.deg2rad(12.0)
"""Ranges of the tool's rotation about its handle and across it against the nominal grasp, as tools are handed over in
the simulated job; the data set itself shifts the hand along the handle by -3 to 4 cm."""
FOUND = metrics.THRESHOLDS["5deg2cm"]
"""Limits of a pose that counts as found, usable or not."""

Way = Callable[[RgbdFrame, HoldingHand], tuple[list[ToolEstimate], StageTimes]]
"""A way to perceive a frame: `ToolPerception.estimate_timed`."""


@dataclass(frozen=True, eq=False)
class HeldTool:
    """A frame with a tool in a right hand.

    Attributes:
        frame: The frame.
        hand: The hand, with the region in which the tool is looked for.
        instances: All end effectors in the frame; only those of the held tool are targets.
    """

    frame: RgbdFrame
    hand: HoldingHand
    instances: list[Instance]


@dataclass(frozen=True)
class Seen:
    """What one way made of one frame.

    Attributes:
        targets: Number of end effectors asked for.
        found: How many have a pose within 5 deg and 2 cm, usable or not.
        usable_right: How many have a usable pose within 10 deg and 2 cm.
        wrong: Usable poses, where the held tool can be, that are right for no end effector.
        ms: Wall-clock time [ms].
        whole_image: Whether the whole image was looked at.
    """

    targets: int
    found: int
    usable_right: int
    wrong: int
    ms: float
    whole_image: bool


def held_tools(folder: Path, limit: int | None = None, pose_error: float = 0.0, seed: int = 0) -> Iterator[HeldTool]:
    """The frames of a data set that show a tool in a right hand with an end effector to be found.

    Args:
        folder: Folder of a data set or of one split.
        limit: Largest number of frames; None: all.
        pose_error: Bound of the error of X_camera_hand [m], by which the region is wider; the poses given are exact.
        seed: Seed of the tool's rotation in the hand, see `SPIN`.

    Yields:
        The frames.

    Raises:
        AssetError: A file is missing or damaged.
    """
    rng, count = np.random.default_rng(seed), 0
    for part in parts(folder):
        data = load_scenes([part.scene], threads=2)
        for i in range(len(data)):
            frame = RgbdFrame(data.rgb[i], data.depth_mm[i].astype(np.float32) * np.float32(1e-3), data.camera(i))
            every = [e for _, e in instances_of(0, data.row(i), frame.intrinsics, part.catalogue)]
            asked = [e for e in every if e.target and e.X_camera_hand is not None]
            if not asked or len({np.asarray(e.X_camera_hand).tobytes() for e in asked}) > 1:
                continue
            first = asked[0]
            assert first.X_camera_hand is not None
            region = _region(first, pose_error, rng)
            hand = HoldingHand(first.X_camera_hand, SHOWN_HAND.grasp.R_hand_tool, region)
            yield HeldTool(frame, hand, [e if e.X_camera_hand is not None else replace(e, target=False) for e in every])
            count += 1
            if count == limit:
                return


def _region(instance: Instance, pose_error: float, rng: np.random.Generator) -> HeldRegion:
    """Where a held tool can be, by its nominal grasp and a random rotation of the tool in it."""
    tool = instance.catalogue.tool(instance.tool)
    R = Rotation.from_euler("zxy", rng.uniform(-1.0, 1.0, 3) * (SPIN, TILT, TILT))
    X_hand_tool = SHOWN_HAND.grasp.X_hand_tool(tool.handle.grip_radius) @ transform(R)
    ends = [(X_hand_tool @ ee.X_tool_ee)[:3, 3] for ee in tool.ees]
    reach = max(ee.category.spec.radius for ee in tool.ees)
    return HeldRegion(np.array([*ends, np.zeros(3)]), reach + DISPLACEMENT + pose_error)


def judge(held: HeldTool, estimates: list[ToolEstimate], times: StageTimes, ms: float) -> Seen:
    """Compare the estimates of one frame with the truth.

    Args:
        held: The frame.
        estimates: The estimates.
        times: Time of the stages.
        ms: Time in all [ms].

    Returns:
        What was found.
    """
    poses = [
        Ranked(0, e.category, e.trust, e.X_camera_ee, e.usable) for e in estimates if np.isfinite(e.X_camera_ee).all()
    ]
    usable = [p for p in poses if p.usable]
    right, counted = right_poses(held.instances, usable)
    near = np.array([_in_region(held, p.X_camera_ee[:3, 3]) for p in usable], dtype=bool)
    targets = [i for i in held.instances if i.target]
    return Seen(
        len(targets),
        sum(any(_within(p, i, FOUND) for p in poses) for i in targets),
        sum(any(_within(p, i, RIGHT) for p in usable) for i in targets),
        int(np.count_nonzero(counted & ~right & near)),
        ms,
        times.whole_image,
    )


def perceive(held: HeldTool, way: Way) -> Seen:
    """Perceive a frame in one way, and judge the result."""
    start = time.perf_counter()
    estimates, times = way(held.frame, held.hand)
    return judge(held, estimates, times, 1e3 * (time.perf_counter() - start))


def compare(rows: dict[str, list[Seen]], reference: str) -> dict[str, dict[str, Any]]:
    """Figures of each way, and their differences to one of them over the same frames.

    Args:
        rows: Name of a way to what it made of each frame; the same frames in the same order.
        reference: Name of the way that the others are compared with.

    Returns:
        Name of a way to its shares, its times, and each share's difference with the half width of its 95 % confidence
        interval (frames are independent, the end effectors of one frame are not).
    """
    table: dict[str, dict[str, Any]] = {}
    base = rows[reference]
    for name, seen in rows.items():
        targets = sum(s.targets for s in seen)
        ms = [s.ms for s in seen]
        row: dict[str, Any] = {"frames": len(seen), "end_effectors": targets}
        for key in ("found", "usable_right", "wrong"):
            row[key] = sum(getattr(s, key) for s in seen) / targets
            change = np.array([getattr(s, key) - getattr(b, key) for s, b in zip(seen, base, strict=True)], float)
            row[f"{key}_difference"] = float(change.sum() / targets)
            row[f"{key}_interval"] = float(1.96 * np.sqrt(len(change)) * change.std() / targets)
        row["whole_image"] = float(np.mean([s.whole_image for s in seen]))
        table[name] = {**row, "median_ms": float(np.median(ms)), "p90_ms": float(np.percentile(ms, 90))}
    return table


def _within(pose: Ranked, instance: Instance, limits: tuple[float, float]) -> bool:
    if pose.category is not instance.category:
        return False
    X, X_true = pose.X_camera_ee, instance.X_camera_ee
    angle = instance.category.symmetry.rotation_error(X[:3, :3], X_true[:3, :3])
    distance = np.linalg.norm(X[:3, 3] - X_true[:3, 3])
    return bool(metrics.within(np.asarray(angle), np.asarray(distance), *limits))


def _in_region(held: HeldTool, p: Array) -> bool:
    """Whether a point (3,) [m], camera frame, is in front of the part of the image that shows the region."""
    assert held.hand.region is not None
    K = held.frame.intrinsics
    crop = hand_crop(held.hand.X_camera_hand, held.hand.region, K)
    if crop is None:
        return False
    u, v = K.fx * p[0] / p[2] + K.cx, K.fy * p[1] / p[2] + K.cy
    return bool(crop.x0 <= u < crop.x1 and crop.y0 <= v < crop.y1)

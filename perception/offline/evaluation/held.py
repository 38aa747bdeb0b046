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

from toolee_robot.frames import Array, inverse, transform
from toolee_robot.perception.detection.hand_crop import hand_crop
from toolee_robot.perception.detection.instances import Instances, associate
from toolee_robot.perception.detection.segmenter import Segmenter, Stages
from toolee_robot.perception.offline.dataset.records import SCENES, SHOWN_HAND
from toolee_robot.perception.offline.dataset.scene_reader import load_scenes
from toolee_robot.perception.offline.evaluation import metrics
from toolee_robot.perception.offline.evaluation.estimates import Ranked
from toolee_robot.perception.offline.evaluation.examples import instances_of, parts
from toolee_robot.perception.offline.evaluation.pose import right_poses
from toolee_robot.perception.offline.evaluation.records import Instance
from toolee_robot.perception.pipeline import StageTimes, ToolPerception
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
WHOLE, ABOUT_HAND = "whole image", "about the hand"
"""Names of the two ways that are always compared."""

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
        errors: Position error [mm] and rotation error [deg] of each pose that was found.
        ms: Wall-clock time [ms].
        cpu_ms: Time on the processor, over all threads [ms]; on a busy machine it is less disturbed.
        whole_image: Whether the whole image was looked at.
    """

    targets: int
    found: int
    usable_right: int
    wrong: int
    errors: tuple[tuple[float, float], ...]
    ms: float
    cpu_ms: float
    whole_image: bool


def held_tools(
    folder: Path, role: str | None = None, limit: int | None = None, pose_error: float = 0.0, seed: int = 0
) -> Iterator[HeldTool]:
    """The frames of a data set that show a tool in a right hand with an end effector to be found.

    Tools that are held the other way round, the working end on the little finger's side, are left out: a job asks for
    them otherwise, and does not look for them there.

    Args:
        folder: Folder of a data set or of one split.
        role: Use of the tools, "train", "validation" or "test"; None: any.
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
            scene = SCENES[data.scene[i]]
            every = [e for _, e in instances_of(0, data.row(i), frame.intrinsics, part.catalogue, scene)]
            asked = [e for e in every if e.target and e.X_camera_hand is not None]
            asked = [e for e in asked if (role is None or e.role == role) and _as_asked_for(e)]
            if not asked or len({np.asarray(e.X_camera_hand).tobytes() for e in asked}) > 1:
                continue
            first = asked[0]
            assert first.X_camera_hand is not None
            region = _region(first, pose_error, rng)
            hand = HoldingHand(first.X_camera_hand, SHOWN_HAND.grasp.R_hand_tool, region)
            yield HeldTool(frame, hand, [e if e in asked else replace(e, target=False) for e in every])
            count += 1
            if count == limit:
                return


def _as_asked_for(instance: Instance) -> bool:
    """Whether the handle of a held tool points the way in which a job asks for it."""
    assert instance.X_camera_hand is not None
    X_tool_ee = instance.catalogue.tool(instance.tool).ees[instance.ee].X_tool_ee
    X_hand_tool = inverse(instance.X_camera_hand) @ instance.X_camera_ee @ inverse(X_tool_ee)
    return bool(X_hand_tool[:3, 2] @ SHOWN_HAND.grasp.R_hand_tool[:3, 2] > 0.0)


def _region(instance: Instance, pose_error: float, rng: np.random.Generator) -> HeldRegion:
    """Where a held tool can be, by its nominal grasp and a random rotation of the tool in it."""
    tool = instance.catalogue.tool(instance.tool)
    R = Rotation.from_euler("zxy", rng.uniform(-1.0, 1.0, 3) * (SPIN, TILT, TILT))
    X_hand_tool = SHOWN_HAND.grasp.X_hand_tool(tool.handle.grip_radius) @ transform(R)
    ends = [(X_hand_tool @ ee.X_tool_ee)[:3, 3] for ee in tool.ees]
    reach = max(ee.category.spec.radius for ee in tool.ees)
    return HeldRegion(np.array([*ends, np.zeros(3)]), reach + DISPLACEMENT + pose_error)


def judge(held: HeldTool, estimates: list[ToolEstimate], times: StageTimes, ms: float, cpu_ms: float) -> Seen:
    """Compare the estimates of one frame with the truth.

    Args:
        held: The frame.
        estimates: The estimates.
        times: Time of the stages.
        ms: Wall-clock time in all [ms].
        cpu_ms: Time on the processor [ms].

    Returns:
        What was found.
    """
    poses = [
        Ranked(0, e.category, e.trust, e.X_camera_ee, e.usable) for e in estimates if np.isfinite(e.X_camera_ee).all()
    ]
    usable = [p for p in poses if p.usable]
    right, counted = right_poses(held.instances, usable)
    inside = np.array([_in_region(held, p.X_camera_ee[:3, 3]) for p in usable], dtype=bool)
    targets = [i for i in held.instances if i.target]
    found = [min(near) for i in targets if (near := [e for p in poses if _under(e := _errors(p, i), FOUND)])]
    return Seen(
        len(targets),
        len(found),
        sum(any(_under(_errors(p, i), RIGHT) for p in usable) for i in targets),
        int(np.count_nonzero(counted & ~right & inside)),
        tuple(found),
        ms,
        cpu_ms,
        times.whole_image,
    )


def perceive(held: HeldTool, way: Way) -> Seen:
    """Perceive a frame in one way, and judge the result.

    Args:
        held: The frame.
        way: The way.

    Returns:
        What was found, and the time it took.
    """
    start, cpu = time.perf_counter(), time.process_time()
    estimates, times = way(held.frame, held.hand)
    cpu = time.process_time() - cpu
    return judge(held, estimates, times, 1e3 * (time.perf_counter() - start), 1e3 * cpu)


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
        row: dict[str, Any] = {"frames": len(seen), "end_effectors": targets}
        for key in ("found", "usable_right", "wrong"):
            row[key] = sum(getattr(s, key) for s in seen) / targets
            change = np.array([getattr(s, key) - getattr(b, key) for s, b in zip(seen, base, strict=True)], float)
            row[f"{key}_difference"] = float(change.sum() / targets)
            row[f"{key}_interval"] = float(1.96 * np.sqrt(len(change)) * change.std() / targets)
        row["whole_image"] = float(np.mean([s.whole_image for s in seen]))
        for key, times in (("ms", [s.ms for s in seen]), ("cpu_ms", [s.cpu_ms for s in seen])):
            row |= {f"median_{key}": float(np.median(times)), f"p90_{key}": float(np.percentile(times, 90))}
        errors = np.array([e for s in seen for e in s.errors]).reshape(-1, 2)
        for key, column in zip(("mm", "deg"), errors.T, strict=True):
            row[f"median_{key}"] = metrics.quantiles(column)["median"]
        table[name] = row
    return table


def _errors(pose: Ranked, instance: Instance) -> tuple[float, float]:
    """Position error [mm] and rotation error [deg] modulo the symmetry; infinite for another category."""
    if pose.category is not instance.category:
        return np.inf, np.inf
    X, X_true = pose.X_camera_ee, instance.X_camera_ee
    angle = instance.category.symmetry.rotation_error(X[:3, :3], X_true[:3, :3])
    return 1e3 * float(np.linalg.norm(X[:3, 3] - X_true[:3, 3])), float(np.rad2deg(angle))


def _under(errors: tuple[float, float], limits: tuple[float, float]) -> bool:
    """Whether errors [mm, deg] are under limits [deg, m]."""
    return errors[0] < 1e3 * limits[1] and errors[1] < limits[0]


def _in_region(held: HeldTool, p: Array) -> bool:
    """Whether a point (3,) [m], camera frame, is in front of the part of the image that shows the region."""
    assert held.hand.region is not None
    K = held.frame.intrinsics
    crop = hand_crop(held.hand.X_camera_hand, held.hand.region, K)
    if crop is None:
        return False
    u, v = K.project(p)
    return bool(crop.x0 <= u < crop.x1 and crop.y0 <= v < crop.y1)


def ways(perception: ToolPerception, ablate: bool = False) -> dict[str, Way]:
    """The ways to be compared.

    Args:
        perception: The pipeline with the detector.
        ablate: Whether to add crops with each of the stages that only the whole image has, crops of other sizes, and
            the whole image without the stages.

    Returns:
        Name to way; `WHOLE` without the region, `ABOUT_HAND` as a job perceives.
    """
    found: dict[str, Way] = {
        WHOLE: lambda frame, hand: perception.estimate_timed(frame, replace(hand, region=None)),
        ABOUT_HAND: perception.estimate_timed,
    }
    if not ablate:
        return found
    detector = perception.detector
    assert isinstance(detector, Segmenter)

    def variant(detect: Callable[[RgbdFrame, HoldingHand], Instances]) -> Way:
        def way(frame: RgbdFrame, hand: HoldingHand) -> tuple[list[ToolEstimate], StageTimes]:
            start = time.perf_counter()
            detections = associate(*detect(frame, hand))
            segmentation = time.perf_counter() - start
            estimates, cloud, pose = perception.poses(frame, detections, hand)
            return estimates, StageTimes(1e3 * segmentation, 1e3 * cloud, 1e3 * pose, whole_image=False)

        return way

    def in_crop(side: int, stages: Stages) -> Way:
        def detect(frame: RgbdFrame, hand: HoldingHand) -> Instances:
            assert hand.region is not None
            crop = hand_crop(hand.X_camera_hand, hand.region, frame.intrinsics, side**2)
            return ([], [], [], []) if crop is None else detector.instances_in(frame, crop, stages=stages)

        return variant(detect)

    plain = Stages(coarse=False, zoomed=False, mirrored=False, refined=False)
    found["whole, one pass"] = variant(lambda frame, _hand: detector.instances(frame, stages=plain))
    for side in (256, 320, 384):
        found[f"crop {side}"] = in_crop(side, plain)
    found["crop 320, refined"] = in_crop(320, replace(plain, refined=True))
    found["crop 320, mirrored"] = in_crop(320, replace(plain, mirrored=True))
    found["crop 320, both"] = in_crop(320, replace(plain, mirrored=True, refined=True))
    return found

"""Pictures of flat toy tools (a bar with a coloured end), to exercise training and inference in seconds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.perception.offline.dataset.records import EeTable, Example
from toolee_robot.perception.offline.dataset.scenes import SegmentationSet, write_scene

_COLOURS = ((220, 60, 50), (60, 200, 70), (60, 90, 220), (230, 200, 60))


def toy_scenes(count: int, seed: int = 0, height: int = 64, width: int = 96) -> SegmentationSet:
    """One grey bar an image, with an end of category 1..4 in its own colour and shape."""
    rng = np.random.default_rng(seed)
    rgb = np.zeros((count, height, width, 3), np.uint8)
    ee, tool = np.zeros((count, height, width), np.uint8), np.zeros((count, height, width), np.uint8)
    categories = np.zeros((count, 1), np.uint8)
    for i in range(count):
        image = np.full((height, width, 3), rng.integers(0, 90, 3), np.uint8)
        category = int(rng.integers(4))
        angle = rng.uniform(0, 2 * np.pi)
        centre = np.array([width, height]) * rng.uniform(0.4, 0.6, 2)
        half = np.array([np.cos(angle), np.sin(angle)]) * height * 0.3
        a, b = (tuple(int(v) for v in np.round(p)) for p in (centre - half, centre + half))
        mask = np.zeros((height, width), np.uint8)
        cv2.line(mask, a, b, 1, 7)
        image[mask > 0] = 170
        end = np.zeros_like(mask)
        if category % 2:
            cv2.circle(end, b, 10, 1, -1)
        else:
            cv2.rectangle(end, (b[0] - 10, b[1] - 9), (b[0] + 10, b[1] + 9), 1, -1)
        image[end > 0] = _COLOURS[category]
        rgb[i] = np.clip(image + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8)
        ee[i], tool[i], categories[i, 0] = end, mask | end, category + 1
    depth = np.where(tool > 0, 600, 900).astype(np.uint16)
    depth[rng.random(depth.shape) < 0.02] = 0
    intrinsics = np.tile([0.8 * width, 0.8 * width, width / 2, height / 2], (count, 1))
    table = replace(EeTable.empty(), category=categories)
    return SegmentationSet(rgb, depth, ee, tool, table, intrinsics, np.zeros(count, np.uint8))


def enlarged(scenes: SegmentationSet, times: int) -> SegmentationSet:
    """The same pictures, every pixel `times` by `times` of them."""

    def large(maps: NDArray[Any]) -> NDArray[Any]:
        return maps.repeat(times, 1).repeat(times, 2)

    rgb, depth, ee, tool = large(scenes.rgb), large(scenes.depth_mm), large(scenes.ee), large(scenes.tool)
    return SegmentationSet(rgb, depth, ee, tool, scenes.table, times * scenes.intrinsics, scenes.scene)


def write_toys(folder: Path, scenes: SegmentationSet) -> None:
    """Write pictures of a data set's size as the data set's scene `folder`."""
    examples = []
    for i in range(len(scenes.rgb)):
        table = EeTable.empty()
        visible = np.count_nonzero(scenes.ee[i])
        table.category[0], table.obj_id[0], table.visible[0] = scenes.categories[i, 0], 1, visible
        camera, ee = scenes.camera(i), scenes.ee[i]
        examples.append(Example(scenes.rgb[i], scenes.depth_mm[i], ee, scenes.tool[i], table, camera, 0, ee))
    write_scene(folder, examples)

"""COCO mask AP of a detector by category, with faster-coco-eval (the `train` extra): `toolee evaluate segmentation`."""

from __future__ import annotations

import copy
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import AssetError
from toolee_robot.perception.detection.detector import CLASSES, TOOL
from toolee_robot.perception.detection.segmenter import EVERYTHING, Segmenter
from toolee_robot.perception.offline.dataset.scenes import SegmentationSet, bbox, load_scenes, scene_folders
from toolee_robot.perception.offline.dataset.spec import DatasetSpec, root_of

MIN_PIXELS = 50
"""Instances with fewer visible pixels are crowd: too small for a pose."""
STATISTICS = ("AP", "AP50", "AP75", "AP_S", "AP_M", "AP_L")
"""COCO's first six: mean over IoU .50 to .95, at .50, at .75, and by area (under 32^2, to 96^2, over) [px].

Images of `paper` have half of the paper's resolution: areas there count as in images of 1920x1080.
"""
_SIDES = (32.0, 96.0)
_TARGET = "target"
_CATEGORIES = [{"id": k, "name": name} for k, name in enumerate(CLASSES) if k > 0]


@dataclass(frozen=True)
class CocoTask:
    """Truth and detections in the COCO format.

    Attributes:
        truth: A COCO data set.
        results: A COCO result list.
        times: Time of each image [s].
        zoom: How many times the resolution the images have in which areas are counted.
    """

    truth: dict[str, Any] = field(
        default_factory=lambda: {"images": [], "categories": list(_CATEGORIES), "annotations": []}
    )
    results: list[dict[str, Any]] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    zoom: float = 1.0

    def of_targets(self) -> CocoTask:
        """The task with every instance that is no target as crowd: neither found nor missed."""
        annotations = [{**v, "iscrowd": int(v["iscrowd"] or not v[_TARGET])} for v in self.truth["annotations"]]
        return replace(self, truth={**self.truth, "annotations": annotations})


def evaluate(
    dataset_dir: Path, weights: Path | None = None, limit: int | None = None, device: str = "cpu"
) -> dict[str, Any]:
    """Evaluate a detector on a split of a data set; one scene is in memory at a time.

    Args:
        dataset_dir: Folder of the split.
        weights: Folder of the detector's weights; None: the shipped ones.
        limit: Largest number of images.
        device: torch device.

    Returns:
        See `report`.

    Raises:
        AssetError: Data or weights are missing.
        ModuleNotFoundError: faster-coco-eval is not installed.
    """
    segmenter = Segmenter.load(weights, device)
    scenes = scene_folders(dataset_dir)
    if not scenes:
        message = f"no BOP scene in {dataset_dir}: give the folder train or test of a data set"
        raise AssetError(message, code="asset.no_scene")
    root = root_of(dataset_dir)
    task = CocoTask(zoom=2.0 if root is not None and DatasetSpec.read(root).config == "paper" else 1.0)
    for scene in scenes:
        left = None if limit is None else limit - len(task.times)
        if left is not None and left <= 0:
            break
        images = load_scenes([scene], limit=left)
        coco_task(segmenter, images, images.table.targets, task)
        del images
    return report(task)


def coco_task(
    segmenter: Segmenter,
    images: SegmentationSet,
    targets: NDArray[np.bool_] | None = None,
    task: CocoTask | None = None,
) -> CocoTask:
    """Run a detector on images and collect truth and detections in the COCO format.

    Args:
        segmenter: The detector.
        images: The images.
        targets: Whether the pose of an image's EE id 1..E is asked for, (N, E); None: all. Annotations have it as
            "target".
        task: The task to which they are added; None: a new one.

    Returns:
        The task; instances of under 50 visible pixels are crowd.

    Raises:
        ModuleNotFoundError: faster-coco-eval is not installed.
    """
    from faster_coco_eval.core.mask import encode

    def encoded(mask: NDArray[np.bool_]) -> dict[str, Any]:
        rle: dict[str, Any] = encode(np.asfortranarray(mask.astype(np.uint8)))
        return rle

    task = task or CocoTask()
    annotations, first = task.truth["annotations"], len(task.truth["images"]) + 1
    height, width = images.rgb.shape[1:3]
    for i in range(len(images.rgb)):
        im_id = first + i
        task.truth["images"].append({"id": im_id, "height": height, "width": width})
        for label, mask, ee_id in true_instances(images, i):
            asked = targets is None or ee_id == 0 or bool(targets[i, ee_id - 1])
            entry = {"id": len(annotations) + 1, "image_id": im_id, "category_id": label, "bbox": bbox(mask)}
            area = int(mask.sum())
            about = {_TARGET: asked, "area": area, "iscrowd": int(area < MIN_PIXELS), "segmentation": encoded(mask)}
            annotations.append({**entry, **about})
        start = time.perf_counter()
        found = segmenter.instances(images.frame(i), EVERYTHING)
        task.times.append(time.perf_counter() - start)
        for one in found:
            entry = {"image_id": im_id, "category_id": one.label, "score": one.score}
            task.results.append({**entry, "segmentation": encoded(one.mask)})
    return task


def report(task: CocoTask) -> dict[str, Any]:
    """Figures of a task.

    Args:
        task: Truth and detections.

    Returns:
        For each class, and as "average" over the four EE categories: AP, AP50, AP75, AP_S, AP_M, AP_L (None: no such
        instance) and instances; number of images, median time of an image [ms]. Instances of under 50 visible pixels
        are crowd. "average_of_targets": the average with everything that is no target (`EeTable.targets`) as crowd,
        too.
    """
    count = len(task.truth["images"])
    median_ms = 1000 * float(np.median(task.times)) if task.times else None
    asked = statistics(task.of_targets())
    number = sum(asked[name]["instances"] for name in CLASSES[1:TOOL])
    found = {"images": count, "median_ms": median_ms, **statistics(task)}
    return {**found, "average_of_targets": {"instances": number, **asked["average"]}}


def statistics(task: CocoTask) -> dict[str, Any]:
    """COCO's statistics of each class, and as "average" over the four EE categories."""
    from faster_coco_eval import COCO, COCOeval_faster

    truth = COCO(copy.deepcopy(task.truth))
    found = truth.loadRes([dict(r) for r in task.results]) if task.results else None
    report: dict[str, Any] = {}
    for label in range(1, len(CLASSES)):
        n = sum(a["category_id"] == label and not a["iscrowd"] for a in task.truth["annotations"])
        values: list[float | None] = [0.0 if n else None] * len(STATISTICS)
        if found is not None and n:
            run = COCOeval_faster(truth, found, "segm", print_function=lambda *_: None)
            run.params.catIds = [label]
            areas = [0.0, *(side**2 / task.zoom**2 for side in _SIDES), 1e10]
            run.params.areaRng = [areas[::3], areas[:2], areas[1:3], areas[2:]]
            run.evaluate()
            run.accumulate()
            run.summarize()
            values = [float(v) if v >= 0 else None for v in run.stats[: len(STATISTICS)]]
        report[CLASSES[label]] = {"instances": n, **dict(zip(STATISTICS, values, strict=True))}
    ees = [report[name] for name in CLASSES[1:TOOL] if report[name]["instances"]]
    report["average"] = {
        name: float(np.mean(known)) if (known := [e[name] for e in ees if e[name] is not None]) else None
        for name in STATISTICS
    }
    return report


def true_instances(images: SegmentationSet, index: int) -> list[tuple[int, NDArray[np.bool_], int]]:
    """The true instances of one image.

    Args:
        images: The images.
        index: Number of the image.

    Returns:
        Label, mask (H, W), and id of the EE (0 for a tool) of every instance with at least one visible pixel.
    """
    found = []
    for ee_id, label in enumerate(images.categories[index].tolist(), 1):
        mask = images.ee[index] == ee_id
        if label and mask.any():
            found.append((int(label), mask, ee_id))
    for tool_id in np.unique(images.tool[index]):
        if tool_id:
            found.append((TOOL, images.tool[index] == tool_id, 0))
    return found

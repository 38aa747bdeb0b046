"""COCO mask AP of a detector, by category, with faster-coco-eval (the `test` extra).

python -m toolee_robot.perception.segmentation_evaluation --data data/test --weights runs/segmentation
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from toolee_robot.errors import UserError
from toolee_robot.perception.dataset.storage import load
from toolee_robot.perception.segmentation import EVERYTHING, Segmenter
from toolee_robot.perception.segmentation_data import SegmentationImages
from toolee_robot.perception.segmentation_model import CLASSES, TOOL

LEAST_PIXELS = 50
"""An instance of which less is seen is crowd: no pose could come of it."""
STATISTICS = ("AP", "AP50", "AP75", "AP_S", "AP_M", "AP_L")
"""COCO's first six: the mean over IoU .50 to .95, at .50, at .75, and by area (under 32^2, to 96^2, over) [px]."""


def evaluate(dataset_dir: Path, weights: Path | None = None, limit: int | None = None) -> dict[str, Any]:
    """Mask AP of the detector in `weights` (the shipped one if None) on the data set: see `evaluate_masks`."""
    return evaluate_masks(Segmenter.load(weights), load(dataset_dir), limit)


def evaluate_masks(segmenter: Segmenter, images: SegmentationImages, limit: int | None = None) -> dict[str, Any]:
    """For each class, and as "average" over the four EE categories: AP, AP50, AP75, AP_S, AP_M, AP_L (None: no such
    instance), images, instances, and the median time of an image [ms]. Instances of under 50 visible pixels
    are crowd: neither found nor missed."""
    try:
        from faster_coco_eval import COCO, COCOeval_faster
        from faster_coco_eval.core import mask as coco_mask
    except ImportError as error:
        raise UserError("evaluation needs faster-coco-eval: python -m pip install -e '.[test]'") from error

    def encoded(mask: NDArray[np.bool_]) -> dict[str, Any]:
        rle: dict[str, Any] = coco_mask.encode(np.asfortranarray(mask.astype(np.uint8)))
        return rle

    count = len(images.rgb) if limit is None else min(limit, len(images.rgb))
    annotations: list[dict[str, Any]] = []
    results: list[dict[str, Any]] = []
    times = []
    for i in range(count):
        for label, mask in true_instances(images, i):
            area = int(mask.sum())
            rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
            box = [int(columns[0]), int(rows[0]), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1]
            crowd = int(area < LEAST_PIXELS)
            entry = {"id": len(annotations) + 1, "image_id": i + 1, "category_id": label, "bbox": box}
            annotations.append({**entry, "area": area, "iscrowd": crowd, "segmentation": encoded(mask)})
        start = time.perf_counter()
        masks, labels, scores, _ = segmenter.instances(images.rgb[i], EVERYTHING)
        times.append(time.perf_counter() - start)
        for mask, label, score in zip(masks, labels, scores, strict=True):
            entry = {"image_id": i + 1, "category_id": label, "score": score}
            results.append({**entry, "segmentation": encoded(mask)})
    height, width = images.rgb.shape[1:3]
    truth = COCO(
        {
            "images": [{"id": i + 1, "height": height, "width": width} for i in range(count)],
            "categories": [{"id": k, "name": name} for k, name in enumerate(CLASSES) if k > 0],
            "annotations": annotations,
        }
    )
    report: dict[str, Any] = {"images": count, "median_ms": 1000 * float(np.median(times)) if times else None}
    found = truth.loadRes(results) if results else None
    for label in range(1, len(CLASSES)):
        n = sum(a["category_id"] == label and not a["iscrowd"] for a in annotations)
        values: list[float | None] = [0.0 if n else None] * len(STATISTICS)
        if found is not None and n:
            run = COCOeval_faster(truth, found, "segm", print_function=lambda *_: None)
            run.params.catIds = [label]
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


def true_instances(images: SegmentationImages, index: int) -> list[tuple[int, NDArray[np.bool_]]]:
    """(label, mask) of every instance of one image of which at least a pixel is seen."""
    found = []
    for ee_id, label in enumerate(images.categories[index].tolist(), 1):
        mask = images.ee[index] == ee_id
        if label and mask.any():
            found.append((int(label), mask))
    for tool_id in np.unique(images.tool[index]):
        if tool_id:
            found.append((TOOL, images.tool[index] == tool_id))
    return found


def _main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--weights", type=Path, help="folder of a training run; the shipped weights if left out")
    parser.add_argument("--limit", type=int, help="only the first so many images")
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    print(json.dumps(evaluate(options.data, options.weights, options.limit), indent=1))


if __name__ == "__main__":
    _main()

"""Sets of real RGB-D frames, for `toolee evaluate photographs`.

A set is a folder with `frames.json` and the pictures that it names. Of a frame it has colour, registered depth,
intrinsics, the place where it was taken and the half of the set that it belongs to: one half to choose by, the other
to report; frames of neither, whose pictures were trained on, are not scored. Ends have a category, a box [px] and,
where it is known, a pose; ranges to ignore hold what is neither found nor a false alarm.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError, words_of
from toolee_robot.frames import Array
from toolee_robot.perception.image_files import read_depth, read_rgb
from toolee_robot.perception.io import make_intrinsics
from toolee_robot.perception.offline.annotation.poses import Box
from toolee_robot.types import RgbdFrame

HALVES = ("A", "B")
"""The halves of a set: A to choose by, B to report."""


@dataclass(frozen=True)
class End:
    """An annotated end effector.

    Attributes:
        category: Its category.
        box: Box of its visible part, x0, y0, x1, y1 [px].
        X_camera_ee: Its pose, 4x4; None where it is not known.
        covariance: The pose's covariance, 6x6: position [m], rotation vector [rad], in the camera's axes; None where it
            is not known.
    """

    category: Category
    box: Box
    X_camera_ee: Array | None
    covariance: Array | None = None


@dataclass(frozen=True)
class Photograph:
    """An annotated frame.

    Attributes:
        name: Its name in the set.
        place: Where it was taken.
        half: The half of the set, one of HALVES.
        depth_is: "measured" by a sensor, or "modelled" from the geometry of a calibrated scene.
        frame: Colour and depth [m].
        ends: The end effectors in view.
        ignore: Boxes [px] in which a detection does not count.
    """

    name: str
    place: str
    half: str
    depth_is: str
    frame: RgbdFrame
    ends: tuple[End, ...]
    ignore: tuple[Box, ...]


def read_photographs(folder: Path, limit: int | None = None) -> list[Photograph]:
    """Read a set.

    Args:
        folder: Its folder.
        limit: Largest number of frames of each place.

    Returns:
        Its frames in the order of the file, without those of no half.

    Raises:
        UserError: `frames.json` or a picture is missing or damaged; the message names it.
    """
    path = folder / "frames.json"
    try:
        entries = json.loads(path.read_text())["frames"]
        places: dict[str, int] = {}
        found = []
        for entry in entries:
            if entry["half"] not in HALVES:
                continue
            places[entry["place"]] = places.get(entry["place"], 0) + 1
            if limit is None or places[entry["place"]] <= limit:
                found.append(_photograph(folder, entry))
        return found
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise UserError(
            f"{path} is no set of photographs ({words_of(error)}): make one as docs/dataset.md says",
            code="user.photographs",
        ) from error


def _photograph(folder: Path, entry: dict[str, Any]) -> Photograph:
    rgb = read_rgb(folder / entry["rgb"])
    height, width = rgb.shape[:2]
    fx, fy, cx, cy = (float(v) for v in entry["intrinsics"])
    depth = read_depth(folder / entry["depth"], 0.001 * float(entry.get("depth_scale", 1.0)))
    frame = RgbdFrame(rgb, depth, make_intrinsics(fx, fy, cx, cy, width, height))
    ends = tuple(
        End(Category(e["category"]), _box(e["box"]), _matrix(e, "X_camera_ee", 4), _matrix(e, "covariance", 6))
        for e in entry["ends"]
    )
    ignore = tuple(_box(b) for b in entry["ignore"])
    return Photograph(entry["name"], entry["place"], entry["half"], entry["depth_is"], frame, ends, ignore)


def _matrix(entry: dict[str, Any], key: str, size: int) -> Array | None:
    return None if entry.get(key) is None else np.array(entry[key], dtype=np.float64).reshape(size, size)


def _box(values: Sequence[float]) -> Box:
    x0, y0, x1, y1 = (float(v) for v in values)
    return x0, y0, x1, y1


def crops(photograph: Photograph) -> list[Photograph]:
    """Crops of half the width and height about each end, as an operator would cut them.

    Args:
        photograph: A whole frame.

    Returns:
        One photograph per end, with that end alone annotated; other ends in the crop are ignored.
    """
    height, width = photograph.frame.depth.shape
    h, w = height // 2, width // 2
    made = []
    for k, end in enumerate(photograph.ends):
        x = int(np.clip((end.box[0] + end.box[2]) / 2 - w / 2, 0, width - w))
        y = int(np.clip((end.box[1] + end.box[3]) / 2 - h / 2, 0, height - h))
        K = photograph.frame.intrinsics
        inside = make_intrinsics(K.fx, K.fy, float(np.clip(K.cx - x, 0, w)), float(np.clip(K.cy - y, 0, h)), w, h)
        part = np.s_[y : y + h, x : x + w]
        frame = RgbdFrame(photograph.frame.rgb[part].copy(), photograph.frame.depth[part].copy(), inside)
        others = [e.box for j, e in enumerate(photograph.ends) if j != k]
        # The principal point of a crop may lie outside of it, which the pose cannot take: poses are not judged here.
        ends = (End(end.category, _moved(end.box, x, y), None),)
        ignore = tuple(_moved(b, x, y) for b in [*photograph.ignore, *others])
        name, about = f"{photograph.name}#{k}", (photograph.place, photograph.half, photograph.depth_is)
        made.append(Photograph(name, *about, frame, ends, ignore))
    return made


def _moved(box: Box, x: float, y: float) -> Box:
    return box[0] - x, box[1] - y, box[2] - x, box[3] - y

"""The data card: what a data set holds, in numbers (JSON) and for a person (Markdown).

The card is a function of the content alone: no dates, no machine.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.perception.dataset.catalogue import Catalogue
from toolee_robot.perception.dataset.holdout import BACKDROPS, ROOMS, TEXTURES
from toolee_robot.perception.dataset.records import MIN_POINTS
from toolee_robot.perception.dataset.spec import SPLITS, DatasetSpec

EDGES: dict[str, list[float]] = {
    "depth_m": [round(0.3 + 0.05 * k, 2) for k in range(19)],
    "hidden_share": [round(0.05 * k, 2) for k in range(21)],
    "visible_pixels": [0, 50, 100, 200, 400, 800, 1600, 3200, 6400, 12800, 51200],
    "points_with_depth": [0, 50, 100, 200, 400, 800, 1600, 3200, 6400, 12800, 51200],
    "view_angle_deg": [10.0 * k for k in range(19)],
    "in_image_angle_deg": [-180.0 + 20.0 * k for k in range(19)],
    "tool_off_vertical_deg": [10.0 * k for k in range(19)],
}
"""Histograms over the EEs that are to be found. view_angle: between the EE's z axis and the way back to the camera;
in_image: direction of the tool's axis in the image, 0 is up; off_vertical: the tool's axis against the image's up."""


class Card:
    """Statistics of scenes, collected one scene at a time; memory does not grow with their number.

    Args:
        spec: What the data set was generated from.
        catalogue: Its tools.
    """

    def __init__(self, spec: DatasetSpec, catalogue: Catalogue) -> None:
        self._spec, self._catalogue = spec, catalogue
        self._scenes = {split: Counter[str]() for split in SPLITS}
        self._ees = {split: {c: Counter[str]() for c in CATEGORIES} for split in SPLITS}
        self._hands = {split: Counter[str]() for split in SPLITS}
        self._names: dict[str, dict[str, set[str]]] = {split: {c: set() for c in CATEGORIES} for split in SPLITS}
        self._histograms = {
            split: {c: {k: [0] * (len(e) - 1) for k, e in EDGES.items()} for c in CATEGORIES} for split in SPLITS
        }

    def add(self, split: str, camera: dict[str, Any], gt: dict[str, Any], info: dict[str, Any]) -> None:
        """Add one scene, given by the content of its JSON files.

        Args:
            split: Split of the scene.
            camera: scene_camera, image id -> entry.
            gt: scene_gt, image id -> entries of the EEs.
            info: scene_gt_info, image id -> entries of the EEs, in the same order.
        """
        for im_id, entry in camera.items():
            self._scenes[split][entry["scene"]] += 1
            seen: set[int] = set()
            for ee, about in zip(gt[im_id], info[im_id], strict=True):
                self._count(split, ee, about)
                if ee["tool_id"] not in seen:
                    seen.add(ee["tool_id"])
                    side = "left_hand" if ee["left_hand"] else "right_hand"
                    self._hands[split][side if "cam_R_h2c" in ee else "no_hand"] += 1

    def _count(self, split: str, ee: dict[str, Any], about: dict[str, Any]) -> None:
        category = CATEGORIES[ee["category_id"] - 1]
        counts = self._ees[split][category]
        counts["in_scene"] += 1
        counts["labelled"] += about["px_count_visib"] >= MIN_POINTS
        if not about["target"]:
            return
        counts["targets"] += 1
        self._names[split][category].add(ee["instance"])
        # A scalar at a time: numpy would take ten times as long for an EE.
        R = _float32(ee["cam_R_m2c"])
        x, y, z = _float32([1e-3 * v for v in ee["cam_t_m2c"]])
        _, _, right, _, _, down, _, _, _ = _float32(ee["cam_R_t2c"])
        facing = -(x * R[2] + y * R[5] + z * R[8]) / math.hypot(x, y, z)
        values = {
            "depth_m": z,
            "hidden_share": 1.0 - about["visib_fract"],
            "visible_pixels": about["px_count_visib"],
            "points_with_depth": about["px_count_valid"],
            "view_angle_deg": _arccos_deg(facing),
            "in_image_angle_deg": math.degrees(math.atan2(right, -down)),
            "tool_off_vertical_deg": _arccos_deg(-down),
        }
        histograms = self._histograms[split][category]
        for name, value in values.items():
            bins = histograms[name]
            bins[min(max(bisect_right(EDGES[name], value) - 1, 0), len(bins) - 1)] += 1

    def to_json(self) -> dict[str, Any]:
        """The card in numbers: counts, instances and histograms of each split, and the specification."""
        splits = {}
        for split in SPLITS:
            splits[split] = {
                "examples": sum(self._scenes[split].values()),
                "scenes": dict(sorted(self._scenes[split].items())),
                "tools": dict(sorted(self._hands[split].items())),
                "categories": {
                    str(c): {
                        **{k: self._ees[split][c][k] for k in ("in_scene", "labelled", "targets")},
                        "instances": sorted(self._names[split][c]),
                        "histograms": self._histograms[split][c],
                    }
                    for c in CATEGORIES
                },
            }
        return {
            "spec": self._spec.to_json(),
            "splits": splits,
            "histogram_edges": EDGES,
            "catalogue": {split: _names(self._catalogue, split) for split in SPLITS},
            "held_out_rule": _CUSTOM_RULE if self._spec.tools else _RULE,
            "surfaces": {
                split: {k: n * (4 if split == "train" else 1) // 5 for k, n in _SURFACES.items()} for split in SPLITS
            },
        }

    def to_markdown(self) -> str:
        """The card for a person: what the data set shows, its command, its files and its tables."""
        data = self.to_json()
        spec = data["spec"]
        which = _CUSTOM_TOOLS if self._spec.tools else f" --test-share {spec['test_share']:g}`"
        shown = ""
        if self._spec.renderer != "built-in":
            shown = f" --renderer {self._spec.renderer}" + (" --surroundings DIR" if self._spec.surroundings else "")
        if "kinds" in spec:
            shown += f" --kinds {spec['kinds']}"
        lines = [
            f"# TOOLEE data set `{spec['config']}`, {spec['size']} examples, seed {spec['seed']}",
            "",
            _ABOUT[spec["config"]],
            "",
        ]
        lines += [
            f"Generated by {spec['generator']}; licence {spec['licence']}. Synthetic: nobody is shown. Made with "
            f"`toolee dataset generate --config {spec['config']} --size {spec['size']} --seed {spec['seed']}"
            f"{shown}{which}; the same command gives the same bytes.",
            "",
            _FILES,
            "",
        ]
        for split in SPLITS:
            part = data["splits"][split]
            if not part["examples"]:
                continue
            kinds = ", ".join(f"{n} {k}" for k, n in part["scenes"].items())
            hands = ", ".join(f"{n} {k.replace('_', ' ')}" for k, n in part["tools"].items())
            lines += [f"## {split}: {part['examples']} examples", "", f"Scenes: {kinds}. Tools: {hands}.", ""]
            lines += [
                "| end effector | labelled (50 pixels or more) | to be found | instances shown | in the catalogue |",
                "|---|---|---|---|---|",
            ]
            for c, about in part["categories"].items():
                of = len(data["catalogue"][split][c])
                lines.append(f"| {c} | {about['labelled']} | {about['targets']} | {len(about['instances'])} | {of} |")
            lines += ["", *_histogram_table(part), ""]
        lines += [
            "## Splits",
            "",
            f"By instance: {data['held_out_rule']}. Textures, rooms, backdrops: "
            + "; ".join(
                f"{split} " + ", ".join(f"{n} {k}" for k, n in s.items()) for split, s in data["surfaces"].items()
            )
            + ". Colours of tools, hands and arm are drawn anew each time. All names, shown or not, are in "
            "`card.json`; held out (test) and shown here:",
            "",
        ]
        for c, about in data["splits"]["test"]["categories"].items():
            lines += [f"- {c}: {', '.join(about['instances']) or 'none'}"]
        lines += ["", "Shown in training:", ""]
        for c, about in data["splits"]["train"]["categories"].items():
            lines += [f"- {c}: {', '.join(about['instances']) or 'none'}"]
        return "\n".join(lines) + "\n"


_SURFACES = {"textures": TEXTURES, "rooms": ROOMS, "backdrops": BACKDROPS}
_RULE = "tools, textures, rooms and backdrops whose number leaves 4 when divided by 5 are the test split's"
_CUSTOM_RULE = (
    "the tools were brought by a user and all are the test split's, as is every fifth texture, room and backdrop"
)
_CUSTOM_TOOLS = " --tools DIR` on a user's own tools, whose shapes are not under this licence"
_ABOUT = {
    "paper": "The paper's protocol: an upright tool held in one grasp by one right hand, a camera never rolled, "
    "0.42 to 0.98 m, no noise; the end effector (EE) is what its tool shows within a circle of pixels (60 of 1920) "
    "about the EE's origin.",
    "paper-claws": "To train on: the paper's protocol, of claw hammers turned so that the head mostly stands before "
    "the claw. The end effector (EE) is what its tool shows within a circle of pixels (60 of 1920) about the EE's "
    "origin.",
    "hard": "Any orientation of tool and camera, 0.4 to 1.1 m, left, right, robot and human hands in many grasps, "
    "other tools and things, up to 70 % of the end effector (EE) hidden, a noisy depth camera (flying pixels, dropout) "
    "and a colour camera with its faults. The EE is what its tool shows within a sphere about the EE's origin.",
}
_FILES = (
    "`train`, `test`: BOP scenes. `models`: each EE's mesh (an object in BOP's sense) with symmetries in "
    "models_info.json. `tools`: whole tools. `coco`: instances with run-length masks. `clouds.npz` in each scene: what "
    "the depth camera sees of each EE. Poses are in the OpenCV camera frame, mm. See docs/dataset.md of the project."
)


def _float32(values: Sequence[float]) -> list[float]:
    """What readers of a pose, `scene_reader.pose_of`, get."""
    return array("f", values).tolist()


def _arccos_deg(cosine: float) -> float:
    return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))


def _names(catalogue: Catalogue, split: str) -> dict[str, list[str]]:
    numbers = catalogue.numbers(split)
    return {str(c): [catalogue.name(n) for n in numbers if c in catalogue.categories(n)] for c in CATEGORIES}


def _histogram_table(part: dict[str, Any]) -> list[str]:
    """Quartiles of the distributions, by category."""
    lines = ["| to be found | depth [m] | hidden | pixels | view angle [deg] |", "|---|---|---|---|---|"]
    for c, about in part["categories"].items():
        cells = []
        for name in ("depth_m", "hidden_share", "visible_pixels", "view_angle_deg"):
            counts = np.array(about["histograms"][name])
            if not counts.sum():
                cells.append("-")
                continue
            at = [int(np.searchsorted(np.cumsum(counts), q * counts.sum())) for q in (0.05, 0.5, 0.95)]
            low, middle, high = EDGES[name][at[0]], EDGES[name][at[1]], EDGES[name][at[2] + 1]
            cells.append(f"{low:g} .. {middle:g} .. {high:g}")
        lines.append(f"| {c} | " + " | ".join(cells) + " |")
    return [*lines, "", "(5 %, median, 95 % to the histogram's bins, which are in `card.json`)"]

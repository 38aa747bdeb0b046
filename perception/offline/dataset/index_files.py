"""Files that depend on all scenes: COCO files, model descriptions, data card, checksums."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.perception.offline.dataset.card import Card
from toolee_robot.perception.offline.dataset.files import SUMS, json_by_line, read_json, write_sums
from toolee_robot.perception.offline.dataset.instances import MODELS, TOOLS, model_entry, write_models_info
from toolee_robot.perception.offline.dataset.records import FOCAL, FULL_HEIGHT, FULL_WIDTH, HEIGHT, WIDTH
from toolee_robot.perception.offline.dataset.scene_reader import scene_folders
from toolee_robot.perception.offline.dataset.scene_writer import COCO_CATEGORIES
from toolee_robot.perception.offline.dataset.spec import SPLITS, DatasetSpec, SceneJob
from toolee_robot.runtime.files import sha256, write_atomic

README, CARD, CAMERA, TARGETS, COCO = "README.md", "card.json", "camera.json", "test_targets_bop19.json", "coco"


def is_finished(root: Path) -> bool:
    """Whether the data set at a folder is complete: its checksums, which are written last, exist."""
    return (root / SUMS).is_file()


def coco_path(root: Path, split: str) -> Path:
    """Path of the COCO file of a split.

    Args:
        root: Folder of the data set; file names in the COCO file are relative to it.
        split: "train" or "test".

    Returns:
        The path.
    """
    return root / COCO / f"instances_{split}.json"


def finish(root: Path) -> None:
    """Write the checksums of the whole data set; all other files must exist."""
    write_sums(root, {name: sha256(root / name) for name in listed(root)})


class Summary:
    """Collects the files that follow from scenes and models, one scene after the other, in the order of `spec.jobs()`.

    Args:
        spec: What the data set was generated from.
        root: Folder with the scenes and models.
    """

    def __init__(self, spec: DatasetSpec, root: Path) -> None:
        self._spec, self._root = spec, root
        self._catalogue = spec.catalogue(root)
        self._card = Card(spec, self._catalogue)
        self._models: dict[int, dict[str, Any]] = {}
        self._targets: list[dict[str, int]] = []
        self._coco = {split: _Coco() for split in SPLITS}

    def add(self, job: SceneJob) -> None:
        """Add the next scene.

        Args:
            job: The scene.

        Raises:
            AssetError: A file of the scene or a model is missing or damaged; the message names it.
        """
        scene = job.folder(self._root)
        camera, gt, info, own, instances = (
            read_json(scene / f"scene_{name}.json") for name in ("camera", "gt", "gt_info", "gt_coco", "instances")
        )
        self._coco[job.split].add(own, f"{job.split}/{scene.name}")
        self._card.add(job.split, camera, gt, info)
        for instance in instances.values():
            for obj_id, category in instance["objects"].items():
                self._add_model(int(obj_id), Category(category))
        if job.split == "test":
            self._targets += _targets(job.scene, gt, info)

    def write(self, out: Path) -> None:
        """Write the files into a folder: COCO files, models_info, camera, targets and card."""
        (out / COCO).mkdir(exist_ok=True)
        for split in SPLITS:
            write_atomic(coco_path(out, split), self._coco[split].to_bytes())
        write_models_info(out, self._models)
        paper = self._spec.config != "hard"
        f, width, height = (FOCAL, FULL_WIDTH, FULL_HEIGHT) if paper else (365.5, WIDTH, HEIGHT)
        cx, cy = (width / 2 - 0.5, height / 2 - 0.5) if paper else (254.9, 205.4)
        nominal = {"cx": cx, "cy": cy, "depth_scale": 1.0, "fx": f, "fy": f, "height": height, "width": width}
        (out / CAMERA).write_bytes(json_by_line(nominal))
        (out / TARGETS).write_text("[" + ",\n ".join(json.dumps(t) for t in self._targets) + "]\n")
        (out / CARD).write_text(json.dumps(self._card.to_json(), indent=1) + "\n")
        (out / README).write_text(self._card.to_markdown())

    def _add_model(self, obj_id: int, category: Category) -> None:
        known = self._models.get(obj_id)
        if known is None or known["category"] != category:
            self._models[obj_id] = model_entry(self._root, self._catalogue, obj_id, category)


def listed(root: Path) -> Iterator[str]:
    """The files whose checksums the data set's own SHA256SUMS holds: all but those that a scene's lists."""
    for path in sorted(root.iterdir()):
        if path.is_file() and path.name != SUMS and not path.name.startswith("."):
            yield path.name
    for folder in (COCO, MODELS, TOOLS):
        yield from (f"{folder}/{p.name}" for p in sorted((root / folder).glob("[!.]*")))
    for split in SPLITS:
        yield from (f"{split}/{scene.name}/{SUMS}" for scene in scene_folders(root / split))


def _targets(scene: int, gt: dict[str, Any], info: dict[str, Any]) -> list[dict[str, int]]:
    """BOP's list of what is to be found, of one scene."""
    rows = []
    for im_id, entries in gt.items():
        wanted = [e["obj_id"] for e, i in zip(entries, info[im_id], strict=True) if i["target"]]
        rows += [
            {"im_id": int(im_id), "inst_count": wanted.count(o), "obj_id": o, "scene_id": scene}
            for o in sorted(set(wanted))
        ]
    return rows


class _Coco:
    """A COCO file that grows scene by scene; its entries wait as text."""

    _encode = json.JSONEncoder(separators=(",", ":")).encode

    def __init__(self) -> None:
        self._images: list[str] = []
        self._annotations: list[str] = []

    def add(self, scene: dict[str, Any], prefix: str) -> None:
        """A scene's own COCO, its numbers made unique and its file names relative to the data set."""
        first = len(self._images) + 1
        for image in scene["images"]:
            entry = {**image, "id": first + image["id"], "file_name": f"{prefix}/{image['file_name']}"}
            self._images.append(self._encode(entry))
        for annotation in scene["annotations"]:
            entry = {**annotation, "id": len(self._annotations) + 1, "image_id": first + annotation["image_id"]}
            self._annotations.append(self._encode(entry))

    def to_bytes(self) -> bytes:
        """Content of the file."""
        about = f"{len(CATEGORIES)} kinds of end effectors of tools, and the tools"
        head = f'{{"info": {{"description": "{about}"}},\n"categories": {json.dumps(COCO_CATEGORIES)},\n"images": [\n'
        images, annotations = ",\n".join(self._images), ",\n".join(self._annotations)
        return f'{head}{images}\n],\n"annotations": [\n{annotations}\n]}}\n'.encode()

"""Files that depend on all scenes: COCO files, model descriptions, data card, checksums."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.perception.offline.dataset.card import Card
from toolee_robot.perception.offline.dataset.files import SUMS, json_by_line, read_json, write_sums
from toolee_robot.perception.offline.dataset.instances import MODELS, TOOLS, model_entry, write_models_info
from toolee_robot.perception.offline.dataset.records import FOCAL, FULL_HEIGHT, FULL_WIDTH, HEIGHT, WIDTH
from toolee_robot.perception.offline.dataset.scene_reader import scene_folders
from toolee_robot.perception.offline.dataset.scene_writer import COCO_CATEGORIES
from toolee_robot.perception.offline.dataset.spec import SPLITS, DatasetSpec, SceneJob
from toolee_robot.runtime.files import sha256

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


def derive(spec: DatasetSpec, root: Path, out: Path) -> None:
    """Write the files that follow from scenes and models: COCO files, models_info, camera, targets and card.

    Args:
        spec: What the data set was generated from.
        root: Folder with the scenes and models.
        out: Folder that the files are written into.

    Raises:
        AssetError: A scene or model is missing or damaged; the message names the file.
    """
    with Summary(spec, root, out) as summary:
        for job in spec.jobs():
            summary.add(job)


class Summary:
    """Writes the files that follow from scenes and models; one scene in memory at a time.

    Use as a context manager and add every scene, in the order of `spec.jobs()`. No file appears before the end, and
    none where an exception passes.

    Args:
        spec: What the data set was generated from.
        root: Folder with the scenes and models.
        out: Folder that the files are written into.
    """

    def __init__(self, spec: DatasetSpec, root: Path, out: Path) -> None:
        self._spec, self._root, self._out = spec, root, out
        self._catalogue = spec.catalogue(root)
        self._card = Card(spec, self._catalogue)
        self._models: dict[int, dict[str, Any]] = {}
        self._targets: list[dict[str, int]] = []

    def __enter__(self) -> Summary:
        (self._out / COCO).mkdir(exist_ok=True)
        self._coco = {split: _Coco(coco_path(self._out, split)) for split in SPLITS}
        return self

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

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        for coco in self._coco.values():
            coco.close(whole=kind is None)
        if kind is None:
            self._write()

    def _add_model(self, obj_id: int, category: Category) -> None:
        known = self._models.get(obj_id)
        if known is None or known["category"] != category:
            self._models[obj_id] = model_entry(self._root, self._catalogue, obj_id, category)

    def _write(self) -> None:
        write_models_info(self._out, self._models)
        paper = self._spec.config != "hard"
        f, width, height = (FOCAL, FULL_WIDTH, FULL_HEIGHT) if paper else (365.5, WIDTH, HEIGHT)
        cx, cy = (width / 2 - 0.5, height / 2 - 0.5) if paper else (254.9, 205.4)
        nominal = {"cx": cx, "cy": cy, "depth_scale": 1.0, "fx": f, "fy": f, "height": height, "width": width}
        (self._out / CAMERA).write_bytes(json_by_line(nominal))
        (self._out / TARGETS).write_text("[" + ",\n ".join(json.dumps(t) for t in self._targets) + "]\n")
        (self._out / CARD).write_text(json.dumps(self._card.to_json(), indent=1) + "\n")
        (self._out / README).write_text(self._card.to_markdown())


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
    """A COCO file that grows scene by scene; the annotations wait in a file of their own."""

    _encode = json.JSONEncoder(separators=(",", ":")).encode

    def __init__(self, path: Path) -> None:
        self._path = path
        self._parts = [path.with_name(f".{path.stem}.{name}.part") for name in ("images", "annotations")]
        self._images = self._annotations = 0
        self._out, self._later = self._files = [part.open("w+b") for part in self._parts]
        about = f"{len(CATEGORIES)} kinds of end effectors of tools, and the tools"
        head = f'{{"info": {{"description": "{about}"}},\n"categories": {json.dumps(COCO_CATEGORIES)},\n"images": [\n'
        self._out.write(head.encode())

    def add(self, scene: dict[str, Any], prefix: str) -> None:
        """A scene's own COCO, its numbers made unique and its file names relative to the data set."""
        first, images, annotations = self._images + 1, scene["images"], scene["annotations"]
        entries = [{**i, "id": first + i["id"], "file_name": f"{prefix}/{i['file_name']}"} for i in images]
        self._append(self._out, self._images > 0, entries)
        entries = [
            {**a, "id": k, "image_id": first + a["image_id"]} for k, a in enumerate(annotations, self._annotations + 1)
        ]
        self._append(self._later, self._annotations > 0, entries)
        self._images += len(images)
        self._annotations += len(annotations)

    def close(self, whole: bool) -> None:
        """whole: every scene was added, and the file may appear."""
        if whole:
            self._out.write(b'\n],\n"annotations": [\n')
            self._later.seek(0)
            shutil.copyfileobj(self._later, self._out, 1 << 20)
            self._out.write(b"\n]}\n")
        for file in self._files:
            file.close()
        if whole:
            self._parts[0].replace(self._path)
        for part in self._parts:
            part.unlink(missing_ok=True)

    def _append(self, file: IO[bytes], more: bool, entries: list[dict[str, Any]]) -> None:
        if entries:
            file.write(((",\n" if more else "") + ",\n".join(map(self._encode, entries))).encode())

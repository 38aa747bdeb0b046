"""What is known only when every scene is there: COCO files, model descriptions, data card, checksums."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from toolee_robot.perception.dataset.card import Card
from toolee_robot.perception.dataset.checksums import SUMS, sha256, write_sums
from toolee_robot.perception.dataset.instances import MODELS, TOOLS
from toolee_robot.perception.dataset.models import write_models_info
from toolee_robot.perception.dataset.paper import FOCAL, FULL_HEIGHT, FULL_WIDTH
from toolee_robot.perception.dataset.records import CATEGORIES, HEIGHT, WIDTH
from toolee_robot.perception.dataset.scene_reader import read_json, scene_folders
from toolee_robot.perception.dataset.scene_writer import COCO_CATEGORIES, json_by_line
from toolee_robot.perception.dataset.spec import SPLITS, DatasetSpec
from toolee_robot.types import Category

README, CARD, CAMERA, TARGETS, COCO = "README.md", "card.json", "camera.json", "test_targets_bop19.json", "coco"


def is_finished(root: Path) -> bool:
    """Whether the checksums of the whole, written last, are there."""
    return (root / SUMS).is_file()


def coco_path(root: Path, split: str) -> Path:
    """The COCO file of a split; its file names are relative to the data set's folder."""
    return root / COCO / f"instances_{split}.json"


def finish(spec: DatasetSpec, root: Path) -> None:
    """Write everything but the scenes, one scene in memory at a time. Raises AssetError naming a broken file."""
    derive(spec, root, root)
    write_sums(root, {name: sha256(root / name) for name in listed(root)})


def derive(spec: DatasetSpec, root: Path, out: Path) -> None:
    """Write what follows from the scenes and models in `root` into `out`."""
    (out / COCO).mkdir(exist_ok=True)
    catalogue = spec.catalogue(root)
    card = Card(spec, catalogue)
    categories: dict[int, Category] = {}
    targets: list[dict[str, int]] = []
    for split in SPLITS:
        with _Coco(coco_path(out, split)) as coco:
            for scene in scene_folders(root / split):
                camera, gt, info, own, instances = (
                    read_json(scene / f"scene_{name}.json")
                    for name in ("camera", "gt", "gt_info", "gt_coco", "instances")
                )
                coco.add(own, f"{split}/{scene.name}")
                card.add(split, camera, gt, info)
                for instance in instances.values():
                    categories |= {int(k): Category(v) for k, v in instance["objects"].items()}
                if split == "test":
                    targets += _targets(int(scene.name), gt, info)
    write_models_info(root, catalogue, categories, out)
    f, width, height = (FOCAL, FULL_WIDTH, FULL_HEIGHT) if spec.config == "paper" else (365.5, WIDTH, HEIGHT)
    cx, cy = (width / 2 - 0.5, height / 2 - 0.5) if spec.config == "paper" else (254.9, 205.4)
    nominal = {"cx": cx, "cy": cy, "depth_scale": 1.0, "fx": f, "fy": f, "height": height, "width": width}
    (out / CAMERA).write_bytes(json_by_line(nominal))
    (out / TARGETS).write_text("[" + ",\n ".join(json.dumps(t) for t in targets) + "]\n")
    (out / CARD).write_text(json.dumps(card.to_json(), indent=1) + "\n")
    (out / README).write_text(card.to_markdown())


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

    def __init__(self, path: Path) -> None:
        self._path, self._scratch = path, path.with_suffix(".part")
        self._images = self._annotations = 0

    def __enter__(self) -> _Coco:
        self._out: IO[str] = self._path.open("w")
        self._later: IO[str] = self._scratch.open("w+")
        self._out.write(
            f'{{"info": {{"description": "{len(CATEGORIES)} kinds of end effectors of tools, and the tools"}},\n'
        )
        self._out.write(f'"categories": {json.dumps(COCO_CATEGORIES)},\n"images": [\n')
        return self

    def add(self, scene: dict[str, Any], prefix: str) -> None:
        """A scene's own COCO, its numbers made unique and its file names relative to the data set."""
        for image in scene["images"]:
            entry = {**image, "id": self._images + image["id"] + 1, "file_name": f"{prefix}/{image['file_name']}"}
            self._line(self._out, self._images + image["id"] > 0, entry)
        for annotation in scene["annotations"]:
            entry = {**annotation, "id": self._annotations + 1, "image_id": self._images + annotation["image_id"] + 1}
            self._line(self._later, self._annotations > 0, entry)
            self._annotations += 1
        self._images += len(scene["images"])

    def __exit__(self, *_: object) -> None:
        self._out.write('\n],\n"annotations": [\n')
        self._later.seek(0)
        while text := self._later.read(1 << 20):
            self._out.write(text)
        self._out.write("\n]}\n")
        self._out.close()
        self._later.close()
        self._scratch.unlink()

    @staticmethod
    def _line(file: IO[str], more: bool, entry: dict[str, Any]) -> None:
        file.write((",\n" if more else "") + json.dumps(entry, separators=(",", ":")))

"""A data set as a folder: the same bytes however it is made, readable by others."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.tool_shapes import distances, main
from tests.errors import raises
from tests.perception.folders import assert_same
from toolee_robot.errors import AssetError, UserError
from toolee_robot.perception.cloud import check_depth_unit
from toolee_robot.perception.io import bop_images
from toolee_robot.perception.offline.dataset.instances import read_ply
from toolee_robot.perception.offline.dataset.records import SUMS, read_json
from toolee_robot.perception.offline.dataset.scenes import load
from toolee_robot.perception.offline.dataset.spec import DESCRIPTION, DatasetSpec
from toolee_robot.perception.offline.synthesis.generate import generate

pytestmark = pytest.mark.sim(seconds=15)

SPEC = DatasetSpec("hard", size=6, seed=11, test_share=0.3, scene_size=2)
KILLED = """
import sys
from pathlib import Path
from toolee_robot.perception.offline.synthesis.generate import generate
from toolee_robot.perception.offline.dataset.spec import DatasetSpec
if __name__ == "__main__":
    generate(DatasetSpec("hard", 6, 11, 0.3, 2), Path(sys.argv[1]), 1, lambda done, total: print(done, flush=True))
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Made by one worker."""
    root = tmp_path_factory.mktemp("whole")
    assert generate(SPEC, root, workers=1)
    return root


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    root = tmp_path / "copy"
    shutil.copytree(whole, root)
    return root


@pytest.mark.nightly
def test_three_workers_give_the_bytes_of_one_and_so_does_a_run_killed_in_the_middle(
    whole: Path, tmp_path: Path
) -> None:
    killed, script = tmp_path / "killed", tmp_path / "killed.py"
    script.write_text(KILLED)
    with subprocess.Popen([sys.executable, script, killed], stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        for line in run.stdout:
            if int(line) > 0:
                time.sleep(0.3)  # into the next scene
                os.kill(run.pid, signal.SIGKILL)
                break
    assert 0 < sum(1 for p in killed.glob("*/[0-9]*/" + SUMS)) < len(SPEC.jobs())
    assert generate(SPEC, killed, workers=3)
    assert_same(whole, killed)
    assert not generate(SPEC, killed), "what is finished is left alone"


@pytest.mark.nightly
def test_a_broken_scene_stops_a_resumed_run_and_nothing_half_written_stays(copy: Path) -> None:
    (copy / SUMS).unlink()
    shutil.rmtree(copy / "coco")
    (copy / "train/000001/scene_gt.json").write_text("{")
    with pytest.raises(AssetError, match=r"train/000001/scene_gt\.json"):
        generate(SPEC, copy)
    assert not (copy / "coco").exists()
    assert not (copy / SUMS).exists()


def test_another_data_set_or_a_full_folder_is_not_touched(copy: Path, tmp_path: Path) -> None:
    with raises(UserError, code="user.other_data_set"):
        generate(DatasetSpec("hard", 7, 11), copy)
    (copy / DESCRIPTION).write_text(json.dumps({k: v for k, v in SPEC.to_json().items() if k != "kinds"}))
    with pytest.raises(UserError, match="--kinds 13 to go on"):
        generate(SPEC, copy)
    (tmp_path / "thesis.txt").write_text("mine")
    with raises(UserError, code="user.folder_not_empty"):
        generate(SPEC, tmp_path)
    assert (tmp_path / "thesis.txt").read_text() == "mine"


def test_other_programs_can_read_it(whole: Path) -> None:
    """BOP's files agree with the models; COCO's with pycocotools; clouds with the depth."""
    from pycocotools import mask as coco_mask
    from pycocotools.coco import COCO

    info = read_json(whole / "models/models_info.json")
    for split in ("train", "test"):
        coco = COCO(whole / f"coco/instances_{split}.json")
        assert len(coco.imgs) == SPEC.counts[split]
        for image in coco.imgs.values():
            assert (whole / image["file_name"]).is_file()
            maps = Image.open((whole / image["file_name"].replace("/rgb/", "/tool/")).with_suffix(".png"))
            for annotation in coco.imgToAnns[image["id"]]:
                mask = coco.annToMask(annotation)
                assert mask.sum() == annotation["area"]
                assert coco_mask.toBbox(annotation["segmentation"]).tolist() == annotation["bbox"]
                if annotation["category_id"] == 5:
                    assert np.array_equal(mask > 0, np.asarray(maps) == annotation["tool_id"])
                assert annotation["category_id"] == 5 or np.unique(np.asarray(maps)[mask > 0]).size == 1
        for scene in sorted((whole / split).iterdir()):
            frames = {image.im_id: image.read() for image in bop_images(scene)}
            clouds = np.load(scene / "clouds.npz")
            for m, points in enumerate(np.split(clouds["points"], clouds["ends"][:-1])):
                check_depth_unit(frames[int(clouds["image"][m])].depth)
                entry = read_json(scene / "scene_gt.json")[str(clouds["image"][m])][clouds["gt"][m]]
                assert info[str(entry["obj_id"])]["split"] == split
                if clouds["count"][m] > 100:
                    R, t = np.reshape(entry["cam_R_m2c"], (3, 3)), np.array(entry["cam_t_m2c"])
                    vertices, _ = read_ply(whole / f"models/obj_{entry['obj_id']:06d}.ply")
                    local = (1000.0 * points - t) @ R
                    nearest = np.linalg.norm(local[:, None] - vertices[None, ::3], axis=-1).min(axis=1)
                    # Of a long screwdriver's thin shaft most pixels may show what is behind it.
                    share = 0.25 if entry["instance"].startswith("long_") else 0.5
                    assert np.quantile(nearest, share) < 10.0, "the model lies where its points are seen [mm]"
    symmetric = {e["category"]: {k for k in e if k.startswith("symm")} for e in info.values()}
    expected = {"hammer_head": {"symmetries_continuous"}, "wrench_head": {"symmetries_discrete"}, "hammer_grip": set()}
    assert all(symmetric[c] == s for c, s in expected.items() if c in symmetric)
    assert len(load(whole / "train")) == SPEC.counts["train"]


def test_the_card_names_what_is_held_out(whole: Path) -> None:
    card = read_json(whole / "card.json")
    for category in ("hammer_head", "hammer_grip", "screwdriver_head", "wrench_head"):
        train, test = (set(card["catalogue"][split][category]) for split in ("train", "test"))
        assert not train & test
        assert len(train) + len(test) >= 60
        assert len(test) == pytest.approx(0.2 * (len(train) + len(test)))
        shown = card["splits"]["test"]["categories"][category]["instances"]
        assert set(shown) <= test
        assert all(name in (whole / "README.md").read_text() for name in shown)


def test_shape_distances() -> None:
    """Ten points in a row, moved on by three: seven coincide with others, three are 1, 2 and 3 away."""
    row = np.column_stack([np.arange(10.0), np.zeros(10), np.zeros(10)])
    assert distances(row, row) == (0.0, 0.0, 0.0)
    assert distances(row, row + np.array([3.0, 0.0, 0.0])) == pytest.approx((0.6, 3.0, 3.0))


def test_shapes_of_a_data_set_have_a_table_and_a_figure(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([str(whole), "--pairs", "2", "--out", str(tmp_path / "shapes.png")])
    rows = [line.strip("|").split("|") for line in capsys.readouterr().out.splitlines()[2:]]
    assert rows
    assert all(float(value) > 0 for _, *cells in rows for cell in cells for value in cell.split(","))
    assert np.asarray(Image.open(tmp_path / "shapes.png").convert("L")).std() > 10

"""The evaluation on a data set of a few rendered frames: clouds and truth belong together, tables, report, command."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from tests.errors import raises
from tests.perception.data_sets import frames
from toolee_robot.cli.app import run
from toolee_robot.errors import AssetError
from toolee_robot.perception.detection.segmenter import Segmenter
from toolee_robot.perception.offline.dataset.catalogue import GENERATED
from toolee_robot.perception.offline.dataset.scenes import SegmentationSet, load
from toolee_robot.perception.offline.evaluation import metrics, pose
from toolee_robot.perception.offline.evaluation.estimates import Ranked, answer, load_estimator, questions, summary
from toolee_robot.perception.offline.evaluation.examples import Examples, collect, ee_shape, of_role
from toolee_robot.perception.offline.evaluation.pose import held_out_breakdown
from toolee_robot.perception.offline.evaluation.run import empty_frame
from toolee_robot.perception.offline.evaluation.segmentation import STATISTICS, CocoTask, coco_task, statistics
from toolee_robot.perception.pose import PoseEstimator
from toolee_robot.perception.trust import Trust

pytestmark = pytest.mark.sim(seconds=40)

FRAMES = 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return frames(tmp_path_factory, "test")


@pytest.fixture(scope="module")
def images(folder: Path) -> SegmentationSet:
    return load(folder / "test")


@pytest.fixture(scope="module")
def task(images: SegmentationSet) -> CocoTask:
    """What the shipped detector finds in the frames, and what is there."""
    pytest.importorskip("faster_coco_eval")
    return coco_task(Segmenter.load(), images, targets=images.table.targets)


@pytest.fixture(scope="module")
def examples(folder: Path) -> Examples:
    return collect(folder, Segmenter.load())


def test_clouds_lie_on_the_ends_that_they_are_said_to_show(examples: Examples) -> None:
    assert examples.images == FRAMES
    assert any(i.target for i in examples.instances)
    for case in examples.cases["truth"]:
        assert case.instance is not None
        instance = examples.instances[case.instance]
        assert instance.target
        assert instance.held_out
        if case.cloud.usable:
            X = instance.X_camera_ee
            local = (case.cloud.points - X[:3, 3]) @ X[:3, :3]
            assert np.median(np.linalg.norm(local, axis=1)) < instance.category.spec.radius + 0.01
            shape = ee_shape(instance.catalogue, instance.tool, instance.ee)
            assert 0.02 < shape.diameter < 2.1 * instance.category.spec.radius
    for case in examples.cases["predicted"]:
        if case.instance is not None:
            assert examples.instances[case.instance].category is case.category
    matched = [c.instance for c in examples.cases["predicted"] if c.instance is not None]
    assert len(matched) == len(set(matched))


def test_a_folder_without_data_is_refused(tmp_path: Path) -> None:
    with raises(AssetError, code="asset.no_scene"):
        collect(tmp_path)
    with raises(AssetError, code="asset.missing"):
        load_estimator(tmp_path)


def test_an_end_effector_is_taken_once_and_what_is_not_asked_for_does_not_count(examples: Examples) -> None:
    right = [Ranked(i.image, i.category, 0.9, i.X_camera_ee, True) for i in examples.instances if i.target]
    again = [replace(r, score=0.5) for r in right]
    correct, counted = pose.right_poses(examples.instances, [*again, *right])
    assert correct.tolist() == [False] * len(again) + [True] * len(right)
    assert counted.all()
    unasked = [replace(i, target=False) for i in examples.instances]
    correct, counted = pose.right_poses(unasked, right)
    assert not correct.any()
    assert not counted.any()


def test_the_command_writes_the_report(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "report"
    arguments = ["--true-masks-only", "--limit", "2", "--json", "--out", str(out)]
    assert run(["evaluate", "pose", str(folder), *arguments]) == 0
    printed = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert printed == json.loads((out / "report.json").read_text())
    assert "machine" in printed
    assert run(["evaluate", "pose", str(tmp_path / "none"), "--true-masks-only"]) == 1
    assert run(["evaluate", "pose", str(folder), "--weights", "a=x", "a=y"]) == 2


@pytest.fixture
def single_thread() -> Iterator[None]:
    """As a worker has: with another number of threads sums are rounded otherwise."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.nightly
@pytest.mark.usefixtures("single_thread")
def test_the_figures_are_the_same_for_any_number_of_workers(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    reports = []
    for workers in ("1", "2"):
        arguments = ["--limit", "3", "--no-tool", "2", "--workers", workers, "--json"]
        assert run(["evaluate", "pose", str(folder), *arguments]) == 0
        report = json.loads(capsys.readouterr().out.splitlines()[-1])
        del report["machine"]
        for masks in ("truth", "predicted"):
            assert report["estimators"]["ours"][masks].pop("latency")["workers"] == int(workers)
        reports.append(report)
    assert reports[0]["no_tool"]["frames"] == 2
    assert reports[0] == reports[1]


def test_the_breakdown_puts_every_instance_into_one_group_of_each_axis(examples: Examples) -> None:
    estimator = PoseEstimator.load()
    asked = questions(examples, "truth")
    found, _ = summary(examples, (answer(estimator, Trust(), q) for q in asked))
    tables = held_out_breakdown(examples.instances, found)
    right = metrics.within(found.angle, found.position, *metrics.THRESHOLDS["5deg2cm"]).sum()
    for groups in tables.values():
        assert sum(g["instances"] for g in groups.values()) == len(found)
        assert sum(g["instances"] * g["5deg2cm"] for g in groups.values() if g["instances"]) == pytest.approx(right)
    assert set(tables["tool"]) <= {"validation", "test"}
    near = [i for i in examples.instances if i.target and i.X_camera_ee[2, 3] < 0.55]
    assert tables["distance"].get("0.40 to 0.55 m", {"instances": 0})["instances"] == len(near)


def test_only_the_tools_of_the_role_asked_for_are_targets(examples: Examples) -> None:
    parts = [of_role(examples, role) for role in ("validation", "test")]
    targets = [{k for k, i in enumerate(part.instances) if i.target} for part in parts]
    assert not targets[0] & targets[1]
    assert targets[0] | targets[1] == {k for k, i in enumerate(examples.instances) if i.target}


def test_targets_without_depth_are_left_out_and_counted(
    folder: Path, examples: Examples, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = next(i.image for i in examples.instances if i.target)
    gone = sum(i.target for i in examples.instances if i.image == image)
    before = sum(i.too_few_points for i in examples.instances)
    shutil.copytree(folder, tmp_path / "data")
    path = tmp_path / f"data/test/000000/depth/{image:06d}.png"
    Image.fromarray(np.zeros_like(np.asarray(Image.open(path)))).save(path)
    assert run(["evaluate", "pose", str(tmp_path / "data"), "--true-masks-only", "--json", "--out", str(tmp_path)]) == 0
    data = json.loads(capsys.readouterr().out.splitlines()[-1])["data"]
    assert data["left_out_under_50_points"] == before + gone
    for groups in json.loads((tmp_path / "report.json").read_text())["estimators"]["ours"]["truth"][
        "breakdown"
    ].values():
        assert sum(g["left_out"] for g in groups.values()) == before + gone
        assert sum(g["instances"] for g in groups.values()) == data["targets"]
    assert data["targets"] == sum(i.target for i in examples.instances) - gone


def test_the_segmentation_command(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("faster_coco_eval")
    assert (
        run(["evaluate", "segmentation", str(folder / "test"), "--limit", "2", "--json", "--out", str(tmp_path)]) == 0
    )
    printed = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert printed["images"] == 2
    assert set(STATISTICS) <= set(printed["average"])
    assert json.loads((tmp_path / "report.json").read_text()) == printed


@pytest.mark.nightly
def test_what_is_no_target_is_neither_found_nor_missed(images: SegmentationSet, task: CocoTask) -> None:
    targets = images.table.targets
    assert targets.any()
    whole, asked = statistics(task), statistics(task.of_targets())
    assert whole["tool"] == asked["tool"]
    count = sum(asked[name]["instances"] for name in ("hammer_head", "hammer_grip", "screwdriver_head", "wrench_head"))
    assert count == np.count_nonzero(targets)
    # Were no EE asked for, even the best detection could not count, for or against.
    unasked = [{**a, "target": False} for a in task.truth["annotations"]]
    nothing = statistics(replace(task, truth={**task.truth, "annotations": unasked}).of_targets())
    assert nothing["average"]["AP"] is None


def test_areas_count_as_in_images_of_more_pixels() -> None:
    """A perfect mask of 20 x 20 pixels: small in its image, medium in one of twice the resolution."""
    mask = np.zeros((64, 64), bool)
    mask[10:30, 10:30] = True
    coded = {
        "category_id": 1,
        "image_id": 1,
        "segmentation": pytest.importorskip("faster_coco_eval.core.mask").encode(
            np.asfortranarray(mask.astype(np.uint8))
        ),
    }
    truth = {"id": 1, "bbox": [10, 10, 20, 20], "area": 400, "iscrowd": 0, "target": True, **coded}
    task = CocoTask(results=[{"score": 1.0, **coded}])
    task.truth["images"].append({"id": 1, "height": 64, "width": 64})
    task.truth["annotations"].append(truth)
    for zoom, sizes in ((1.0, (1.0, None, None)), (2.0, (None, 1.0, None)), (8.0, (None, None, 1.0))):
        found = statistics(replace(task, zoom=zoom))["hammer_head"]
        assert found["AP"] == pytest.approx(1.0)
        assert tuple(found[name] if found[name] is None else round(found[name], 6) for name in STATISTICS[3:]) == sizes


def test_empty_frames_show_clutter_and_repeat() -> None:
    frame, again = empty_frame(3, 0, GENERATED), empty_frame(3, 0, GENERATED)
    assert frame.depth.max() > 0.3
    assert np.array_equal(frame.rgb, again.rgb)

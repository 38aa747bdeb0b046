"""Clouds of rendered images: they agree with their truth, and trainings use them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks import published_clouds
from tests.errors import raises
from tests.perception.data_sets import frames
from toolee_robot.cli.app import run
from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.errors import AssetError
from toolee_robot.frames import Array
from toolee_robot.perception.detection.passes import Crop
from toolee_robot.perception.detection.segmenter import Segmenter
from toolee_robot.perception.offline.evaluation.examples import parts
from toolee_robot.perception.offline.rendered_clouds import clouds_of_part
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudConfig
from toolee_robot.perception.offline.synthetic_clouds.rendered import RenderedClouds, RenderedSource
from toolee_robot.perception.offline.synthetic_clouds.surface_samples import sample_hands, sample_tools
from toolee_robot.perception.offline.training.loop import Distributed
from toolee_robot.perception.offline.training.pose_training import TrainConfig, Trainer
from toolee_robot.perception.pose import PoseEstimator
from toolee_robot.perception.pose.canonical import REST_MIN, CanonicalCloud
from toolee_robot.perception.pose.cloud_estimator import PoseResult
from toolee_robot.perception.pose.network import NetworkConfig
from toolee_robot.perception.pose.tooleenet import PaperEstimator
from toolee_robot.types import Detection, RgbdFrame

pytestmark = [pytest.mark.sim(seconds=20), pytest.mark.nightly]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return frames(tmp_path_factory, "train") / "train"


@pytest.fixture(scope="module")
def clouds(folder: Path) -> RenderedClouds:
    return clouds_of_part(Segmenter.load(), parts(folder)[0])


def test_both_kinds_of_masks_give_clouds_about_their_ends(clouds: RenderedClouds) -> None:
    starts = np.cumsum(clouds.counts, axis=0) - clouds.counts
    found = 0
    for i in np.flatnonzero(clouds.positive):
        points = clouds.points[starts[i, 0] : starts[i, 0] + clouds.counts[i, 0]]
        local = (points - clouds.X_camera_ee[i, :3, 3]) @ clouds.X_camera_ee[i, :3, :3]
        radius = list(Category)[clouds.category[i]].spec.radius
        assert np.median(np.linalg.norm(local, axis=1)) < radius + 0.01
        found += 1
    poses = clouds.X_camera_ee[clouds.positive]
    # The true mask's and the detector's clouds of one EE have one pose.
    assert found > len(np.unique(poses, axis=0)) > 0


class ScriptedDetector:
    """A detector that reports given detections of every frame."""

    def __init__(self, detections: list[Detection]) -> None:
        self.detections = detections

    def detect(
        self,
        frame: RgbdFrame,  # noqa: ARG002
        categories: Sequence[Category] = CATEGORIES,  # noqa: ARG002
        crop: Crop | None = None,  # noqa: ARG002
    ) -> list[Detection]:
        return self.detections


def test_only_what_shows_none_of_its_category_is_a_negative(folder: Path) -> None:
    """Not a second detection of an EE that is found already, nor half of one."""
    part = replace(parts(folder)[0], count=1)
    seen = [d for d in Segmenter.load().detect(_frame(folder)) if d.score > 0.5]
    assert seen
    one = seen[0]
    rows = np.flatnonzero(one.mask.any(1))
    half = one.mask.copy()
    half[rows[len(rows) // 3] :] = False
    others = [c for c in Category if c is not one.category]

    def negatives(*detections: Detection) -> int:
        clouds = clouds_of_part(ScriptedDetector(list(detections)), part)
        return int((~clouds.positive).sum())

    assert negatives(one) == 0
    assert negatives(one, replace(one, score=0.4)) == 0
    assert negatives(replace(one, mask=half)) == 0
    claims = [replace(one, category=c) for c in others]
    assert negatives(*claims) >= 1


def _frame(folder: Path) -> RgbdFrame:
    from toolee_robot.perception.offline.dataset.scenes import load_scenes

    data = load_scenes([folder / "000000"], limit=1)
    return RgbdFrame(data.rgb[0], data.depth_mm[0].astype(np.float32) * np.float32(1e-3), data.camera(0))


def test_a_cloud_is_what_the_estimator_would_see(clouds: RenderedClouds) -> None:
    """The same cloud, given to an estimator as the pipeline gives it: centre, count and rest agree."""
    i = int(np.flatnonzero(clouds.positive & (clouds.counts[:, 2] > REST_MIN))[0])
    alone = _one(clouds, i)
    batch = RenderedSource(alone, "cpu", 0, CloudConfig(negative_share=0.0)).collect(1, 1)
    seen: list[tuple[torch.Tensor, float]] = []

    class Looks(PoseEstimator):
        def infer(
            self, cloud: CanonicalCloud, categories: list[Category], direction: torch.Tensor, visible: Array, *more: Any
        ) -> list[PoseResult]:
            seen.append((cloud.centre, float(visible[0])))
            return super().infer(cloud, categories, direction, visible, *more)

    category = list(Category)[clouds.category[i]]
    points, rest, guessed = (x.astype(np.float64) for x in (alone.points, alone.rest, alone.guessed))
    Looks.load().estimate(points, category, rest, completed=guessed)
    torch.testing.assert_close(batch.centre, seen[0][0], atol=1e-6, rtol=0)
    assert float(batch.visible[0]) == pytest.approx(seen[0][1] * clouds.visible[i] / clouds.counts[i, 0], abs=1.0)


def test_categories_are_drawn_by_their_shares_and_negatives_by_theirs(clouds: RenderedClouds) -> None:
    """However many there are of each."""
    negatives = replace(_renamed(clouds, 0, 7), positive=np.zeros(7, bool))
    many = RenderedClouds.cat([negatives, *[_renamed(clouds, k, 3 * k + 1) for k in range(len(Category))]])
    batch = RenderedSource(many, "cpu", 1, CloudConfig(negative_share=0.2)).collect(3000, 1000)
    assert float((~batch.positive).float().mean()) == pytest.approx(0.2, abs=0.04)
    of = batch.category[batch.positive]
    for k, category in enumerate(Category):
        assert float((of == k).float().mean()) == pytest.approx(category.spec.training_share, abs=0.05)


def _one(clouds: RenderedClouds, i: int) -> RenderedClouds:
    """The i-th alone."""
    start = (np.cumsum(clouds.counts, axis=0) - clouds.counts)[i]
    points, guessed, rest = (
        flat[s : s + n]
        for flat, s, n in zip((clouds.points, clouds.guessed, clouds.rest), start, clouds.counts[i], strict=True)
    )
    columns = {f.name: getattr(clouds, f.name)[i : i + 1] for f in fields(clouds)}
    return RenderedClouds(**{**columns, "points": points, "guessed": guessed, "rest": rest})


def _renamed(clouds: RenderedClouds, category: int, times: int) -> RenderedClouds:
    """A cloud as if it were of that category, so many times."""
    one = _one(clouds, int(np.flatnonzero(clouds.positive)[0]))
    return RenderedClouds.cat([replace(one, category=np.array([category]))] * times)


def test_clouds_come_back_from_their_file_and_another_file_is_refused(clouds: RenderedClouds, tmp_path: Path) -> None:
    clouds.save(tmp_path / "deep" / "clouds.npz")
    again = RenderedClouds.load(tmp_path / "deep" / "clouds.npz")
    assert len(again) == len(clouds)
    for f in fields(clouds):
        np.testing.assert_array_equal(getattr(again, f.name), getattr(clouds, f.name))
    (tmp_path / "other.npz").write_bytes(b"no clouds")
    with raises(AssetError, code="asset.unreadable"):
        RenderedClouds.load(tmp_path / "other.npz")


def test_the_command_keeps_them_for_a_training(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "clouds.npz"
    assert run(["train", "clouds", str(folder), "--out", str(out), "--limit", "2", "--json"]) == 0
    said = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    kept = RenderedClouds.load(out)
    assert said["positive"] == kept.positive.sum() > 0
    assert said["negative"] == (~kept.positive).sum()


def test_a_training_learns_from_them(clouds: RenderedClouds, tmp_path: Path) -> None:
    samples, held_out = (sample_tools(held_out=held, seeds_per_kind=1, workers=1) for held in (False, True))
    config = TrainConfig(max_steps=3, batch=8, chunk=16, first_fill=16, capacity=64, validation=40, compile=False)
    network = NetworkConfig(width=32, layers=1, heads=2, neighbours=8, flow_width=64, flow_blocks=1)
    distributed = Distributed(0, 1, torch.device("cpu"))

    def weights(share: float) -> torch.Tensor:
        shares = replace(config, rendered_share=share)
        trainer = Trainer(
            tmp_path / str(share), shares, (samples, held_out), sample_hands(4), distributed, clouds, network
        )
        report = trainer.run()
        assert np.isfinite(report["K20"]["average"]["median_mm"])
        assert report["train"]["rendered_clouds"] == len(clouds)
        return torch.cat([p.detach().flatten() for p in trainer.net.parameters()])

    shown = [weights(share) for share in (0.0, 1.0)]
    assert (shown[0] - shown[1]).abs().max() > 1e-5


@pytest.fixture(scope="module")
def paper_files(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Of a column each what the command keeps for it."""
    out = tmp_path_factory.mktemp("paper")
    files = {column: out / f"{column}.npz" for column in ("ee", "object-prior")}
    assert run(["train", "clouds", str(folder), "--out", str(files["ee"]), "--true-masks"]) == 0
    assert published_clouds.main([str(files["object-prior"]), "--images", "1", "--whole-tools"]) == 0
    return files


def test_for_the_paper_s_estimator_true_masks_alone_are_kept(
    paper_files: dict[str, Path], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = RenderedClouds.load(paper_files["ee"])
    assert kept.positive.all()
    assert len(np.unique(kept.X_camera_ee, axis=0)) == len(kept), "each end effector once"
    arguments = ["train", "clouds", str(folder), "--out", "x.npz", "--true-masks", "--weights", str(folder)]
    assert run(arguments) == 2
    assert "need no detector" in capsys.readouterr().err


@pytest.mark.parametrize("column", ["ee", pytest.param("object-prior", marks=pytest.mark.nightly)])
def test_the_paper_s_estimator_learns_from_rendered_images(
    paper_files: dict[str, Path], tmp_path: Path, column: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of its column's clouds, and of no others; the command continues, and keeps its configuration."""
    (tmp_path / "few.yaml").write_text("{epochs: 1, batch: 2, judged: 1, draws: 2}")

    def train(name: str, clouds: Path, column: str = column) -> int:
        arguments = ["train", "paper", str(clouds), "--out", str(tmp_path / name), "--column", column]
        return run([*arguments, "--config", str(tmp_path / "few.yaml"), "--device", "cpu", "--json"])

    assert train("right", paper_files[column]) == 0
    said = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert said["epochs"] == 1
    assert PaperEstimator.load(tmp_path / "right").column.name == column
    (other,) = paper_files.keys() - {column}
    assert train("wrong", paper_files[other]) == 2
    assert "--whole-tools or without" in capsys.readouterr().err
    assert train("right", paper_files[column], other) == 2
    assert "another column" in capsys.readouterr().err
    assert train("none", paper_files[column], "eye") == 2
    assert "choose one of" in capsys.readouterr().err


def test_a_folder_that_cannot_be_is_refused_before_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("in the way")
    out = tmp_path / "file" / "clouds.npz"
    assert run(["train", "clouds", str(tmp_path / "no data"), "--out", str(out)]) == 2
    assert "cannot make or write the folder" in capsys.readouterr().err

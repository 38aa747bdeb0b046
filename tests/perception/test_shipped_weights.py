"""Accuracy floor of the shipped weights: results of `ToolPerception` on 60 frozen frames, and the files' hashes.

The frames are a data set of the `hard` configuration with seed 7411, 20 frames to a scene: held-out tools of all kinds,
textures and backgrounds; 77 end effectors to be found, and frames without a tool. No training, fit or published figure
uses this seed.

Each bound is two or three instances (medians: at most 30 %) worse than the measured figure, about the resolution of so
few frames: rounding (bfloat16 or float32, other vector units) moves a count by one or two. The figures
in the docstrings were measured in float32 by `pytest -s tests/perception/test_shipped_weights.py`, which prints them.
New weights need new figures, bounds and hashes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import Array
from toolee_robot.perception import ToolPerception
from toolee_robot.perception.detection.passes import Crop
from toolee_robot.perception.offline.dataset.scenes import write_scene
from toolee_robot.perception.offline.dataset.spec import DatasetSpec
from toolee_robot.perception.offline.evaluation import metrics, pose
from toolee_robot.perception.offline.evaluation.estimates import Ranked
from toolee_robot.perception.offline.evaluation.examples import collect
from toolee_robot.perception.offline.synthesis.example import examples_of
from toolee_robot.perception.weight_files import WEIGHTS_DIR
from toolee_robot.types import Detection, RgbdFrame, ToolEstimate

pytestmark = pytest.mark.sim(seconds=100)

FRAMES = DatasetSpec("hard", 60, seed=7411, test_share=1.0, scene_size=20, kinds=22)
SURE = 0.5
"""Score above which a detection that shows no end effector counts as a false alarm."""


@dataclass(frozen=True)
class Scores:
    """What the shipped weights reach on `FRAMES`."""

    targets: int
    found: float
    mask_iou: float
    AP50: float
    false_alarms: int
    poses: dict[str, float]
    usable_right: float
    usable_wrong: int
    usable_without_tool: int
    head_median_mm: float
    head_median_deg: float


class _Recorded:
    """`ToolPerception` as the evaluation's detector, which keeps the estimates of every detection it hands over."""

    def __init__(self, perception: ToolPerception) -> None:
        self._perception = perception
        self.estimates: list[ToolEstimate] = []

    def detect(
        self,
        frame: RgbdFrame,
        categories: Sequence[Category] = CATEGORIES,
        crop: Crop | None = None,  # noqa: ARG002
    ) -> list[Detection]:
        found = self._perception.estimate(frame, categories=categories)
        self.estimates += found
        return [e.detection for e in found]


@pytest.fixture(scope="session")
def scores(tmp_path_factory: pytest.TempPathFactory) -> Scores:
    folder = tmp_path_factory.mktemp("floor")
    (folder / "test").mkdir()
    for job in FRAMES.jobs():
        write_scene(job.folder(folder), examples_of(FRAMES, job.split, job.first, job.last))
    recorded = _Recorded(ToolPerception.load())
    examples = collect(folder, recorded)
    cases = list(zip(examples.cases["predicted"], recorded.estimates, strict=True))
    targets = [number for number, instance in enumerate(examples.instances) if instance.target]

    # A detection of an end effector that is hardly visible is neither right nor wrong.
    counted = [(c, e) for c, e in cases if c.instance is None or c.instance in targets]
    matched = {c.instance: e.X_camera_ee for c, e in counted if c.instance is not None}
    errors = np.full((len(targets), 2), np.inf)  # [rad], [m]
    for row, number in enumerate(targets):
        X_true, X = examples.instances[number].X_camera_ee, matched.get(number)
        if X is not None and np.isfinite(X).all():
            angle = examples.instances[number].category.symmetry.rotation_error(X[:3, :3], X_true[:3, :3])
            errors[row] = angle, np.linalg.norm(X[:3, 3] - X_true[:3, 3])
    head = np.array([examples.instances[n].category is Category.HAMMER_HEAD for n in targets])
    median_rad, median_m = np.median(errors[head & np.isfinite(errors[:, 1])], axis=0)

    ranked = [
        Ranked(c.image, c.category, e.trust, e.X_camera_ee, e.usable)
        for c, e in counted
        if np.isfinite(e.X_camera_ee).all()
    ]
    usable = pose.usable_poses(examples.instances, ranked, examples.images)
    with_tool = {i.image for i in examples.instances}
    result = Scores(
        targets=len(targets),
        found=len(matched) / len(targets),
        mask_iou=float(np.mean([c.overlap for c, _ in counted if c.instance is not None])),
        AP50=_average_precision(
            np.array([c.score for c, _ in counted]),
            np.array([c.instance is not None for c, _ in counted]),
            len(targets),
        ),
        false_alarms=sum(c.instance is None and c.score > SURE for c, _ in cases),
        poses=metrics.shares(*errors.T),
        usable_right=usable["found_10deg2cm"] or 0.0,
        usable_wrong=round((usable["wrong_per_image"] or 0.0) * examples.images),
        usable_without_tool=sum(e.usable and c.image not in with_tool for c, e in cases),
        head_median_mm=1e3 * float(median_m),
        head_median_deg=float(np.rad2deg(median_rad)),
    )
    print(f"\n{result}")
    return result


@pytest.mark.nightly
def test_end_effectors_are_detected(scores: Scores) -> None:
    """Measured: 76 of 77, mean mask IoU 0.877, AP50 0.954, 12 false alarms."""
    assert 75 <= scores.targets <= 79, "a rounding may add or remove one: these are other frames than those measured"
    assert scores.found >= 74 / 77
    assert scores.mask_iou >= 0.874
    assert scores.AP50 >= 0.94
    assert scores.false_alarms <= 13


@pytest.mark.nightly
def test_poses_are_accurate(scores: Scores) -> None:
    """Measured: of 77 targets 66 within 5 deg 2 cm, 62 within 5 deg 5 mm, 37 within 2 deg 2 mm."""
    assert scores.poses["5deg2cm"] >= 63 / 77
    assert scores.poses["5deg5mm"] >= 59 / 77
    assert scores.poses["2deg2mm"] >= 34 / 77


@pytest.mark.nightly
def test_hammer_heads_are_accurate(scores: Scores) -> None:
    """Measured: medians 1.39 mm and 1.19 deg."""
    assert scores.head_median_mm <= 1.5
    assert scores.head_median_deg <= 1.5


@pytest.mark.nightly
def test_usable_poses_are_right(scores: Scores) -> None:
    """Measured: 66 poses marked usable, 64 of them within 10 deg 2 cm, 2 not; none without a tool."""
    assert scores.usable_right >= 62 / 77
    assert scores.usable_wrong <= 4
    assert scores.usable_without_tool == 0


def test_the_weights_are_those_that_were_measured() -> None:
    """`sha256sum -c sha256.txt` in the folder of the weights says the same."""
    lines = (WEIGHTS_DIR / "sha256.txt").read_text().splitlines()
    frozen = {name: digest for digest, name in (line.split() for line in lines)}
    shipped = {path.name: _sha256(path) for path in WEIGHTS_DIR.iterdir() if path.suffix in (".safetensors", ".json")}
    assert shipped == frozen, "measure the figures above and those of docs/ again, then renew sha256.txt"


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _average_precision(score: Array, correct: NDArray[np.bool_], targets: int) -> float:
    """Area under the interpolated precision-recall curve of ranked detections; equal scores keep their order."""
    if targets == 0:
        return float("nan")
    hits = correct[np.argsort(-score, kind="stable")]
    precision = np.cumsum(hits) / np.arange(1, len(hits) + 1)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float((envelope * hits).sum() / targets)

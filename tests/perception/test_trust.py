"""The trust model: its probabilities, its file, and its fit."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from toolee_robot.end_effectors import Category
from toolee_robot.errors import AssetError, UserError
from toolee_robot.perception import weight_files
from toolee_robot.perception.offline.fit_trust import TrustSamples, fit, fit_trust
from toolee_robot.perception.pose.cloud_estimator import PoseResult
from toolee_robot.perception.trust import Trust, features
from toolee_robot.types import PoseHypotheses

unit = st.floats(0.0, 1.0)
HEAD = Category.HAMMER_HEAD


def result(confidence: float, usable: bool = True) -> PoseResult:
    hypotheses = PoseHypotheses(np.eye(4)[None], np.zeros((1, 3)), 0.01, 0.1, 0.5)
    reason = "ok" if usable else "two poses"
    return PoseResult(HEAD, np.eye(4), np.eye(6), confidence, usable, reason, hypotheses, np.zeros(0), np.zeros(3))


@given(unit, unit, unit, unit, unit)
def test_the_surer_the_detector_and_the_pose_the_more_trust(
    a: float, b: float, c: float, d: float, tool: float
) -> None:
    (low, high), (weak, strong) = sorted((a, b)), sorted((c, d))
    for trust in (Trust(), Trust.load(None, None)):
        less, more = trust.judge(weak, tool, result(low))[0], trust.judge(strong, tool, result(high))[0]
        assert 0.0 <= less <= more + 1e-12 <= 1.0 + 1e-12


def test_where_nothing_was_fitted_the_odds_are_multiplied() -> None:
    probability, usable, reason = Trust().judge(0.9, 0.0, result(0.8))
    assert probability == pytest.approx(36 / 37)
    assert (usable, reason) == (True, "ok")
    probability, usable, reason = Trust().judge(0.1, 0.0, result(0.8))
    assert probability == pytest.approx(4 / 13)
    assert not usable
    assert "not sure of this hammer head (score 0.10)" in reason


def test_a_pose_that_is_not_usable_stays_so_with_its_own_reason() -> None:
    assert Trust().judge(0.99, 0.99, result(0.3, usable=False))[1:] == (False, "two poses")


def _weights(folder: Path) -> Path:
    for name in ("pose.json", "segmentation.json"):
        shutil.copy(weight_files.WEIGHTS_DIR / name, folder)
    return folder


def test_what_was_fitted_is_for_these_weights_only(tmp_path: Path) -> None:
    folder = _weights(tmp_path)
    assert Trust.load(folder, folder) == Trust()
    fitted = Trust.load(None, None)
    fitted.save(folder, {})
    assert Trust.load(folder, folder) == fitted
    assert Trust.load(folder, None) == Trust(), "another detector"
    with (folder / "pose.json").open("a") as file:
        file.write("\n")
    with raises(AssetError, code="asset.weights_replaced"):
        Trust.load(folder, folder)
    fitted.save(folder, {})
    assert Trust.load(folder, folder) == fitted
    (folder / "refinement.json").write_text("{}")
    with raises(AssetError, code="asset.weights_replaced"):
        Trust.load(folder, folder)
    (folder / "trust.json").write_text("{}")
    with raises(AssetError, code="asset.unreadable"):
        Trust.load(folder, folder)


def _drawn(n: int, alarm: bool, seed: int) -> list[TrustSamples]:
    """Images with one pose each: right ones under sure detections and a few wrong ones under doubtful, or alarms."""
    rng = np.random.default_rng(seed)
    looked = []
    for _ in range(n):
        right = not alarm and rng.uniform() < 0.8
        score = float(np.clip(rng.normal(0.85 if right else 0.35, 0.12), 0.01, 0.99))
        x = features(float(rng.uniform(0.6, 0.99)), score, score, HEAD)
        rows = 0 if alarm and rng.uniform() < 0.5 else 1
        ones = np.ones(rows)
        looked.append(TrustSamples(x[None][:rows], ones * right, ones, 1))
    return looked


def test_the_fit_learns_from_the_scores_and_keeps_empty_frames_quiet() -> None:
    trust, report = fit(_drawn(600, False, 1), _drawn(600, True, 2))
    assert report["images"] == report["frames_without_a_tool"] == 600
    assert report["usable_right"] > 0.95
    assert report["right_usable"] > 0.9
    assert report["quiet"] >= 0.99
    assert not trust.judge(0.35, 0.35, result(0.9))[1]
    assert trust.judge(0.85, 0.85, result(0.9))[1]


def test_too_little_to_fit_on_is_refused() -> None:
    with raises(UserError, code="user.too_few_images"):
        fit(_drawn(20, False, 1), _drawn(20, True, 2))
    with raises(UserError, code="user.too_few_images"):
        fit(_drawn(200, False, 1), [])


def test_missing_weights_are_named_before_any_worker_starts(tmp_path: Path) -> None:
    with raises(AssetError, code="asset.missing") as refused:
        fit_trust(tmp_path / "data", tmp_path, workers=2)
    assert "segmentation.json" in str(refused.value)

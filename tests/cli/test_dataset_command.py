"""`toolee dataset` as a person meets it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from toolee_robot.cli.app import run


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("made") / "paper"
    options = ["--config", "paper", "--size", "5", "--seed", "4", "--workers", "1"]
    assert run(["dataset", "generate", *options, "--out", str(root)]) == 0
    return root


def test_it_is_sound_until_a_file_is_changed(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["dataset", "validate", str(made), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"sound": True, "faults": []}
    path = made / "train/000000/depth/000002.png"
    before = path.read_bytes()
    path.write_bytes(before[:-1])
    try:
        assert run(["dataset", "validate", str(made)]) == 1
        assert "train/000000/depth/000002.png" in capsys.readouterr().out
    finally:
        path.write_bytes(before)


def test_it_can_be_looked_at(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "pictures"
    assert run(["dataset", "inspect", str(made), "--out", str(out), "--count", "3", "--pairs", "2", "--json"]) == 0
    line = json.loads(capsys.readouterr().out)
    for views in line["shape_distances"].values():
        for measure in ("chamfer", "hausdorff", "earth_mover"):
            assert views["ee"][measure]["mean_mm"] > 0
            assert views["ee"][measure]["variance_mm2"] >= 0
    assert sorted(p.name for p in out.iterdir()) == [
        "distributions.png", "inspection.json", "montage_test.png", "montage_train.png", "shapes.png",
    ]  # fmt: skip
    for path in out.glob("*.png"):
        assert np.asarray(Image.open(path).convert("L")).std() > 10, f"{path.name} shows something"


def test_what_is_made_is_not_made_again_and_what_is_missing_tells_its_cost(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "paper"
    shutil.copytree(made, root)
    options = ["--config", "paper", "--size", "5", "--seed", "4", "--out", str(root), "--json"]
    assert run(["dataset", "generate", *options]) == 0
    line = json.loads(capsys.readouterr().out)
    assert line["made"] is False
    assert line["cost"] is None
    (root / "SHA256SUMS").unlink()
    shutil.rmtree(root / "train/000000")
    assert run(["dataset", "generate", *options]) == 0
    cost = json.loads(capsys.readouterr().out)["cost"]
    assert cost["examples"] == 4, "of five, one is in the test split"
    assert cost["per_second"] > 0
    assert cost["cpu_ms"] > 1
    assert cost["worker_mb"] > 50


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["validate", "none"], "holds no data set"),
        (["inspect", "none"], "holds no data set"),
        (["generate", "--config", "hard", "--size", "0", "--out", "x"], "--size 0"),
        (["generate", "--config", "hard", "--size", "2", "--out", "x", "--workers", "0"], "--workers 0"),
        (["generate", "--config", "hard", "--size", "2", "--out", "x", "--test-share", "2"], "--test-share"),
        (["generate", "--config", "hard", "--size", "2", "--out", "file"], "file"),
        (["generate", "--config", "hard", "--size", "2", "--out", "x", "--device", "cuda", "--cluster", "ray"], "Ray"),
        pytest.param(
            ["generate", "--config", "hard", "--size", "2", "--out", "x", "--device", "cuda"],
            "choose cpu",
            marks=pytest.mark.skipif("__import__('warp').is_cuda_available()", reason="there is a GPU"),
        ),
    ],
)
def test_misuse_says_what_to_do(
    arguments: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    assert run(["dataset", *arguments]) == 2
    assert says in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["file"]

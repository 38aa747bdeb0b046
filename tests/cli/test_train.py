"""`toolee train` at the smallest size: it learns, resumes, keeps its configuration, and refuses another."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import torch

from tests.errors import raises
from tests.perception.data_sets import frames
from tests.perception.toy_scenes import toy_scenes, write_toys
from toolee_robot.cli.app import run
from toolee_robot.errors import UserError
from toolee_robot.perception.detection.refiner import MaskRefinement
from toolee_robot.perception.offline.dataset.records import HEIGHT, WIDTH
from toolee_robot.perception.offline.training.options import remember
from toolee_robot.perception.weight_files import WEIGHTS_DIR

pytestmark = pytest.mark.sim(seconds=15)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("train")
    write_toys(folder / "000000", toy_scenes(3, height=HEIGHT, width=WIDTH))
    return folder


@pytest.mark.nightly
def test_segmentation_resumes_and_keeps_its_configuration(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, options = tmp_path / "out", tmp_path / "options.yaml"
    options.write_text("batch: 1\nlog_every: 1\nlr: 0.0005\nmax_steps: 9\n")
    command = ["train", "segmentation", "--data", str(data), "--out", str(out), "--config", str(options), "--json"]
    command += ["--device", "cpu"]
    assert run([*command, "--max-steps", "1"]) == 0
    config = json.loads((out / "config.json").read_text())
    assert (config["batch"], config["lr"], config["max_steps"]) == (1, 0.0005, 1), "the command line wins over the file"
    described = json.loads((out / "segmentation.json").read_text())
    assert described["training"]["lr"] == 0.0005
    capsys.readouterr()
    assert run([*command, "--max-steps", "2"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["resumed"]
    log = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    assert [entry["step"] for entry in log if "event" not in entry] == [1, 2]
    assert [entry["event"] for entry in log if "event" in entry] == ["start", "resumed"]
    assert run([*command, "--max-steps", "3", "--seed", "5"]) == 2
    assert "another seed" in capsys.readouterr().err


@pytest.mark.nightly
def test_refinement_resumes_beside_the_detector_and_keeps_its_configuration(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    """The shipped detector's finds in a few rendered frames, the refiner trained into that detector's folder."""
    data, out, options = frames(tmp_path_factory, "train") / "train", tmp_path / "out", tmp_path / "options.yaml"
    out.mkdir()
    for path in (*WEIGHTS_DIR.glob("segmentation*"), WEIGHTS_DIR / "sha256.txt"):
        shutil.copy(path, out)
    (out / "config.json").write_text("the detector's")
    options.write_text("batch: 2\nlog_every: 1\nlr: 0.0005\nmax_steps: 9\n")
    command = ["train", "refinement", "--data", str(data), "--out", str(out), "--config", str(options), "--json"]
    command += ["--device", "cpu"]
    assert run([*command, "--detector", str(out), "--max-steps", "1"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == {"out": str(out), "resumed": False}
    config = json.loads((out / "refinement_config.json").read_text())
    assert (config["batch"], config["lr"], config["max_steps"]) == (2, 0.0005, 1), "the command line wins over the file"
    assert config["detector"] == str(out)
    assert (out / "config.json").read_text() == "the detector's"
    assert run([*command, "--detector", str(out), "--max-steps", "2"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["resumed"]
    described = json.loads((out / "refinement.json").read_text())
    assert described["training"]["lr"] == 0.0005
    assert [entry["step"] for entry in described["log"]] == [1, 2]
    assert run([*command, "--detector", str(out), "--max-steps", "3", "--seed", "5"]) == 2
    assert "another seed" in capsys.readouterr().err
    assert run([*command, "--max-steps", "3"]) == 2
    assert "another detector" in capsys.readouterr().err
    assert MaskRefinement.load(out, torch.device("cpu"), bfloat16=False) is not None


@pytest.mark.parametrize(
    ("text", "expected_text"),
    [("lrr: 1", "has no option lrr"), ("- 1", "no mapping"), ("{", "cannot read the options")],
)
def test_a_bad_configuration_is_named(
    text: str, expected_text: str, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.yaml").write_text(text)
    arguments = ["--out", str(tmp_path / "out"), "--config", str(tmp_path / "bad.yaml")]
    for network in ("segmentation", "refinement"):
        assert run(["train", network, "--data", str(data), *arguments]) == 2
        assert expected_text in capsys.readouterr().err
    assert run(["train", "pose", *arguments]) == 2
    assert expected_text in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "line", ["lr: abc", "batch: 1.5", "batch: true", "seed: 99999999999", "max_steps: 0", "log_every: -1", "lr: .inf",
             "device: 3", "train_seeds: 0"]
)  # fmt: skip
def test_an_option_that_cannot_be_is_named(line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.yaml").write_text(line)
    assert run(["train", "pose", "--out", str(tmp_path / "out"), "--config", str(tmp_path / "bad.yaml")]) == 2
    assert line.split(":")[0] in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["{", "[1]", "\0", "NaN"])
def test_a_damaged_configuration_of_a_begun_training_is_named(text: str, tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text(text)
    with raises(UserError, code="user.training_config") as refused:
        remember(tmp_path, True, {"lr": 0.1})
    assert str(tmp_path / "config.json") in str(refused.value)
    assert (tmp_path / "config.json").read_text() == text


@pytest.mark.parametrize("network", ["segmentation", "refinement"])
def test_data_that_are_not_there_are_asked_for(
    network: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["train", network, "--data", str(tmp_path / "nothing"), "--out", str(tmp_path / "out")]) == 2
    assert "dataset generate" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.nightly
def test_what_is_trusted_is_fitted_on_a_data_set(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    """The shipped networks on a few rendered frames: too few to fit on, which is said, and what is there stays."""
    data = frames(tmp_path_factory, "test")
    weights = tmp_path / "weights"
    shutil.copytree(WEIGHTS_DIR, weights)
    before = (weights / "trust.json").read_bytes()
    command = ["train", "trust", "--data", str(data), "--weights", str(weights), "--frames", "1"]
    assert run(command) == 2
    assert "take more images" in capsys.readouterr().err
    assert (weights / "trust.json").read_bytes() == before


@pytest.mark.sim
def test_trust_is_not_fitted_without_a_data_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["train", "trust", "--data", str(tmp_path / "nothing")]) == 1
    assert "dataset generate" in capsys.readouterr().err

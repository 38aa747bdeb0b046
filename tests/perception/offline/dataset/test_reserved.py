"""Nothing is trained or fitted on a test set, whichever command is given one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.errors import raises
from toolee_robot.cli.app import run
from toolee_robot.errors import UserError
from toolee_robot.perception.offline.dataset.spec import (
    DESCRIPTION,
    PHOTOGRAPHS,
    TEST_SEEDS,
    DatasetSpec,
    refuse_test_set,
)

MARKED = DatasetSpec("hard", 10, 5, test_set=True)


def described(folder: Path, spec: DatasetSpec) -> Path:
    """A data set's folder with its description and no image yet; its training split."""
    split = folder / "train"
    split.mkdir(parents=True)
    (folder / DESCRIPTION).write_text(json.dumps(spec.to_json()))
    return split


@pytest.mark.parametrize("spec", [MARKED, *(DatasetSpec("hard", 10, seed) for seed in sorted(TEST_SEEDS))])
def test_a_test_set_is_refused_whole_and_by_its_split(spec: DatasetSpec, tmp_path: Path) -> None:
    split = described(tmp_path / "set", spec)
    (tmp_path / "link").symlink_to(split)
    for folder in (tmp_path / "set", split, tmp_path / "link"):
        with raises(UserError, "user.test_set") as raised:
            refuse_test_set(folder)
        assert f"seed {spec.seed}" in str(raised.value)
        assert "take another seed" in str(raised.value)


def test_other_data_and_folders_without_a_description_pass(tmp_path: Path) -> None:
    refuse_test_set(described(tmp_path / "set", replace(MARKED, test_set=False)))
    refuse_test_set(tmp_path / "missing")


@pytest.mark.parametrize(
    "command",
    [
        ["trust", "--data", "{data}"],
        ["clouds", "{data}", "--out", "{out}/clouds.npz"],
        ["clouds", "{data}", "--out", "{out}/clouds.npz", "--true-masks"],
        ["segmentation", "--data", "{data}", "--out", "{out}"],
        ["refinement", "--data", "{data}", "--out", "{out}"],
    ],
    ids=lambda command: " ".join(command[:1] + command[5:]),
)
def test_every_training_on_a_folder_refuses_a_test_set(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = described(tmp_path / "set", MARKED)
    assert run(["train", *(word.format(data=data, out=tmp_path / "out") for word in command)]) == 2
    assert "take another seed" in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*"))


def test_photographs_of_a_test_set_are_no_backgrounds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = described(tmp_path / "set", replace(MARKED, test_set=False))
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    refuse_test_set(photographs)
    (photographs / PHOTOGRAPHS).write_text(json.dumps({"frames": []}))
    refuse_test_set(photographs)
    (photographs / PHOTOGRAPHS).write_text(json.dumps({"test_set": True, "frames": []}))
    with raises(UserError, "user.test_set"):
        refuse_test_set(photographs)
    arguments = ["--data", str(data), "--out", str(tmp_path / "out"), "--wide", "0.5"]
    assert run(["train", "segmentation", *arguments, "--backgrounds", str(photographs)]) == 2
    assert "take other photographs" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()

"""A data set of the second renderer: the built-in one's scenes, the same bytes again, and nothing to train on."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.errors import raises
from tests.perception.folders import assert_same
from toolee_robot.cli.app import run
from toolee_robot.errors import UserError
from toolee_robot.perception.offline.dataset.reserved import refuse_test_set
from toolee_robot.perception.offline.dataset.scene_reader import load
from toolee_robot.perception.offline.dataset.spec import DESCRIPTION, DatasetSpec
from toolee_robot.perception.offline.synthesis.example import Series, examples_of, render_example

pytestmark = pytest.mark.sim(seconds=40)

SEED, SIZE = 31, 2


def surroundings(folder: Path) -> Path:
    """A panorama with a bright window, and a striped texture of wood."""
    folder.mkdir()
    light = np.full((32, 64, 3), 0.2, np.float32)
    light[6:14, 20:30] = 8.0
    stripes = np.zeros((16, 16, 3), np.uint8)
    stripes[:, ::2] = (60, 110, 160)
    assert cv2.imwrite(str(folder / "room.hdr"), light)
    assert cv2.imwrite(str(folder / "wood.png"), stripes)
    return folder


def generate(out: Path, *more: str) -> int:
    line = ["dataset", "generate", "--config", "hard", "--renderer", "mitsuba", "--size", str(SIZE)]
    return run([*line, "--seed", str(SEED), "--workers", "1", "--out", str(out), *more])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("path_traced")
    around = surroundings(folder / "around")
    assert generate(folder / "set", "--surroundings", str(around)) == 0
    return folder


def test_it_is_sound_and_shows_the_scenes_of_the_built_in_renderer(made: Path) -> None:
    assert run(["dataset", "validate", str(made / "set")]) == 0
    assert "--renderer mitsuba --surroundings DIR" in (made / "set" / "README.md").read_text()
    assert DatasetSpec.read(made / "set").counts == {"train": 0, "test": SIZE}
    images = load(made / "set" / "test")
    for i in range(SIZE):
        taken = render_example(Series(SEED, "test"), i)
        ee, _, _, table = taken.labels
        assert np.allclose(images.row(i).X_camera_ee, table.X_camera_ee, atol=1e-5, equal_nan=True)
        assert np.mean((images.ee[i] > 0) != (ee > 0)) < 0.002
        assert images.rgb[i].std() > 5


@pytest.mark.nightly  # with the built-in renderer in every run
def test_interrupted_and_again_it_has_the_same_bytes(made: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    shutil.copytree(made / "set", again)
    shutil.rmtree(again / "test" / "000000")
    (again / "SHA256SUMS").unlink()
    around = ["--surroundings", str(made / "around")]
    assert generate(again, *around) == 0
    assert_same(made / "set", again)


def test_other_surroundings_are_another_data_set(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert generate(made / "set") == 2
    assert "holds another data set (other surroundings)" in capsys.readouterr().err


def test_pictures_without_the_surroundings_that_they_name_are_refused(tmp_path: Path) -> None:
    files = (("room.hdr", "ab"),)
    for named, folder in ((files, None), ((), tmp_path)):
        spec = DatasetSpec("hard", 4, 3, 1.0, renderer="mitsuba", surroundings=named)
        with raises(UserError, "user.other_surroundings"):
            next(examples_of(spec, "test", 0, 1, surroundings=folder))


@pytest.mark.parametrize(
    "command",
    [
        ["trust", "--data", "{data}"],
        ["clouds", "{data}", "--out", "{out}/clouds.npz"],
        ["segmentation", "--data", "{data}", "--out", "{out}"],
        ["refinement", "--data", "{data}", "--out", "{out}"],
    ],
    ids=lambda command: command[0],
)
def test_no_training_takes_it(
    command: list[str], made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = made / "set" / "test"
    assert run(["train", *(word.format(data=data, out=tmp_path / "out") for word in command)]) == 2
    assert "to evaluate on" in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*"))


def test_its_specification_is_read_as_it_was_written(tmp_path: Path) -> None:
    spec = DatasetSpec("hard", 4, 3, 1.0, renderer="mitsuba", surroundings=(("room.hdr", "ab"), ("wood.png", "cd")))
    (tmp_path / DESCRIPTION).write_text(json.dumps(spec.to_json()))
    assert DatasetSpec.read(tmp_path) == spec
    with raises(UserError, "user.test_set"):
        refuse_test_set(tmp_path)
    assert "renderer" not in DatasetSpec("hard", 4, 3).to_json(), "the bytes of older data sets stay as they are"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"test_share": 0.5}, "held-out tools only"),
        ({"config": "paper"}, "shows --config hard only"),
        ({"device": "cuda"}, "runs on the cpu"),
        ({"renderer": "cycles"}, "choose one of built-in, mitsuba"),
        ({"renderer": "built-in", "surroundings": (("room.hdr", "ab"),)}, "leave them out"),
    ],
)
def test_what_it_does_not_show_is_refused(change: dict[str, Any], says: str) -> None:
    asked: dict[str, Any] = {"config": "hard", "size": 4, "test_share": 1.0, "renderer": "mitsuba", **change}
    with pytest.raises(UserError, match=says):
        DatasetSpec(**asked)


def test_a_folder_without_a_panorama_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert generate(tmp_path / "set", "--surroundings", str(tmp_path)) == 2
    assert "no panorama there" in capsys.readouterr().err

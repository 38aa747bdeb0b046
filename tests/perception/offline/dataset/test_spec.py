"""A data set's specification: sensor, kinds and numbers of tools, and that nothing is trained on a test set."""

from __future__ import annotations

import json
import pickle
import shlex
from collections import Counter
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from tests.errors import raises
from tests.examples import examples
from tests.perception.folders import assert_same
from tests.perception.offline.synthesis.test_custom_tools import bring
from toolee_robot.cli.app import parse, run
from toolee_robot.cli.dataset import Generate
from toolee_robot.depth_noise import KINDS, SensorKind
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import transform
from toolee_robot.perception.offline.dataset.catalogue import (
    FIRST_KINDS,
    GENERATED,
    CustomToolRecord,
    CustomTools,
    generated_tools,
)
from toolee_robot.perception.offline.dataset.index_files import README, Card
from toolee_robot.perception.offline.dataset.instances import object_id
from toolee_robot.perception.offline.dataset.scenes import png_bytes
from toolee_robot.perception.offline.dataset.spec import (
    DESCRIPTION,
    PHOTOGRAPHS,
    TEST_SEEDS,
    DatasetSpec,
    generated_catalogue_of,
    refuse_test_set,
)
from toolee_robot.perception.offline.synthesis.custom_tool_reader import read_custom_tools
from toolee_robot.tools import TOOL_SPECS


@pytest.mark.parametrize("sensor", KINDS)
def test_a_specification_is_read_as_it_was_written(sensor: SensorKind, tmp_path: Path) -> None:
    spec = DatasetSpec("hard", 10, 3, sensor=sensor)
    (tmp_path / DESCRIPTION).write_text(json.dumps(spec.to_json()))
    assert DatasetSpec.read(tmp_path) == spec


def test_a_data_set_from_before_there_were_sensors_is_the_same_one() -> None:
    assert "sensor" not in DatasetSpec("hard", 10, 3).to_json()


def test_a_data_set_from_before_it_said_from_how_many_kinds_was_drawn_from_thirteen(tmp_path: Path) -> None:
    old = DatasetSpec("hard", 10, 3, kinds=13)
    assert "kinds" not in old.to_json()
    for spec in (old, DatasetSpec("hard", 10, 3)):
        (tmp_path / DESCRIPTION).write_text(json.dumps(spec.to_json()))
        assert DatasetSpec.read(tmp_path) == spec
        assert len(spec.catalogue(tmp_path).numbers("train")) == 120 * spec.kinds
    with raises(UserError, code="user.kinds"):
        DatasetSpec("hard", 10, kinds=12)


def test_what_is_rendered_beside_a_data_set_is_of_its_kinds(tmp_path: Path) -> None:
    assert generated_catalogue_of(tmp_path) is GENERATED
    for kinds in (13, 17):
        (tmp_path / DESCRIPTION).write_text(json.dumps(DatasetSpec("hard", 10, 3, kinds=kinds).to_json()))
        for folder in (tmp_path, tmp_path / "test"):
            folder.mkdir(exist_ok=True)
            assert generated_catalogue_of(folder) is generated_tools(kinds)


def test_a_data_set_of_a_newer_version_is_refused_as_such(tmp_path: Path) -> None:
    (tmp_path / DESCRIPTION).write_text(json.dumps({**DatasetSpec("hard", 10, 3).to_json(), "kinds": 25}))
    with raises(UserError, code="user.newer_data_set"):
        DatasetSpec.read(tmp_path)


def test_an_unknown_sensor_and_one_for_a_camera_without_noise_are_refused() -> None:
    with pytest.raises(UserError, match="choose one of time-of-flight"):
        DatasetSpec("hard", 10, sensor="radar")  # type: ignore[arg-type]
    with pytest.raises(UserError, match="choose hard"):
        DatasetSpec("paper", 10, sensor="active-stereo")


CUSTOM = range(1950, 15000)
"""Numbers that belong to custom tools; data sets of custom tools were written with them when there were 13 kinds."""


def test_custom_tools_keep_the_numbers_and_object_ids_of_data_sets_already_written() -> None:
    record = CustomToolRecord(
        "mine", "", (Category.HAMMER_HEAD,), (tuple(transform().ravel()),), ((-0.1, 0.1),) * 3, "wood", "rubber"
    )
    custom = CustomTools(Path(), (record, record))
    assert custom.numbers("test") == [1950, 1951]
    assert [object_id(number, 0) for number in custom.numbers("test")] == [7801, 7805]
    assert custom.name(1951) == "mine"


def test_no_generated_tool_has_a_number_of_the_custom_ones() -> None:
    numbers = GENERATED.numbers("train") + GENERATED.numbers("test")
    assert len(set(numbers)) == len(numbers) == 150 * len(TOOL_SPECS)
    assert not set(numbers) & set(CUSTOM)
    assert (GENERATED.name(0), GENERATED.name(1949)) == ("claw_hammer-0000", "socket_wrench-0149")
    assert GENERATED.name(15000) == "hanging_claw_hammer-0000"
    for number in (-1, CUSTOM[0], CUSTOM[-1], max(numbers) + 1):
        with raises(UserError, code="user"):
            GENERATED.name(number)


def test_data_sets_of_the_first_kinds_draw_the_tools_that_they_always_drew() -> None:
    first = generated_tools(FIRST_KINDS)
    pool = first.pool(np.random.default_rng(5), "train")
    assert pool == (453, 91, 41, 15, 773, 1010, 938, 1168, 991, 1745, 1636, 1825)
    with raises(UserError, code="user"):
        first.name(15000)
    assert pickle.loads(pickle.dumps(first)) is first


@pytest.mark.parametrize("split", ["train", "test"])
def test_pools_show_every_kind_and_mostly_the_common_ones(split: str) -> None:
    rng = np.random.default_rng(0)
    drawn = [number for _ in range(400) for number in GENERATED.pool(rng, split)]
    assert {GENERATED.split(number) for number in drawn} == {split}
    kinds = Counter(GENERATED.listed(number).about["kind"] for number in drawn)
    assert set(kinds) == set(map(str, TOOL_SPECS))
    later = sum(number >= CUSTOM.stop for number in drawn) / len(drawn)
    assert later == pytest.approx(1 / 3, abs=0.03)


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


@st.composite
def images(draw: st.DrawFn) -> NDArray[Any]:
    """Noise or smooth, of each depth of bits, any width (the last byte of bits may be in part)."""
    shape = draw(st.integers(1, 9)), draw(st.integers(1, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    kind = draw(st.sampled_from([np.uint16, np.uint8, np.bool_]))
    if kind is np.bool_:
        return rng.random(shape) < draw(st.sampled_from([0.0, 0.1, 0.5, 1.0]))
    high = np.iinfo(kind).max
    if draw(st.booleans()):
        return rng.integers(0, high, shape, dtype=kind, endpoint=True)
    return np.broadcast_to(np.linspace(0, high, shape[1]), shape).astype(kind)


@examples(60)
@given(images())
def test_another_program_reads_the_same_pixels(pixels: NDArray[Any]) -> None:
    read = np.asarray(Image.open(BytesIO(png_bytes(pixels))))
    assert read.dtype == pixels.dtype
    np.testing.assert_array_equal(read, pixels)


def test_other_pixels_are_refused() -> None:
    with pytest.raises(TypeError, match="float32"):
        png_bytes(np.zeros((2, 2), np.float32))


def command(card: str) -> list[str]:
    """The arguments of the card's command."""
    words = shlex.split(card.split("Made with `")[1].split("`")[0])
    assert words[:3] == ["toolee", "dataset", "generate"]
    return words[2:]


def asked_again(spec: DatasetSpec, folder: Path) -> DatasetSpec:
    """What the parser of the command line makes of the card's command, with a folder for DIR."""
    told = command(Card(spec, spec.catalogue(folder)).to_markdown())
    arguments = [str(folder) if word == "DIR" else word for word in told]
    action = parse(["dataset", *arguments, "--out", "x"])
    assert isinstance(action, Generate)
    return action.spec(action.custom_tools())


@pytest.fixture(scope="module")
def brought(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a tool of one's own."""
    folder = tmp_path_factory.mktemp("brought")
    bring(folder / "mallet")
    return folder


generated = st.one_of(
    st.builds(
        DatasetSpec,
        config=st.just("hard"),
        size=st.integers(1, 10**6),
        seed=st.integers(0, 2**31 - 1),
        test_share=st.floats(0, 1),
        device=st.sampled_from(("cpu", "cuda")),
        test_set=st.booleans(),
        sensor=st.sampled_from(KINDS),
        kinds=st.integers(13, len(TOOL_SPECS)),
    ),
    st.builds(
        DatasetSpec,
        config=st.just("paper"),
        size=st.integers(1, 10**6),
        test_share=st.sampled_from((0.0, 0.1, 1 / 3, 1.0)),
        kinds=st.integers(13, len(TOOL_SPECS)),
    ),
)


@examples(40)
@given(generated)
def test_the_command_asks_for_the_same_data_set(spec: DatasetSpec) -> None:
    assert asked_again(spec, Path()) == spec


@pytest.mark.parametrize("own", [False, True], ids=["generated", "own"])
def test_so_does_that_of_ones_own_folders(own: bool, brought: Path) -> None:
    spec = DatasetSpec("hard", 4, 6, 1.0, sensor="mixed", test_set=True)
    if own:
        spec = replace(spec, tools=tuple(tool.record for tool in read_custom_tools(brought)))
    assert asked_again(spec, brought) == spec


@pytest.mark.nightly
@pytest.mark.sim
def test_the_command_gives_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    options = ["--kinds", "13", "--sensor", "active-stereo", "--test-share", "1", "--test-set", "--workers", "1"]
    assert run(["dataset", "generate", "--config", "hard", "--size", "2", *options, "--out", "made"]) == 0
    made = tmp_path / "made"
    assert run(["dataset", *command((made / README).read_text()), "--out", "again", "--workers", "1"]) == 0
    assert_same(made, tmp_path / "again")

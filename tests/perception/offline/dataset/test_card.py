"""The data card's command repeats the data set."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from tests.perception.folders import assert_same
from toolee_robot.cli.app import parse, run
from toolee_robot.cli.dataset import Generate
from toolee_robot.perception.offline.dataset.index_files import README, Card, listed
from toolee_robot.perception.offline.dataset.records import write_sums
from toolee_robot.perception.offline.dataset.spec import DatasetSpec
from toolee_robot.perception.offline.dataset.validate import validate
from toolee_robot.perception.offline.synthesis.custom_tool_reader import read_custom_tools
from toolee_robot.runtime.files import sha256
from toolee_robot.sensor_kinds import KINDS
from toolee_robot.tools import TOOL_SPECS


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
    """A folder with a tool of one's own, and with a panorama."""
    folder = tmp_path_factory.mktemp("brought")
    bars = ([[0, 0, 0], [0, 0, 250]], [[-50, 0, 250], [60, 0, 250]])
    mesh: Any = trimesh.util.concatenate([trimesh.creation.cylinder(14.0, segment=np.array(bar)) for bar in bars])
    (folder / "mallet").mkdir()
    mesh.export(folder / "mallet/mallet.stl")
    description = {
        "mesh": "mallet.stl",
        "scale": 0.001,
        "handle": {"butt": [0, 0, 0], "end": [0, 0, 230]},
        "ees": [{"category": "hammer_head", "position": [60, 0, 250], "z": [1, 0, 0]}],
        "materials": {"handle": "wood", "head": "rubber"},
    }
    (folder / "mallet/tool.yaml").write_text(yaml.safe_dump(description))
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
        config=st.sampled_from(("paper", "paper-claws")),
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
def test_the_command_gives_the_same_bytes_and_older_words_of_it_are_no_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    options = ["--kinds", "13", "--sensor", "active-stereo", "--test-share", "1", "--test-set", "--workers", "1"]
    assert run(["dataset", "generate", "--config", "hard", "--size", "2", *options, "--out", "made"]) == 0
    made = tmp_path / "made"
    assert run(["dataset", *command((made / README).read_text()), "--out", "again", "--workers", "1"]) == 0
    assert_same(made, tmp_path / "again")
    for words, faults in ((" --kinds 13", []), ("## test: 2", [README])):
        (made / README).write_text((made / README).read_text().replace(words, ""))
        write_sums(made, {name: sha256(made / name) for name in listed(made)})
        assert [fault.file for fault in validate(made)] == faults

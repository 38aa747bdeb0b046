"""What a station file lacks, in the order in which a lab does it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.errors import raises
from toolee_robot.cli.app import run
from toolee_robot.errors import UserError
from toolee_robot.station import MEASURED
from toolee_robot.stations.template import OFFERED, open_fields, open_questions, parse, told

LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"
FILE = Path("my lab.yaml")


def test_an_empty_file_lacks_everything_once_what_is_typed_first() -> None:
    found = open_fields({}, FILE)
    assert [entry.typed for entry in found] == sorted((entry.typed for entry in found), reverse=True)
    names = [f"{entry.section}.{name}" for entry in found if not entry.note for name in entry.names]
    assert len(set(names)) == len(names)
    offered = set(OFFERED)
    asked = {question.name for question in open_questions({})} - offered | {"strike.speed"}
    assert {name.removeprefix(".") for name in names} == asked | {"calibration"}
    assert {f"{s}.{n}" for s, fields in MEASURED.items() for n in fields} - set(names) == {"hand.weighed"}, (
        "which is asked of a hand, once its model is known"
    )
    defaults = {f"{entry.section}.{name}" for entry in found if entry.typed and entry.note for name in entry.names}
    assert defaults == offered - {"strike.speed"}, "no default of which is a first strike's on a robot"
    commands = [entry.source.split()[:3] for entry in found if not entry.typed]
    assert [" ".join(words[1:]) for words in commands] == [
        "camera show", "doctor --station", "arm lag", "calibrate camera", "calibrate nail",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "taken",
    [("tool", "mass"), ("camera", "fx"), ("calibration",), ("servo", "lag"), ("person", "door_open_input")],
    ids=".".join,
)
def test_a_field_that_is_taken_out_is_on_one_line(taken: tuple[str, ...]) -> None:
    said: dict[str, Any] = yaml.safe_load(LAB.read_text())
    before = told(open_fields(said, FILE)).splitlines()
    part = said
    for name in taken[:-1]:
        part = part[name]
    del part[taken[-1]]
    new = [line for line in told(open_fields(said, FILE)).splitlines() if line not in before]
    assert any(line.lstrip().startswith(taken[0]) and taken[-1] in line for line in new)
    assert all("my lab.yaml'" in line for line in new if "--station" in line), "a command that can be copied"


def test_the_command_for_the_intrinsics_names_the_mode() -> None:
    lab = yaml.safe_load(LAB.read_text())
    del lab["camera"]["fx"], lab["camera"]["height"]
    (entry,) = (entry for entry in open_fields(lab, FILE) if "fx" in entry.names)
    assert entry.source == "toolee camera show --driver realsense --serial 832112070123 --size 640 H"


def test_that_for_a_recording_plays_it() -> None:
    lab = yaml.safe_load(LAB.read_text())
    del lab["camera"]["fx"]
    lab["camera"]["device"] |= {"driver": "recorded", "folder": "my frames"}
    (entry,) = (entry for entry in open_fields(lab, FILE) if "fx" in entry.names)
    assert entry.source == "toolee camera show --recording 'my frames'"


def test_the_lens_is_asked_of_a_driver_that_may_not_tell_it() -> None:
    lab = yaml.safe_load(LAB.read_text())
    assert "camera.distortion" not in {q.name for q in open_questions(lab)}, "a RealSense tells it"
    lab["camera"]["device"]["driver"] = "ours"
    (question,) = (q for q in open_questions(lab) if q.name == "camera.distortion")
    assert OFFERED[question.name] == "none"
    assert parse(question, "none") is None
    assert parse(question, "[0.1, -0.2, 0.001, 0]") == [0.1, -0.2, 0.001, 0.0]
    with raises(UserError):
        parse(question, "0.1 barrel")
    (entry,) = (entry for entry in open_fields(lab, FILE) if "distortion" in entry.names)
    assert entry.note, "a job goes without it; the doctor warns"


def test_the_commands_are_commands(capsys: pytest.CaptureFixture[str]) -> None:
    for entry in open_fields({}, FILE):
        if not entry.typed:
            words = entry.source.split()[1:]
            options = [word for word in words if word.startswith("--")]
            with pytest.raises(SystemExit) as ended:
                run([*words[: words.index(options[0])], "--help"])
            assert ended.value.code == 0
            shown = capsys.readouterr().out
            assert all(option in shown for option in options), entry.source


def test_nails_of_a_list_give_their_own_place() -> None:
    said = yaml.safe_load((LAB.parent / "nails.yaml").read_text())
    asked = {question.name for question in open_questions(said)}
    assert "work.nail_xy" not in asked
    assert "work.nail_length" in asked

"""`toolee station` from outside: an interview to a whole file, what is missing, and the picture on its page."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml

from tests.rigs.camera_rig import plug_in
from toolee_robot.cli.app import run
from toolee_robot.sim_backend.devices.software_realsense import COLOR, SERIAL, SoftwareRealSense
from toolee_robot.station import load_lab_station
from toolee_robot.stations.template import INTRINSICS, get, open_questions, put, template
from toolee_robot.viewer.station_view import named_frames

LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"
TOOLEE = [sys.executable, "-c", "from toolee_robot.cli import main; main()"]


def _answers(said: dict[str, Any]) -> list[str]:
    data: dict[str, Any] = {}
    lines = []
    while open_ones := open_questions(data):
        value = get(said, open_ones[0].name)
        lines.append(" ".join(map(str, value)) if isinstance(value, list) else "none" if value is None else str(value))
        put(data, open_ones[0].name, value)
    return lines


class Told(NamedTuple):
    """How an interview ended."""

    code: int
    out: str
    err: str


Interview = Callable[[Path, list[str]], Told]


@pytest.fixture
def interview(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Interview:
    """An interview that is given these lines, and then nothing more."""

    def ask(path: Path, lines: list[str]) -> Told:
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines)))
        return Told(run(["station", "new", str(path), "--ask"]), *capsys.readouterr())

    return ask


def test_a_template_has_just_the_fields_that_apply_and_check_lists_what_is_empty(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.yaml"
    chosen = ["--arm", "UR10e", "--hand", "inspire", "--camera", "realsense"]
    assert run(["station", "new", str(path), *chosen]) == 0
    text = path.read_text()
    assert "  model: UR10e\n" in text
    assert "  model: inspire_rh56\n" in text
    assert "# Radius of the head. [number, 0.005 to 0.1 m]\n  head_radius:\n" in text
    assert "hand.mount" not in text
    assert "folder:" not in text
    capsys.readouterr()
    assert run(["station", "check", str(path)]) == 2
    told = capsys.readouterr().err
    assert "  hand.mounting: position, fingers, thumb" in told
    assert told.index("tool_envelope: head_radius") < told.index("toolee calibrate camera --station")
    assert run(["station", "new", str(path), *chosen]) == 2
    assert "already exists" in capsys.readouterr().err
    for wrong in (["--arm", "UR5"], ["--arm", "UR10e"]):
        assert run(["station", "new", str(tmp_path / "other.yaml"), *wrong]) == 2


def test_an_interview_that_breaks_off_loses_nothing_and_goes_on_later(tmp_path: Path, interview: Interview) -> None:
    path, lines = tmp_path / "lab.yaml", _answers(yaml.safe_load(LAB.read_text()))
    millimetres = lines.index("0.95 -0.62 0.85")
    first = interview(path, [*lines[:millimetres], "950 -620 850"])
    assert first.code == 1
    assert "that looks like millimetres" in first.out
    open_ones = first.out[first.out.index("Still open") :].splitlines()
    assert "  camera: position, target  (tape measure)" in open_ones
    assert not any(line.lstrip().startswith(("arm: host", "hand")) for line in open_ones), "these were answered"
    assert yaml.safe_load(path.read_text())["arm"] == {
        "model": "UR10", "up": [0, 0, 1], "host": "192.168.1.10",
    }  # fmt: skip
    second = interview(path, lines[millimetres:])
    assert second.code == 0, second.out
    assert "no RealSense with serial number 832112070123 is connected" in " ".join(second.out.split())
    assert load_lab_station(path).tool == load_lab_station(LAB).tool


def test_an_answer_that_contradicts_another_is_refused(tmp_path: Path, interview: Interview) -> None:
    path, said = tmp_path / "lab.yaml", yaml.safe_load(LAB.read_text())
    said["person"]["door_open_input"] = said["person"]["door_closed_input"]
    told = interview(path, _answers(said))
    assert told.code == 1
    assert "name one input twice" in told.out


def test_a_place_that_is_typed_in_the_other_frame_of_the_base_is_noticed_at_the_end(
    tmp_path: Path, interview: Interview
) -> None:
    path, said = tmp_path / "lab.yaml", yaml.safe_load(LAB.read_text())
    said["work"]["nail_xy"] = [-0.75, -0.10]  # as the pendant shows it
    told = interview(path, _answers(said))
    assert told.code == 0, told.out
    assert "work.nail_xy: behind the arm at home, by about half a turn" in told.out


def test_a_file_that_a_person_edited_is_not_written_by_the_interview(tmp_path: Path, interview: Interview) -> None:
    path = tmp_path / "lab.yaml"
    path.write_bytes(LAB.read_bytes())
    told = interview(path, [])
    assert told.code == 2
    assert "was edited by hand, so no command edits it" in " ".join(told.err.split())
    assert path.read_bytes() == LAB.read_bytes(), "its comments, too"


def test_enter_gives_the_answer_that_is_offered_and_an_answer_can_be_taken_back(
    tmp_path: Path, interview: Interview
) -> None:
    path, said = tmp_path / "lab.yaml", yaml.safe_load(LAB.read_text())
    for section in ("servo", "calibration"):
        del said[section]
    del said["scene"]["obstacles"], said["work"]["block_xy"], said["arm"]["host"], said["strike"]
    path.write_text(template(said))
    back = interview(path, ["192.168.1.10", "<"])
    assert "Saved in" in back.out
    assert path.read_text() == template(said)
    told = interview(path, ["192.168.1.10", "", "", ""])
    assert told.code == 0, told.out
    assert "(Enter: 0.4)" in told.out
    assert "with defaults: scene.obstacles, arm.acceleration, supervisor.unattended_speed." in told.out
    after = load_lab_station(path)
    assert (after.work.block_xy, after.arm.host, after.strike.speed) == (None, "192.168.1.10", 0.4)


@pytest.fixture
def realsense(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A RealSense as software, with one mode, which the driver finds."""
    with SoftwareRealSense(pytest.importorskip("pyrealsense2", exc_type=ImportError)) as found:
        plug_in(monkeypatch, found.devices)
        yield


@pytest.mark.realtime
@pytest.mark.usefixtures("realsense")
def test_a_realsense_tells_its_intrinsics_in_the_mode_that_is_asked_for_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path, said = tmp_path / "lab.yaml", yaml.safe_load(LAB.read_text())
    for name in INTRINSICS:
        del said["camera"][name]
    for section in ("servo", "calibration"):
        del said[section]
    del said["scene"]["obstacles"]
    assert said["camera"]["device"]["serial"] == SERIAL
    path.write_text(template(said))
    assert [field.name for field in open_questions(said)][:2] == ["camera.width", "camera.height"]

    def answer(*lines: str) -> str:
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines)))
        run(["station", "new", str(path), "--ask"])
        return " ".join(capsys.readouterr().out.split())

    told = answer("", "")
    assert "without camera.width and camera.height" in told
    told = answer(str(COLOR.width), "242", "<", str(COLOR.height))
    assert "424x240" in told, "another size is refused with the modes that there are"
    assert "the camera reports 424x240" in told
    k = yaml.safe_load(path.read_text())["camera"]
    assert {name: k[name] for name in INTRINSICS} == pytest.approx({n: getattr(COLOR, n) for n in INTRINSICS}, abs=1e-3)


def test_an_interview_says_at_once_where_it_cannot_write(tmp_path: Path, interview: Interview) -> None:
    told = interview(tmp_path / "nowhere" / "lab.yaml", ["base_link"])
    assert told.code == 2
    assert "nowhere" in told.err
    assert "Frame of the positions" not in told.out


def test_what_a_job_needs_is_named_before_any_device_is_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = yaml.safe_load(LAB.read_text())
    del said["tool"], said["calibration"]
    path = tmp_path / "lab.yaml"
    path.write_text(yaml.safe_dump(said))
    assert run(["run", "hammer", str(path)]) == 2
    assert "give calibration, tool;" in " ".join(capsys.readouterr().err.split())
    assert run(["station", "check", str(path)]) == 2
    told = capsys.readouterr().err
    assert "  tool: name, grip_radius, face, face_normal, mass, center_of_mass  (ruler and scales)" in told
    assert f"toolee calibrate camera --station {path} --bars-mm" in told
    del said["work"]["nail_xy"]
    path.write_text(yaml.safe_dump(said))
    assert run(["rehearse", "hammer", str(path)]) == 2
    assert "Measure and give work.nail_xy" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["calibrate", "camera", "--station", str(LAB)], "Measure the two scale bars"),
        (["calibrate", "camera", "--station", str(LAB), "--bars-mm", "360", "257"], "--plate-distance"),
        (["calibrate", "camera", "--station", str(LAB), "--rehearse", "--images", "x"], "not both"),
        (["calibrate", "camera", "--station", str(LAB), "--rehearse", "--bars-mm", "1", "2"], "with --rehearse"),
        (["calibrate", "camera", "--station", str(LAB), "--rehearse", "--write"], "gives a calibration by hand"),
        (["calibrate", "nail", "--station", str(LAB), "--rehearse", "--write"], "leave --write out"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    command: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(command) == 2
    assert words in " ".join(capsys.readouterr().err.split())


@pytest.mark.nightly
@pytest.mark.sim(seconds=10)
def test_the_picture_is_served_until_it_is_interrupted(tmp_path: Path) -> None:
    show = subprocess.Popen(
        [*TOOLEE, "station", "show", str(LAB), "--port", "8231"],
        stdout=subprocess.PIPE, text=True, cwd=tmp_path, env={**os.environ, "COLUMNS": "200"},
    )  # fmt: skip
    assert show.stdout is not None
    try:
        address = show.stdout.readline().split()[1]
        assert address.startswith("http://127.0.0.1:"), "for this computer alone"
        with urllib.request.urlopen(address) as page:
            assert b"<html" in page.read(2000)
    finally:
        show.send_signal(signal.SIGINT)
    assert show.wait(timeout=20) == 0


def test_the_pictures_frames_are_the_files() -> None:
    frames = named_frames(load_lab_station(LAB))
    np.testing.assert_allclose(frames["pendant_base"], np.diag([-1.0, -1.0, 1.0, 1.0]))
    np.testing.assert_allclose(frames["camera"][:3, 3], [0.95, -0.62, 0.85])
    np.testing.assert_allclose(frames["nail"][:3, 3], [0.75, 0.10, 0.28])
    towards = np.array([0.60, -0.15, 0.72]) - frames["camera"][:3, 3]
    np.testing.assert_allclose(frames["camera"][:3, 2], towards / np.linalg.norm(towards))

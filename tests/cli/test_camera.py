"""`toolee camera` and `toolee devices`: on a recording, and what is refused."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import cv2
import pytest
import yaml

from tests.devices.cameras.test_recording import INTRINSICS, SERIAL, say_undistorted, toy_recording
from toolee_robot.cli.app import EXIT_FAILED, EXIT_USER, run
from toolee_robot.devices.cameras.recording import open_recording
from toolee_robot.doctor.devices import check_lens
from toolee_robot.findings import Finding, Level
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import load_station
from toolee_robot.stations.camera import open_camera

LENS = (-0.2, 0.0, 0.0, 0.0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    toy_recording(tmp_path / "r", 90)
    return tmp_path / "r"


def station(path: Path, folder: Path, **device: object) -> Path:
    k = INTRINSICS
    given = {"driver": "recorded", "serial": SERIAL, "least_range": 0.2, "folder": str(folder), **device}
    size = {"fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy, "width": k.width, "height": k.height}
    path.write_text(yaml.safe_dump({"version": 3, "camera": {**size, "device": given}}))
    return path


@pytest.mark.realtime
def test_show_prints_what_the_station_file_needs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = folder.parent / "seen.png"
    assert run(["camera", "show", "--recording", str(folder), "--picture", str(picture)]) == 0
    out = capsys.readouterr().out
    text = out[out.index("camera:") : out.index("\n\nWritten")]
    told = yaml.safe_load(text)["camera"]
    assert told["fx"] == INTRINSICS.fx
    assert (told["width"], told["height"]) == (96, 72)
    assert told["device"]["serial"] == SERIAL
    assert told["device"]["least_range"] is None, "nobody but the lab knows it"
    seen = cv2.imread(str(picture))
    assert seen is not None
    assert seen.shape == (72, 192, 3)


@pytest.mark.realtime(light=True)
def test_record_writes_what_can_be_played(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folder.parent / "again"
    config = station(folder.parent / "lab.yaml", folder)
    command = ["camera", "record", "--station", str(config), "--out", str(out), "--seconds", "0.7", "--json"]
    assert run(command) == 0
    told = json.loads(capsys.readouterr().out)
    recording = open_recording(out)
    assert told["frames"] == len(recording.stamps) >= 10
    assert recording.serial == SERIAL
    assert recording.intrinsics == INTRINSICS
    assert run(command) == EXIT_USER, "never over another recording"
    seldom = ["--out", str(out.with_name("seldom")), "--seconds", "1.2", "--every", "0.5", "--json"]
    assert run([*command[:4], *seldom]) == 0
    capsys.readouterr()
    stamps = open_recording(out.with_name("seldom")).stamps
    assert 2 <= len(stamps) <= 3
    assert all(b - a >= 0.5 for a, b in itertools.pairwise(stamps))


def lens_of(config: Path) -> Finding:
    """What the station's doctor says of the lens."""
    with open_camera(load_station(config).camera, HostClock()) as camera:
        return check_lens(camera)


@pytest.mark.realtime(light=True)
def test_a_lens_that_nobody_knows_is_said_until_the_file_states_it(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As of a driver that does not tell it: a recording of a camera whose lens was not known."""
    say_undistorted(folder, False)
    config = station(folder.parent / "lab.yaml", folder)
    show = ["camera", "show", "--station", str(config)]
    lens = lens_of(config)
    assert lens.level is Level.WARN
    assert "camera.distortion" in lens.remedy
    assert run(show) == 0
    shown = capsys.readouterr().out
    assert "treated as a pinhole" in shown
    assert "  distortion:  " in shown, "to be filled in"
    said = yaml.safe_load(config.read_text())
    said["camera"]["distortion"] = [-0.2, 0.0, 0.0, 0.0]
    config.write_text(yaml.safe_dump(said))
    lens = lens_of(config)
    assert lens.level is Level.OK
    assert "the station file's, brown conrady: displaces pixels by up to " in lens.message
    assert run([*show, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["distortion"]
    assert told["coefficients"] == [-0.2, 0.0, 0.0, 0.0]
    assert 4.0 < told["largest_displacement"] < 9.0


def refused(state: str, config: Path, folder: Path) -> str:
    """Let a station file state a lens that a job refuses; returns words of the reason."""
    say_undistorted(folder, {"recording": True, "unsaid": None}.get(state, False))
    said = yaml.safe_load(config.read_text())
    said["camera"]["distortion"] = list(LENS)
    wrong: dict[str, dict[str, float]] = {
        "size": {"width": 128},
        "camera": {"fx": 140.0},
        "recording": {"fx": INTRINSICS.fx + 0.1},
    }
    said["camera"] |= wrong.get(state, {})
    config.write_text(yaml.safe_dump(said))
    return {
        "size": "96x72, those of the station file 128x72",
        "camera": "another camera or mode",
        "recording": "record again with this file",
        "unsaid": "add `undistorted: true` or `false`",
    }[state]


@pytest.mark.realtime(light=True)
@pytest.mark.parametrize("state", ["size", "camera", "recording", "unsaid"])
def test_a_lens_that_is_refused_keeps_nobody_from_looking_and_what_show_prints_is_accepted(
    state: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, picture = station(folder.parent / "lab.yaml", folder), folder.parent / "seen.png"
    reason = refused(state, config, folder)
    record = ["camera", "record", "--station", str(config), "--seconds", "0.3", "--out"]
    assert run([*record, str(folder.parent / "refused")]) in (EXIT_FAILED, EXIT_USER)
    assert reason in " ".join(capsys.readouterr().err.split())
    assert run(["camera", "show", "--station", str(config), "--picture", str(picture)]) == 0
    out = capsys.readouterr().out
    assert reason in " ".join(out.split())
    assert picture.is_file()
    said = yaml.safe_load(config.read_text())
    lens = yaml.safe_load(out[out.index("camera:\n") : out.index("\n\nWritten")])["camera"]
    del lens["device"]
    kept = {name: said["camera"][name] for name in said["camera"] if name != "distortion"}
    config.write_text(yaml.safe_dump({**said, "camera": {**kept, **lens}}))
    assert run([*record, str(folder.parent / "accepted")]) == 0


@pytest.mark.realtime(light=True)
def test_a_recording_is_not_undistorted_again_by_the_lens_of_then(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, out = station(folder.parent / "lab.yaml", folder), folder.parent / "again"
    said = yaml.safe_load(config.read_text())
    said["camera"]["distortion"] = list(LENS)
    config.write_text(yaml.safe_dump(said))
    assert run(["camera", "show", "--station", str(config)]) == 0
    shown = capsys.readouterr().out
    assert "undistorted when it was recorded" in shown
    assert yaml.safe_load(shown[shown.index("camera:") :])["camera"]["distortion"] == list(LENS)
    assert run(["camera", "record", "--station", str(config), "--out", str(out), "--seconds", "0.5"]) == 0
    played, again = open_recording(folder), open_recording(out)
    assert again.undistorted is True
    originals = {played.read(n)[0].tobytes() for n in range(len(played.stamps))}
    assert {again.read(n)[0].tobytes() for n in range(len(again.stamps))} <= originals, "pixel by pixel"


@pytest.mark.realtime(light=True)
def test_a_recording_that_does_not_say_whether_it_is_undistorted_takes_no_lens(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As those of an earlier version, some of which were."""
    say_undistorted(folder, None)
    config, out = station(folder.parent / "lab.yaml", folder), folder.parent / "again"
    lens = lens_of(config)
    assert lens.level is Level.WARN
    assert "recording.json" in lens.remedy
    assert run(["camera", "record", "--station", str(config), "--out", str(out), "--seconds", "0.5"]) == 0
    assert open_recording(out).undistorted is None, "recorded again it does not say, either"
    said = yaml.safe_load(config.read_text())
    said["camera"]["distortion"] = [-0.2, 0.0, 0.0, 0.0]
    config.write_text(yaml.safe_dump(said))
    show = ["camera", "show", "--station", str(config)]
    capsys.readouterr()
    for undistorted, words in (
        (True, "undistorted when it was recorded"),
        (False, "the station file's, brown conrady"),
    ):
        say_undistorted(folder, undistorted)
        assert run(show) == 0
        assert words in capsys.readouterr().out


@pytest.mark.realtime
def test_the_stations_doctor_asks_the_camera_too(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = station(folder.parent / "lab.yaml", folder)
    run(["doctor", "--station", str(config), "--robot-host", "127.0.0.77", "--json"])
    told = json.loads(capsys.readouterr().out)
    levels = {f["name"]: f["level"] for f in told["findings"] if f["section"] != "Station file"}
    assert levels["camera"] == levels["exposure"] == levels["lens"] == "ok"


def test_list_and_devices(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["camera", "list", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {"realsense", "recorded"} <= set(told["drivers"])
    assert run(["devices", "list", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["camera"]["realsense"] == "toolee_robot"
    assert "inspire_rh56" in told["hand"]


@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--driver", "realsense"],
        ["--driver", "realsense", "--serial", "1", "--recording", "r"],
        ["--recording", "no_such_folder"],
        ["--driver", "kinect", "--serial", "1"],
    ],
)
def test_which_camera_is_not_guessed(options: list[str]) -> None:
    assert run(["camera", "show", *options]) == EXIT_USER

"""`toolee camera show --json` before a camera that tells its lens, and a station file whose lens is refused."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.rigs.camera_rig import plug_in
from toolee_robot.cli.app import EXIT_FAILED, EXIT_USER, run
from toolee_robot.sim_backend.devices.software_realsense import COEFFICIENTS, COLOR, SERIAL, SoftwareRealSense

rs: Any = pytest.importorskip("pyrealsense2", exc_type=ImportError)

pytestmark = pytest.mark.realtime(light=True)

OTHER = [-0.06, *COEFFICIENTS[1:]]


@pytest.fixture(autouse=True)
def plugged_in(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A RealSense whose lens has OpenCV's model."""
    with SoftwareRealSense(rs, rs.distortion.brown_conrady) as emulated:
        plug_in(monkeypatch, emulated.devices)
        yield


def station(path: Path, lens: Mapping[str, object], serial: str = SERIAL) -> Path:
    """A station file; `lens` takes the place of the camera's own pinhole model."""
    k = COLOR
    own = {"fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy, "width": k.width, "height": k.height}
    device = {"driver": "realsense", "serial": serial, "least_range": 0.2, "exposure": 0.008}
    path.write_text(yaml.safe_dump({"version": 3, "camera": {**own, **lens, "device": device}}))
    return path


def shown(capsys: pytest.CaptureFixture[str], *options: str) -> tuple[dict[str, Any], str]:
    """What it tells programs, and people."""
    assert run(["camera", "show", *options, "--json"]) == 0
    out, err = capsys.readouterr()
    assert out.count("\n") == 1, "one line, and nothing for people"
    return json.loads(out), err


def entered(told: str) -> dict[str, Any]:
    """The section that people are told to enter."""
    section: dict[str, Any] = yaml.safe_load(told[told.index("camera:\n") :])["camera"]
    return section


def test_it_tells_what_the_camera_is_and_its_own_lens(capsys: pytest.CaptureFixture[str]) -> None:
    size = ["--size", str(COLOR.width), str(COLOR.height)]
    told, people = shown(capsys, "--driver", "realsense", "--serial", SERIAL, *size)
    assert (told["serial"], told["firmware"]) == (SERIAL, "5.16.0.1")
    assert "D435" in told["model"]
    assert told["image"] == "424x240 at 30 Hz"
    assert told["depth"] == "424x240, registered to the colour here"
    assert told["exposure"] == "automatic"
    assert told["intrinsics"] == pytest.approx(
        {"fx": COLOR.fx, "fy": COLOR.fy, "cx": COLOR.cx, "cy": COLOR.cy, "width": 424, "height": 240}, abs=1e-3
    )
    lens = told["distortion"]
    assert (lens["model"], lens["from"]) == ("brown_conrady", "the camera's own")
    assert lens["coefficients"] == pytest.approx(COEFFICIENTS, abs=1e-6)
    assert 1.0 < lens["largest_displacement"] < 10.0
    assert f"up to {lens['largest_displacement']:.1f} px" in told["lens"]
    assert 0.5 < told["known_depth"] <= 1.0
    assert told["refused_lens"] is None
    assert told["lens"] in " ".join(people.split())
    section = entered(people)
    assert section["fx"] == pytest.approx(COLOR.fx, abs=1e-3)
    assert "distortion" not in section, "the camera tells it"


@pytest.mark.parametrize(
    ("name", "lens"),
    [
        ("none", {"distortion": [0.0] * 4}),
        ("another", {"distortion": OTHER}),
        ("far", {"fx": 1.5 * COLOR.fx, "fy": 1.5 * COLOR.fy, "distortion": list(COEFFICIENTS)}),
    ],
)
def test_a_distortion_that_is_not_the_cameras_own_is_refused_and_the_cameras_own_is_taken(
    name: str, lens: dict[str, object], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = station(tmp_path / "lab.yaml", lens)
    told, people = shown(capsys, "--station", str(path))
    words = (
        "the camera's intrinsics are" if name == "far" else "camera.distortion of the station file is not the camera's"
    )
    assert words in told["refused_lens"]
    assert told["refused_lens"] in " ".join(people.split())
    assert "Shown without the station file's lens. A job refuses it" in people
    assert told["distortion"]["from"] == "the camera's own"
    assert told["distortion"]["coefficients"] == pytest.approx(COEFFICIENTS, abs=1e-6)
    assert told["intrinsics"]["fx"] == pytest.approx(COLOR.fx, abs=1e-3)
    section = entered(people)
    assert "distortion" not in section
    del section["device"]
    again, _ = shown(capsys, "--station", str(station(path, section)))
    assert again["refused_lens"] is None, "what it prints opens the camera"
    # Nothing but `show` looks past it.
    station(path, lens)
    record = ["camera", "record", "--station", str(path), "--out", str(tmp_path / "r"), "--seconds", "0.2"]
    assert run(record) == EXIT_FAILED
    assert words in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "r").exists()


def test_a_distortion_that_is_the_cameras_own_is_not_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rounded = [round(value, 5) for value in COEFFICIENTS]
    told, people = shown(capsys, "--station", str(station(tmp_path / "lab.yaml", {"distortion": rounded})))
    assert told["refused_lens"] is None
    assert told["distortion"]["from"] == "the camera's own"
    assert entered(people)["distortion"] == rounded, "what the file has and holds stays"


def test_coefficients_that_are_no_lenss_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = station(tmp_path / "lab.yaml", {"distortion": [-9.0, 40.0, 0.0, 0.0]})
    told, _ = shown(capsys, "--station", str(path))
    assert "the distortion coefficients are wrong" in told["refused_lens"]
    assert told["distortion"]["from"] == "the camera's own"


def test_what_is_no_refused_lens_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = station(tmp_path / "lab.yaml", {"distortion": OTHER}, serial="1")
    assert run(["camera", "show", "--station", str(other), "--json"]) == EXIT_FAILED
    out, err = capsys.readouterr()
    assert json.loads(out)["error"]["code"] == "no_answer.camera_missing"
    assert "no RealSense with serial number 1" in " ".join(err.split())
    mistyped = station(tmp_path / "lab.yaml", {"distortion": [0.1]})
    assert run(["camera", "show", "--station", str(mistyped), "--json"]) == EXIT_USER

"""The record of intrinsics in a station file: what it gives, what it contradicts, and how it is entered."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from tests.calibration.pictures import BOARD, CAMERA, picture
from tests.devices.cameras.toy_recording import say_undistorted, toy_recording
from tests.errors import raises
from toolee_robot.app.calibrate_intrinsics import camera_of
from toolee_robot.calibration.record import INTRINSICS_FORMAT, IntrinsicsRecord, read_intrinsics, write_record
from toolee_robot.cli.app import EXIT_USER, run
from toolee_robot.devices.cameras import Lens, LensModel
from toolee_robot.errors import ConfigError
from toolee_robot.frames import transform
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import SIMULATED, load_lab_station, load_station
from toolee_robot.stations.camera import open_camera
from toolee_robot.stations.template import open_questions

LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"
SERIAL = "832112070123"
DISTORTION = (0.09, -0.18, 7e-4, -4e-4)
PINHOLE = ("fx", "fy", "cx", "cy", "width", "height")


def record(serial: str = SERIAL) -> IntrinsicsRecord:
    k = replace(CAMERA.intrinsics, fx=383.2, fy=383.2, cx=319.1, cy=241.6, width=640, height=480)
    return IntrinsicsRecord(
        INTRINSICS_FORMAT, "2026-11-28T00:00:00+00:00", "0", serial,
        BOARD, k, DISTORTION, (0.1,) * 4, (1e-4,) * 4, 0.1, 0.1, 5.0,
        0.9, 30,
    )  # fmt: skip


def lab(folder: Path, serial: str = SERIAL, **camera: Any) -> Path:
    """A lab's file that names the record, with some fields of its own."""
    write_record(folder / "intrinsics.json", record(serial))
    said = yaml.safe_load(LAB.read_text())
    said["camera"] = {name: value for name, value in said["camera"].items() if name not in PINHOLE}
    said["camera"] |= {"intrinsics": "intrinsics.json", **camera}
    path = folder / "lab.yaml"
    path.write_text(yaml.safe_dump(said))
    return path


def test_the_record_gives_what_the_file_leaves_out(tmp_path: Path) -> None:
    path = lab(tmp_path)
    camera = load_lab_station(path).camera
    assert camera.intrinsics == record().intrinsics
    assert (camera.distortion, camera.lens_serial) == (DISTORTION, SERIAL)
    asked = {question.name for question in open_questions(yaml.safe_load(path.read_text()))}
    assert not asked & {f"camera.{name}" for name in (*PINHOLE, "distortion")}


def test_numbers_of_the_file_must_be_the_records(tmp_path: Path) -> None:
    rounded: dict[str, Any] = {"fx": 383.2, "distortion": [round(v, 4) for v in DISTORTION]}
    assert load_station(lab(tmp_path, **rounded)).camera.distortion == DISTORTION
    wrong: list[dict[str, Any]] = [{"fx": 383.3}, {"width": 848}, {"distortion": [0.0] * 4}, {"distortion": "none"}]
    for camera in wrong:
        with raises(ConfigError, "config.intrinsics_twice") as error:
            load_station(lab(tmp_path, **camera))
        assert next(iter(camera)) in str(error.value)


def test_a_record_of_another_camera_and_a_rehearsed_one_are_refused(tmp_path: Path) -> None:
    with raises(ConfigError, "config.intrinsics_serial") as error:
        load_station(lab(tmp_path, "F1370001"))
    assert "toolee calibrate intrinsics" in str(error.value)
    rehearsed = load_station(lab(tmp_path, SIMULATED)).camera
    with raises(ConfigError, "config.intrinsics_rehearsed"):
        open_camera(rehearsed, HostClock())
    with raises(ConfigError, "config.invalid"):
        load_station(lab(tmp_path, lens_serial=SERIAL))


@pytest.mark.parametrize(
    ("distortion", "words"),
    [
        ([0.1, -0.2, 0.001], "3 numbers"),
        ([0.1, -0.2, 0.07, 0.001, 0.001], "in the order k1, k2, p1, p2, k3"),
        (0.1, "distortion"),
    ],
)
def test_what_is_no_distortion_is_said(tmp_path: Path, distortion: Any, words: str) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(yaml.safe_dump({"camera": {"distortion": distortion}}))
    with raises(ConfigError, "config.invalid") as error:
        load_station(path)
    assert words in str(error.value)


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Images of a board through a lens that displaces by some 5 px."""
    folder, rng = tmp_path_factory.mktemp("views"), np.random.default_rng(5)
    x, y = Lens(CAMERA.intrinsics, LensModel.BROWN_CONRADY, (0.04, 0.0, 0.0, 0.0)).rays()
    k = CAMERA.intrinsics
    u, v = (x * k.fx + k.cx).astype(np.float32), (y * k.fy + k.cy).astype(np.float32)
    for number in range(26):
        R = Rotation.from_rotvec([*rng.uniform(-0.7, 0.7, 2), 0.0]) * Rotation.from_rotvec([0, 0, rng.uniform(-1, 1)])
        center = rng.uniform(0.36, 0.6) * np.array([rng.uniform(-0.32, 0.32), rng.uniform(-0.26, 0.26), 1.0])
        image = picture(BOARD, transform(R, center - R.as_matrix() @ BOARD.center))
        cv2.imwrite(str(folder / f"{number:03d}.png"), cv2.remap(image, u, v, cv2.INTER_CUBIC))
    return folder


def test_write_enters_the_record_and_corrects_what_the_file_gives(
    views: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = yaml.safe_load(LAB.read_text())
    said["camera"] |= {"width": CAMERA.width, "height": CAMERA.height}
    path = tmp_path / "lab.yaml"
    path.write_text(yaml.safe_dump(said))
    bars = [f"{1e3 * length:.1f}" for length in BOARD.size]
    command = ["calibrate", "intrinsics", "--images", str(views), "--station", str(path), "--bars-mm", *bars]
    command += ["--out", str(tmp_path / "of the lens.json"), "--write"]
    assert run(command) == EXIT_USER, "the place of the camera was calibrated with other intrinsics"
    assert "Delete its section `calibration`" in " ".join(capsys.readouterr().err.split())
    del said["calibration"]
    path.write_text(yaml.safe_dump(said))
    assert run(command) == 0
    found = read_intrinsics(tmp_path / "of the lens.json")
    assert found.camera_serial == SERIAL, "the file tells it"
    assert found.distortion[0] == pytest.approx(0.04, abs=0.01)
    assert yaml.safe_load(path.read_text()) == said, "no program edits a person's file"
    measured = yaml.safe_load((tmp_path / "measured.yaml").read_text())
    assert measured["camera"] == {"intrinsics": "of the lens.json"}
    camera = load_lab_station(path).camera
    assert (camera.intrinsics, camera.distortion) == (found.intrinsics, found.distortion)
    assert run(command) == 0, "measured again"
    altered = tmp_path / "of the lens.json"
    altered.write_text(altered.read_text().replace(SERIAL, "F1370001"))
    with raises(ConfigError, "config.calibration_altered"):
        load_lab_station(path)
    assert run(command) == 0, "an altered record is replaced"
    assert load_lab_station(path).camera.intrinsics == read_intrinsics(altered).intrinsics


def test_a_lost_record_does_not_keep_the_camera_from_being_measured_again(tmp_path: Path) -> None:
    path = lab(tmp_path, width=640, height=480)
    assert camera_of(path).fx == 383.2, "the record's"
    (tmp_path / "intrinsics.json").unlink()
    camera = camera_of(path)
    assert (camera.width, camera.height) == (640, 480)
    assert camera.device is not None
    path = lab(tmp_path)
    (tmp_path / "intrinsics.json").unlink()
    with raises(ConfigError, "config.unmeasured") as error:
        camera_of(path)
    assert "give camera.width and camera.height" in str(error.value)
    assert "intrinsics.json" in str(error.value), "which gave them"


@pytest.mark.parametrize("typed", [{"fx": 400.1}, {"cy": 241.6}, {"distortion": list(DISTORTION)}])
def test_a_rehearsal_writes_over_no_number_of_a_real_camera(
    typed: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = yaml.safe_load(LAB.read_text())
    del said["calibration"]
    said["camera"] = {name: value for name, value in said["camera"].items() if name not in PINHOLE}
    said["camera"] |= {"width": 640, "height": 480, **typed}
    path = tmp_path / "lab.yaml"
    path.write_text(yaml.safe_dump(said))
    before = path.read_bytes()
    out = tmp_path / "intrinsics.json"
    assert (
        run(["calibrate", "intrinsics", "--station", str(path), "--rehearse", "--write", "--out", str(out)])
        == EXIT_USER
    )
    told = " ".join(capsys.readouterr().err.split())
    assert f"gives camera.{next(iter(typed))}, which a rehearsal must not replace" in told
    assert path.read_bytes() == before
    assert not out.exists(), "nothing was measured"


@pytest.mark.parametrize("lost", [False, True])
def test_a_rehearsal_replaces_no_record_of_a_real_camera(
    lost: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = lab(tmp_path, width=640, height=480)
    path.write_text(yaml.safe_dump({n: v for n, v in yaml.safe_load(path.read_text()).items() if n != "calibration"}))
    if lost:
        (tmp_path / "intrinsics.json").unlink()
    command = ["calibrate", "intrinsics", "--station", str(path), "--rehearse", "--write"]
    assert run([*command, "--out", str(tmp_path / "other.json")]) == EXIT_USER
    assert "a copy of the file without camera.intrinsics" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "other.json").exists()


def test_images_that_were_undistorted_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    toy_recording(tmp_path / "r", 2)
    for images in (tmp_path / "r", tmp_path / "r" / "rgb"):
        options = ["--images", str(images), "--camera-serial", "7", "--bars-mm", "360", "257"]
        for undistorted, words in (
            (True, "whose images are undistorted"),
            (None, "add `undistorted: false` to its recording.json"),
            (False, "images"),
        ):
            say_undistorted(tmp_path / "r", undistorted)
            assert run(["calibrate", "intrinsics", *options]) == EXIT_USER
            told = " ".join(capsys.readouterr().err.split())
            assert words in told
            assert ("is a recording" in told) == (undistorted is not False), "raw images are looked at"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "give --station"),
        (["--images", "views"], "--camera-serial is missing"),
        (["--images", "views", "--camera-serial", "7"], "Measure the two scale bars"),
        (["--station", str(LAB)], "Measure the two scale bars"),
        (["--station", str(LAB), "--rehearse", "--bars-mm", "360", "257"], "the emulated person measures"),
        (["--rehearse"], "give --station"),
        (["--station", str(LAB), "--rehearse", "--images", "views"], "give --rehearse with --station alone"),
        (["--station", str(LAB), "--rehearse", "--write"], "Delete its section `calibration`"),
        (["--images", "v", "--camera-serial", "7", "--bars-mm", "360", "257", "--write"], "--write needs --station"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["calibrate", "intrinsics", *options]) == EXIT_USER
    assert words in " ".join(capsys.readouterr().err.split())

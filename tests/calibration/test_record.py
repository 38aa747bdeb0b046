"""From a folder of images to a signed record, the station file that names it, and the touch test."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from tests.calibration.pictures import BOARD, CAMERA, draw_session, picture
from tests.devices.cameras.test_recording import say_undistorted, toy_recording
from tests.errors import raises
from toolee_robot.calibration.observation import find_board
from toolee_robot.calibration.record import SIGNATURE, read_record, write_record, write_signed
from toolee_robot.calibration.touches import see_corner
from toolee_robot.cli.app import run
from toolee_robot.errors import ConfigError, UserError
from toolee_robot.frames import HALF_TURN, BaseFrame, transform, transform_points
from toolee_robot.station import REHEARSED, SIMULATED, SIMULATED_CALIBRATION, load_station

LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"
BARS = [f"{length * 1e3:.4f}" for length in BOARD.size]
STATION = "version: 3\nframe: base_link\ncamera: {position: [0.93, -0.60, 0.86], target: [0.61, -0.17, 0.7]}\n"


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a calibration from images, poses in the pendant's Base."""
    folder = tmp_path_factory.mktemp("calibration")
    draw_session(folder, 12, BaseFrame.PENDANT_BASE, lambda X: HALF_TURN @ X)
    (folder / "lab.yaml").write_text(STATION)
    code = run(["calibrate", "camera", "--images", str(folder), "--station", str(folder / "lab.yaml"), "--bars-mm",
                *BARS, "--out", str(folder / "out")])  # fmt: skip
    assert code == 0
    (out,) = (folder / "out").iterdir()
    return out


def test_a_folder_of_images_gives_the_cameras_pose(calibrated: Path) -> None:
    record = read_record(calibrated / "camera.json")
    off = (record.pose - CAMERA.X_base_camera) @ [0.0, 0.0, 0.95, 1.0]
    assert np.linalg.norm(off) < 1e-3
    assert np.linalg.norm(off) < record.target_radius < 3e-3
    assert (record.robot_serial, record.camera_serial) == ("20185500001", "cam-7")
    assert record.board.square == pytest.approx(BOARD.square, rel=1e-5)
    assert len(record.poses) == 12


def test_a_record_that_was_altered_is_refused(calibrated: Path, tmp_path: Path) -> None:
    data = json.loads((calibrated / "camera.json").read_text())
    data["X_base_camera"][0][3] += 0.001
    (tmp_path / "camera.json").write_text(json.dumps(data))
    with raises(ConfigError, says="was altered since it was written"):
        read_record(tmp_path / "camera.json")


def test_a_signed_record_of_a_camera_that_cannot_be_is_refused(calibrated: Path, tmp_path: Path) -> None:
    data = json.loads((calibrated / "camera.json").read_text())
    del data[SIGNATURE]
    for x, words in ((1e308, "away"), (100.0, "away"), (0.5, "")):
        data["X_base_camera"][0][3] = x
        write_signed(tmp_path / "camera.json", data)
        if words:
            with raises(ConfigError) as refused:
                read_record(tmp_path / "camera.json")
            assert words in str(refused.value)
    assert read_record(tmp_path / "camera.json").pose[0, 3] == 0.5


@pytest.mark.parametrize(
    "change", [{"fx": -615.0}, {"width": 10**18}, {"cx": 1e308}, {"fy": 61.5}], ids=lambda change: next(iter(change))
)
def test_a_signed_record_with_intrinsics_of_no_camera_is_refused(
    change: dict[str, Any], calibrated: Path, tmp_path: Path
) -> None:
    data = json.loads((calibrated / "camera.json").read_text())
    del data[SIGNATURE]
    data["intrinsics"] |= change
    write_signed(tmp_path / "camera.json", data)
    with raises(ConfigError) as refused:
        read_record(tmp_path / "camera.json")
    assert next(iter(change)).replace("width", "fx") in str(refused.value)


def _station(folder: Path, calibrated: Path, more: str = "") -> Path:
    path = folder / "station.yaml"
    path.write_text(f"{STATION}{more}calibration: {{record: {calibrated / 'camera.json'}}}\n")
    return path


def test_a_station_file_takes_the_cameras_pose_from_the_record(calibrated: Path, tmp_path: Path) -> None:
    config = load_station(_station(tmp_path, calibrated))
    record = read_record(calibrated / "camera.json")
    np.testing.assert_array_equal(config.camera.X_base_camera, record.pose)
    assert config.camera.center == tuple(record.pose[:3, 3])
    assert config.camera.uncalibrated.center == (0.93, -0.60, 0.86), "where a simulated camera stands"
    assert config.calibration is not None
    assert config.calibration.residual == record.residual
    assert config.calibration.robot_serial == "20185500001"


def test_a_record_holds_instead_of_another_program_s_pose(calibrated: Path, tmp_path: Path) -> None:
    """Whose place is compared with the record's, under its own name."""
    path = _station(tmp_path, calibrated)
    whole = f"{{X_base_camera: {CAMERA.X_base_camera.tolist()}}}"
    path.write_text(path.read_text().replace("{position: [0.93, -0.60, 0.86], target: [0.61, -0.17, 0.7]}", whole))
    camera = load_station(path).camera
    np.testing.assert_array_equal(camera.X_base_camera, read_record(calibrated / "camera.json").pose)
    np.testing.assert_allclose(camera.uncalibrated.X_base_camera, CAMERA.X_base_camera, atol=1e-12)
    path.write_text(path.read_text().replace("frame: base_link", "frame: pendant_base"))
    with raises(ConfigError, says="half a turn") as error:
        load_station(path)
    assert "camera.X_base_camera" in str(error.value)


def test_a_rehearsal_does_not_take_the_place_of_a_real_record(
    calibrated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its board was drawn, and its camera stands where a tape measure put it."""
    said = yaml.safe_load((Path(__file__).parents[2] / "examples" / "lab.yaml").read_text())
    said["frame"] = "base_link"
    said["camera"] = {"device": said["camera"]["device"], **yaml.safe_load(STATION)["camera"]}
    intrinsics = read_record(calibrated / "camera.json").intrinsics
    said["camera"] |= {name: getattr(intrinsics, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
    said["calibration"] = {"record": str(calibrated / "camera.json")}
    path = tmp_path / "lab.yaml"
    path.write_text(yaml.safe_dump(said))
    before = path.read_bytes()
    assert run(["calibrate", "camera", "--station", str(path), "--rehearse", "--write"]) == 2
    assert "names the calibration of the real robot 20185500001" in " ".join(capsys.readouterr().err.split())
    assert path.read_bytes() == before


def test_what_was_rehearsed_holds_for_no_real_robot() -> None:
    rehearsed = replace(SIMULATED_CALIBRATION, camera_serial="cam-7")
    (problem,) = rehearsed.problems("20185500001", "cam-7", date(2026, 1, 2))
    assert "simulated or rehearsed" in problem
    assert rehearsed.problems(SIMULATED, "cam-7", date(2026, 1, 2)) == []
    (problem,) = replace(rehearsed, robot_serial=REHEARSED).problems("20185500001", "cam-7", date(2026, 1, 2))
    assert "simulated or rehearsed" in problem
    assert REHEARSED.isdigit(), "ur_rtde does not connect to an e-Series with another"


def test_a_record_does_not_hold_for_other_intrinsics(calibrated: Path, tmp_path: Path) -> None:
    path = _station(tmp_path, calibrated)
    path.write_text(path.read_text().replace("target:", "fx: 370.0, target:"))
    with pytest.raises(ConfigError) as error:
        load_station(path)
    assert error.value.code == "config.calibration_intrinsics"
    assert "with fx " in str(error.value)
    assert "(the file's: 370)" in str(error.value)
    assert "cx" not in str(error.value), "only what differs is named"


def test_a_record_does_not_hold_for_another_distortion(calibrated: Path, tmp_path: Path) -> None:
    path = _station(tmp_path, calibrated)
    before = path.read_text()
    path.write_text(before.replace("target:", "distortion: [0, 0, 0, 0], target:"))
    assert load_station(path).camera.distortion == (0, 0, 0, 0), "which is as good as none"
    path.write_text(before.replace("target:", "distortion: [0.05, 0, 0, 0], target:"))
    with pytest.raises(ConfigError) as error:
        load_station(path)
    assert error.value.code == "config.calibration_intrinsics"
    assert "camera.distortion null, the file's is [0.05, " in str(error.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("frame: base_link", "frame: pendant_base"), "half a turn"),
        (
            ("[0.93, -0.60, 0.86]", "[0.60, 0.93, 0.86]"),
            "again (x, y, z in this order). If",
        ),
        (
            ("[0.93, -0.60, 0.86]", "[-0.60, 0.93, 0.86]"),
            "in this order), or swap x and y, which are exchanged there",
        ),
    ],
)
def test_a_record_of_another_place_than_the_file_s_camera_is_refused(
    calibrated: Path, tmp_path: Path, change: tuple[str, str], words: str
) -> None:
    path = _station(tmp_path, calibrated)
    path.write_text(path.read_text().replace(*change))
    with raises(ConfigError, says=words):
        load_station(path)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("calibration: {record: camera.json, residual: 0.001}", "already gives residual"),
        ("calibration: {record: nowhere.json}", "cannot read"),
    ],
)
def test_a_wrong_station_file_is_refused(calibrated: Path, tmp_path: Path, line: str, words: str) -> None:
    (tmp_path / "camera.json").write_bytes((calibrated / "camera.json").read_bytes())
    (tmp_path / "station.yaml").write_text(line)
    with raises(ConfigError, says=words):
        load_station(tmp_path / "station.yaml")


def test_joints_in_degrees_are_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    draw_session(tmp_path, 4, BaseFrame.BASE_LINK, lambda X: X)
    poses = yaml.safe_load((tmp_path / "poses.json").read_text())
    for pose in poses["poses"]:
        pose.pop("X_base_flange", None)
        pose["q"] = [0.0, -90.0, 90.0, -90.0, -90.0, 0.0]
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    code = run(["calibrate", "camera", "--station", str(LAB), "--images", str(tmp_path), "--bars-mm", *BARS])
    assert code == 2
    assert "looks like degrees" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("place", ["beside", "rgb"])
def test_a_recording_whose_lens_was_not_known_is_refused(
    place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = tmp_path / "frames"
    toy_recording(recording, 1)
    say_undistorted(recording, False)
    session = recording if place == "beside" else tmp_path
    draw_session(session, 8)
    if place == "rgb":  # poses.json elsewhere names its images
        data = json.loads((session / "poses.json").read_text())
        data["poses"][0]["image"] = "frames/rgb/000000.png"
        (session / "poses.json").write_text(json.dumps(data))
    command = ["calibrate", "camera", "--station", str(LAB), "--images", str(session), "--bars-mm", *BARS]
    assert run([*command, "--out", str(tmp_path / "out")]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "says `undistorted: false`" in told
    assert "camera.distortion" in told
    assert not (tmp_path / "out").exists()


def test_poses_in_the_other_frame_of_the_base_are_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    draw_session(tmp_path, 10, BaseFrame.BASE_LINK, lambda X: HALF_TURN @ X)
    (tmp_path / "lab.yaml").write_text(STATION)
    code = run(["calibrate", "camera", "--images", str(tmp_path), "--station", str(tmp_path / "lab.yaml"), "--bars-mm",
                *BARS, "--out", str(tmp_path / "out")])  # fmt: skip
    assert code == 2
    assert "half a turn" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists(), "nothing is left of a refused calibration"


def test_the_touch_of_a_corner_agrees_or_tells_why_not(calibrated: Path, tmp_path: Path) -> None:
    record = read_record(calibrated / "camera.json")
    write_record(tmp_path / "camera.json", record)
    R = Rotation.from_rotvec([0.6, 0.2, 0.1]).as_matrix()
    X_camera_board = transform(R, [0.02, 0.05, 0.7] - R @ BOARD.center)
    X_base_board = CAMERA.X_base_camera @ X_camera_board
    image = picture(BOARD, X_camera_board)
    cv2.imwrite(str(tmp_path / "table.png"), image)
    corner = 9
    truth = transform_points(X_base_board, BOARD.corners[corner][None])[0]
    rng = np.random.default_rng(0)

    def check(touched: np.ndarray, frame: str) -> int:
        return run(["calibrate", "check", "--record", str(tmp_path / "camera.json"), "--image",
                    str(tmp_path / "table.png"), "--bars-mm", *BARS, "--sheet", "a3", "--corner", str(corner),
                    "--touched-mm", *(f"{1e3 * v:.2f}" for v in touched), "--frame", frame, "--touch-error-mm",
                    "0.3"])  # fmt: skip

    assert check(truth + rng.normal(0.0, 3e-4, 3), "base_link") == 0
    assert check(truth * [-1, -1, 1], "pendant_base") == 0
    assert check(truth + np.array([0.01, 0.0, 0.0]), "base_link") == 1
    assert check(truth, "pendant_base") == 1
    checks = read_record(tmp_path / "camera.json").checks
    assert [c.error <= c.allowed for c in checks] == [True, True, False, False]
    assert checks[2].error == pytest.approx(0.01, abs=3e-3)
    view = find_board(image, BOARD)
    assert view is not None
    with pytest.raises(UserError):
        see_corner(record, BOARD, view, 99)


def test_a_session_with_joint_positions_and_poses_that_disagree_is_refused(tmp_path: Path) -> None:
    drawn = draw_session(tmp_path, 8)
    first = replace(drawn.session.poses[0], q=(0.0, -1.9, 1.9, -1.57, -1.57, 0.0))
    data = json.loads((tmp_path / "poses.json").read_text())
    data["poses"][0]["q"] = list(first.q or ())
    (tmp_path / "poses.json").write_text(json.dumps(data))
    command = ["calibrate", "camera", "--station", str(LAB), "--images", str(tmp_path), "--bars-mm", *BARS]
    assert run([*command, "--out", str(tmp_path / "o")]) == 2

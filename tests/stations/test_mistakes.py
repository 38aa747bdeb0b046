"""Mistakes that a person is likely to make with the camera's calibration: each is named, with what to do."""

from __future__ import annotations

import json
import os
import pty
import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from tests.calibration.pictures import BOARD, CAMERA, draw_session
from tests.devices.cameras.test_recording import toy_recording
from tests.rigs.camera_rig import plug_in
from tests.rigs.wired_hands import eventually
from toolee_robot.app.calibrate_camera import CameraJob, PlateViews
from toolee_robot.calibration.board import SHEETS
from toolee_robot.calibration.session import read_session
from toolee_robot.cli.app import EXIT_FAILED, EXIT_USER, run
from toolee_robot.devices.hands import ports as port
from toolee_robot.sim_backend.devices.software_realsense import SERIAL, SoftwareRealSense
from toolee_robot.sim_backend.hands import emulated_hand
from toolee_robot.sim_backend.hands.inspire import InspireEmulator
from toolee_robot.station import sim_station
from toolee_robot.stations.rehearsal import emulated_lab
from toolee_robot.stations.simulated import simulated_board
from toolee_robot.tasks.calibration.collect import UNSEEN

LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"
BARS = [f"{1e3 * length:.1f}" for length in BOARD.size]
Say = Callable[[], str]


@pytest.mark.parametrize(
    ("bars", "words"),
    [
        (SHEETS["a4"].board.size, "these are the bars of the A4 board: give --sheet a4"),
        (BOARD.size[::-1], "in the other order: give the longer one"),
        ((0.1 * BOARD.size[0], 0.1 * BOARD.size[1]), "measure from end line to end line, and give it in millimetres"),
    ],
    ids=["of the other sheet", "in the other order", "in centimetres"],
)
def test_bars_of_another_board_are_told_before_anything_moves(bars: tuple[float, float], words: str, said: Say) -> None:
    lengths = [f"{1e3 * length:.1f}" for length in bars]
    plate = ["--plate-distance", "0.12", "--plate-mass", "1.2"]
    assert run(["calibrate", "camera", "--station", str(LAB), "--bars-mm", *lengths, *plate]) == EXIT_USER
    assert words in said()


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Images of a board and the arm's poses, all right."""
    folder = tmp_path_factory.mktemp("session")
    draw_session(folder, 12)
    return folder


def _other_print(_: Path) -> list[str]:
    return ["--bars-mm", *(f"{1.03e3 * length:.1f}" for length in BOARD.size), "--station", str(LAB)]


def _swapped_poses(folder: Path) -> list[str]:
    P = np.eye(4)[[1, 0, 2, 3]]
    poses = json.loads((folder / "poses.json").read_text())
    for pose in poses["poses"]:
        pose["X_base_flange"] = (P @ np.array(pose["X_base_flange"]) @ P).tolist()
    (folder / "poses.json").write_text(json.dumps(poses))
    return ["--bars-mm", *BARS, "--station", str(LAB)]


def _camera_in_file(folder: Path, x: float, y: float) -> list[str]:
    text = f"version: 3\nframe: base_link\ncamera: {{position: [{x}, {y}, 0.86], target: [0.61, -0.17, 0.7]}}\n"
    (folder / "lab.yaml").write_text(text)
    return ["--bars-mm", *BARS, "--station", str(folder / "lab.yaml")]


def _swapped_camera(folder: Path) -> list[str]:
    return _camera_in_file(folder, -0.60, 0.93)


def _turned_camera(folder: Path) -> list[str]:
    return _camera_in_file(folder, -0.93, 0.60)


def _depth_in_millimetres(folder: Path) -> list[str]:
    poses = json.loads((folder / "poses.json").read_text())
    for pose in poses["poses"]:
        pose["depth"] = f"depth_{pose['image']}"
        cv2.imwrite(str(folder / pose["depth"]), np.full((CAMERA.height, CAMERA.width), 800, np.uint16))
    (folder / "poses.json").write_text(json.dumps({**poses, "depth_unit": 1.0}))
    return ["--bars-mm", *BARS, "--station", str(LAB)]


@pytest.mark.sim(seconds=5)
@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (_other_print, "Measure the scale bars of the print again"),
        (_swapped_poses, "They fit with x and y swapped"),
        (_swapped_camera, "If x and y are swapped in the file, correct both"),
        (_turned_camera, "differ by half a turn about the base's z"),
        (_depth_in_millimetres, "so depth_unit is wrong"),
    ],
)
def test_a_calibration_from_images_names_the_mistake(
    mistake: Callable[[Path], list[str]], words: str, session: Path, tmp_path: Path, said: Say
) -> None:
    folder, out = tmp_path / "session", tmp_path / "out"
    shutil.copytree(session, folder)
    options = mistake(folder)
    assert run(["calibrate", "camera", "--images", str(folder), "--out", str(out), *options]) == EXIT_USER
    assert words in said()
    assert not out.exists()


@pytest.mark.sim(seconds=5)
def test_the_arm_does_not_go_on_before_a_camera_that_stands_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: Say
) -> None:
    """x and y of its place are swapped in the file: the views are before the place that the file says."""
    printed = simulated_board(sim_station(), SHEETS["a3"], 0.12, 1.2, 3)
    camera = printed.measured.camera
    assert camera.position is not None
    assert camera.target is not None
    (x, y, z), (a, b, c) = camera.position, camera.target
    measured = replace(printed.measured, camera=replace(camera, position=(y, x, z), target=(b, a, c)))

    def live(job: CameraJob, views: PlateViews, _: tuple[float, float]) -> dict[str, Any]:
        with printed.build(3) as sim:
            return job.collect(sim.station, measured, printed.plate, printed.bars, views)[1]

    monkeypatch.setattr(CameraJob, "live", live)
    options = [
        "--plate-distance",
        "0.12",
        "--plate-mass",
        "1.2",
        "--poses",
        "10",
        "--seed",
        "3",
        "--out",
        str(tmp_path),
    ]
    assert run(["calibrate", "camera", "--station", str(LAB), "--bars-mm", *BARS, *options]) == EXIT_USER
    told = said()
    assert "none of the first 4 images shows the board" in told
    assert "x and y swapped, or half a turn of the base" in told
    (kept,) = tmp_path.iterdir()
    assert f"give --images {kept}" in told
    session = read_session(kept)
    assert len(session.poses) == UNSEEN
    assert all((kept / pose.image).is_file() for pose in session.poses)


EXAMPLES = Path(__file__).parents[2] / "examples"
LAB_MISTAKES_OF_A_NEW_LAB, INSPIRE = EXAMPLES / "lab.yaml", EXAMPLES / "inspire.yaml"


def lab(folder: Path, **changes: Any) -> str:
    """Path of the example's station file with other fields, by section."""
    data = yaml.safe_load(LAB_MISTAKES_OF_A_NEW_LAB.read_text())
    for section, fields in changes.items():
        data[section] = {**data[section], **fields} if section != "hand" else fields
    path = folder / "lab.yaml"
    path.write_text(yaml.safe_dump(data))
    return str(path)


# -- ports and serial numbers -----------------------------------------------------------------------------------------


def test_a_hand_at_a_port_that_is_not_there_is_told_with_those_that_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: Say
) -> None:
    (tmp_path / "usb-FTDI_RS485-if00-port0").symlink_to("/dev/ttyUSB0")
    monkeypatch.setattr(port, "_BY_ID", tmp_path)
    assert run(["hand", "state", "--station", str(INSPIRE), "--port", "/dev/ttyUSB97"]) == EXIT_FAILED
    told = said()
    there = f"this computer has {tmp_path}/usb-FTDI_RS485-if00-port0)"
    assert f"cannot open the hand's port /dev/ttyUSB97 (No such file or directory; {there}: check hand.port" in told
    assert "check hand.port, the cable, and your rights to the port" in told


@pytest.mark.realtime(light=True)
def test_a_port_of_another_device_is_silent(said: Say) -> None:
    ours, theirs = pty.openpty()
    try:
        assert run(["hand", "state", "--station", str(INSPIRE), "--port", os.ttyname(theirs)]) == EXIT_FAILED
    finally:
        os.close(ours)
        os.close(theirs)
    told = said()
    assert "no hand 1 answers on /dev/pts/" in told
    assert "that hand.port is not another device's" in told


@pytest.fixture
def realsense(monkeypatch: pytest.MonkeyPatch) -> SoftwareRealSense:
    """The example's camera, which the driver finds; it gives images within its context."""
    k = replace(sim_station().camera, fx=383.2, fy=383.2, cx=319.1, cy=241.6, width=640, height=480).intrinsics
    rs = pytest.importorskip("pyrealsense2", exc_type=ImportError)
    found = SoftwareRealSense(rs, rs.distortion.none, k, k)
    plug_in(monkeypatch, found.devices)
    return found


@pytest.mark.usefixtures("realsense")
def test_another_serial_number_of_the_camera_is_told_with_those_there_are(tmp_path: Path, said: Say) -> None:
    device = {"driver": "realsense", "serial": "832112070999", "least_range": 0.28}
    command = ["camera", "show", "--station", lab(tmp_path, camera={"device": device})]
    assert run(command) == EXIT_FAILED
    told = said()
    assert f"no RealSense with serial number 832112070999 is connected (there are: {SERIAL})" in told
    assert "check cable and camera.device.serial" in told


# -- depth in another unit --------------------------------------------------------------------------------------------


@pytest.fixture
def in_millimetres(tmp_path: Path) -> Path:
    """A recording whose depth is said to be a thousand times as large."""
    folder = tmp_path / "frames"
    toy_recording(folder, 40)
    frames = json.loads((folder / "scene_camera.json").read_text())
    wrong = {n: {**frame, "depth_scale": 1e3 * frame["depth_scale"]} for n, frame in frames.items()}
    (folder / "scene_camera.json").write_text(json.dumps(wrong))
    return folder


@pytest.mark.realtime(light=True)
def test_a_camera_whose_depth_is_in_millimetres_is_told(in_millimetres: Path, said: Say) -> None:
    assert run(["camera", "show", "--recording", str(in_millimetres)]) == EXIT_FAILED
    told = said()
    assert "with 0.1 m to a step, which looks like millimetres taken for metres" in told
    assert "correct `depth_scale`. It is in metres" in told


@pytest.mark.sim(seconds=5)
def test_a_folder_of_frames_whose_depth_is_in_millimetres_is_told(in_millimetres: Path, said: Say) -> None:
    assert run(["estimate", "--bop", str(in_millimetres)]) == EXIT_USER
    told = said()
    assert "with the depth_scale 100 of scene_camera.json" in told
    assert "1 for millimetres" in told
    assert "--depth-scale" not in told, "which goes with a single frame"


# -- a job that cannot do ---------------------------------------------------------------------------------------------


@pytest.mark.sim(seconds=5)
@pytest.mark.parametrize(
    ("section", "fields", "words"),
    [
        ("calibration", {"measured_on": "2026-01-20", "valid_days": 30}, "and 30 are allowed: calibrate again"),
        ("calibration", {"camera_serial": "17"}, f"it is of camera '17', but the station has camera '{SERIAL}'"),
        (
            "camera",
            {"device": {"driver": "realsense", "serial": SERIAL, "least_range": 0.53}},
            "the camera is too near to every view of a job",
        ),
    ],
    ids=["old calibration", "another camera's calibration", "camera too near"],
)
def test_a_job_is_refused_before_anything_is_opened(
    section: str, fields: dict[str, Any], words: str, tmp_path: Path, said: Say
) -> None:
    command = ["rehearse", "hammer", lab(tmp_path, **{section: fields}), "--out", str(tmp_path)]
    assert run(command) == EXIT_USER
    told = said()
    assert words in told
    assert "connecting to" not in told


# -- the hand's cable -------------------------------------------------------------------------------------------------


@pytest.mark.realtime
def test_a_hand_that_is_not_plugged_in_ends_a_job_before_the_arm_is_connected(
    realsense: SoftwareRealSense, tmp_path: Path, said: Say
) -> None:
    hand = {**yaml.safe_load(INSPIRE.read_text())["hand"], "port": "/dev/ttyUSB97"}
    hand["weighed"] = {"mass": 0.9, "center_of_mass": [0.0, 0.0, 0.06]}
    station = lab(tmp_path, hand=hand, strike={"deepest": 0.01})
    with realsense:
        assert run(["run", "hammer", station, "--out", str(tmp_path)]) == EXIT_FAILED
    told = said()
    assert "connecting to the hand at /dev/ttyUSB97" in told
    assert "cannot open the hand's port /dev/ttyUSB97" in told
    assert "connecting to the UR10" not in told


@pytest.mark.realtime(light=True)
def test_a_hand_that_is_unplugged_while_it_closes_is_told(said: Say) -> None:
    with InspireEmulator() as emulator:

        def pull() -> None:
            eventually(lambda: min(emulator.angles) < 900, 60.0)
            emulator.unplug()

        pulled = threading.Thread(target=pull)
        pulled.start()
        command = ["hand", "close", "--station", str(INSPIRE), "--port", emulator.port, "--yes"]
        assert run(command) == EXIT_FAILED
        pulled.join()
    told = said()
    assert f"the hand's port {emulator.port} is gone" in told
    assert "plug the cable in, then start again" in told


@pytest.mark.realtime
@pytest.mark.nightly
def test_a_hand_that_is_unplugged_in_a_job_ends_it_with_the_reason(
    tmp_path: Path, said: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulators: list[InspireEmulator] = []

    def emulated(*args: Any) -> InspireEmulator:
        emulator = emulated_hand(*args)
        assert isinstance(emulator, InspireEmulator)
        emulators.append(emulator)
        return emulator

    def pull() -> None:
        end = time.monotonic() + 240.0
        while time.monotonic() < end and not (emulators and min(emulators[0].angles) < 700):  # the fingers close
            time.sleep(0.1)
        time.sleep(6.0)
        emulators[0].unplug()

    monkeypatch.setattr(emulated_lab, "emulated_hand", emulated)
    hand = yaml.safe_load(INSPIRE.read_text())["hand"]
    hand["weighed"] = {"mass": 0.9, "center_of_mass": [0.0, 0.0, 0.06]}
    station = lab(tmp_path, hand={**hand, "port": "/dev/ttyUSB97"}, strike={"deepest": 0.01})
    pulled = threading.Thread(target=pull)
    pulled.start()
    options = ["--seed", "100", "--variant", "perfect_perception", "--real-time-factor", "0.4", "--out", str(tmp_path)]
    assert run(["rehearse", "hammer", station, *options]) == EXIT_FAILED
    pulled.join()
    told = said()
    assert "device fault" in told
    assert f"the hand's port {emulators[0].port} is gone" in told

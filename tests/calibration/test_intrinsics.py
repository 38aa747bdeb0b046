"""Intrinsics from images: the true ones within their uncertainty, and what does not determine them is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.calibration.pictures import BOARD, CAMERA, picture
from tests.devices.cameras.test_recording import say_undistorted, toy_recording
from tests.errors import raises
from toolee_robot.app.calibrate_intrinsics import camera_of
from toolee_robot.calibration.intrinsics import DISTORTED_FLAT, calibrate_intrinsics
from toolee_robot.calibration.observation import BoardView, find_board
from toolee_robot.calibration.record import INTRINSICS_FORMAT, IntrinsicsRecord, read_intrinsics, write_record
from toolee_robot.cli.app import EXIT_USER, run
from toolee_robot.devices.cameras import Lens, LensModel
from toolee_robot.errors import ConfigError, UserError
from toolee_robot.frames import Array, transform
from toolee_robot.station import load_lab_station, load_station
from toolee_robot.stations.template import open_questions

SIZE = (CAMERA.width, CAMERA.height)
K = CAMERA.intrinsics


def _views(tilt: float, count: int = 24, lens: Callable[[NDArray[np.uint8]], NDArray[np.uint8]] = lambda i: i,
           spread: float = 0.32) -> list[BoardView]:  # fmt: skip
    rng = np.random.default_rng(5)
    views: list[BoardView] = []
    while len(views) < count:
        R = Rotation.from_rotvec([*rng.uniform(-tilt, tilt, 2), 0.0]) * Rotation.from_rotvec([0, 0, rng.uniform(-1, 1)])
        depth = rng.uniform(0.36, 0.6)
        center = depth * np.array([rng.uniform(-spread, spread), rng.uniform(-spread, spread) * 0.8, 1.0])
        view = find_board(
            lens(picture(BOARD, transform(R, center - R.as_matrix() @ BOARD.center))), BOARD, DISTORTED_FLAT
        )
        if view is not None:
            views.append(view)
    return views  # fmt: skip


def _calibrate(views: list[BoardView]) -> IntrinsicsRecord:
    return calibrate_intrinsics(
        views, BOARD, SIZE, camera_serial="cam-7", software="0", measured_at="2026-11-25T00:00:00+00:00"
    )


@pytest.fixture(scope="module")
def tilted() -> list[BoardView]:
    return _views(0.7)


def test_the_true_intrinsics_are_found_within_their_uncertainty(tilted: list[BoardView]) -> None:
    record = _calibrate(tilted)
    found = record.intrinsics
    for mine, true, sigma in zip(
        (found.fx, found.fy, found.cx, found.cy), (K.fx, K.fy, K.cx, K.cy), record.sigma, strict=True
    ):
        assert abs(mine - true) < max(4 * sigma, 0.3)
    assert not record.distorts
    assert record.held_out < 0.3


def test_a_distorting_lens_is_noticed() -> None:
    u, v = np.meshgrid(np.arange(SIZE[0], dtype=np.float32), np.arange(SIZE[1], dtype=np.float32))
    true = np.array([0.06, 0.0, 0.0, 0.0])
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    ideal = cv2.undistortPoints(pixels, K.matrix, true, P=K.matrix).reshape(SIZE[1], SIZE[0], 2).astype(np.float32)
    x, y = ideal[..., 0].copy(), ideal[..., 1].copy()
    record = _calibrate(_views(0.7, lens=lambda i: np.asarray(cv2.remap(i, x, y, cv2.INTER_CUBIC), np.uint8)))
    assert record.distorts
    assert record.distortion[0] == pytest.approx(0.06, abs=max(4 * record.sigma_distortion[0], 0.01))
    assert record.intrinsics.fx == pytest.approx(K.fx, abs=max(4 * record.sigma[0], 1.0))


def test_corners_that_do_not_fit_are_left_out(tilted: list[BoardView]) -> None:
    """As those that the edge of the image cuts."""
    rng, wrong, views = np.random.default_rng(0), 0, []
    for view in tilted:
        off = rng.random(len(view.ids)) < 0.03
        views.append(replace(view, pixels=view.pixels + off[:, None] * rng.choice([-3.0, 3.0], view.pixels.shape)))
        wrong += int(off.sum())
    record, clean = _calibrate(views), _calibrate(tilted)
    assert wrong <= record.left_out <= wrong + 8 + clean.left_out
    assert record.held_out < 1.2 * clean.held_out
    assert record.intrinsics.fx == pytest.approx(clean.intrinsics.fx, abs=0.3)


@pytest.mark.nightly
def test_what_does_not_determine_them_is_refused(tilted: list[BoardView]) -> None:
    with raises(UserError, says="images show the board"):
        _calibrate(tilted[:9])
    with raises(UserError, says="show it in the corners, too"):
        _calibrate(_views(0.7, 12, spread=0.02))
    with raises(UserError, says="the focal length is uncertain by"):
        _calibrate(_views(0.03))
    rng = np.random.default_rng(0)
    shaken = [replace(view, pixels=view.pixels + rng.normal(0.0, 2.5, view.pixels.shape)) for view in tilted * 2]
    with raises(UserError, says="do not fit"):
        _calibrate(shaken)


def _through(projection: Callable[[Array], Array], edge: float) -> list[BoardView]:
    """Views through a lens that is no polynomial's, three of four in the middle of the image."""
    rng, views = np.random.default_rng(7), list[BoardView]()
    focal = 0.5 * SIZE[0] / float(projection(np.array(edge)))
    while len(views) < 40:
        R = Rotation.from_rotvec([*rng.uniform(-0.7, 0.7, 2), 0.0]) * Rotation.from_rotvec([0, 0, rng.uniform(-1, 1)])
        angle = edge * (rng.uniform(0.7, 1.1) if len(views) % 4 == 0 else rng.uniform(0.0, 0.3))
        around = rng.uniform(0.0, 2 * np.pi)
        toward = np.array([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)])
        R = Rotation.align_vectors([toward], [[0.0, 0.0, 1.0]])[0] * R
        points = (BOARD.corners - BOARD.center) @ R.as_matrix().T + rng.uniform(0.5, 0.8) * toward
        r = np.hypot(points[:, 0], points[:, 1])
        theta = np.arctan2(r, points[:, 2])
        pixels = focal * (projection(theta) / r)[:, None] * points[:, :2] + np.array(SIZE) / 2
        pixels += rng.normal(0.0, 0.1, pixels.shape)
        seen = (theta < 1.5) & np.all((pixels > 0) & (pixels < np.array(SIZE) - 1), axis=1)
        if seen.sum() >= 12:
            views.append(BoardView(np.flatnonzero(seen), pixels[seen]))
    return views


def _bent(theta: Array) -> Array:
    """A pinhole camera's up to 0.45 rad, a fisheye's beyond."""
    return np.asarray(np.tan(np.minimum(theta, 0.45)) + 0.6 * np.maximum(theta - 0.45, 0.0))


@pytest.mark.parametrize(
    ("projection", "edge", "words"), [(_bent, 0.8, "do not fit the others"), (np.sin, 1.3, "took no part")]
)
def test_a_lens_that_four_numbers_do_not_describe_is_refused(
    projection: Callable[[Array], Array], edge: float, words: str
) -> None:
    """Also where what does not fit, left out, leaves a middle that does."""
    with raises(UserError, says="motion while the image was taken") as error:
        _calibrate(_through(projection, edge))
    assert words in str(error.value)


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
    assert (camera.distortion, camera.intrinsics_record) == (DISTORTION, "intrinsics.json")
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


def test_a_record_of_another_camera_is_refused(tmp_path: Path) -> None:
    with raises(ConfigError, "config.intrinsics_serial") as error:
        load_station(lab(tmp_path, "F1370001"))
    assert "toolee calibrate intrinsics" in str(error.value)
    with raises(ConfigError):
        load_station(lab(tmp_path, intrinsics_record="intrinsics.json"))


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
    with raises(ConfigError) as error:
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
    with raises(ConfigError, says="take the original, or calibrate again"):
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
    with raises(ConfigError) as error:
        camera_of(path)
    assert "give camera.width and camera.height" in str(error.value)
    assert "intrinsics.json" in str(error.value), "which gave them"


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
        (["--station", str(LAB), "--camera-serial", "7"], "leave --camera-serial out"),
        (["--station", str(LAB), "--write"], "Delete its section `calibration`"),
        (["--images", "v", "--camera-serial", "7", "--write"], "--write needs --station"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["calibrate", "intrinsics", "--bars-mm", "360", "257", *options]) == EXIT_USER
    assert words in " ".join(capsys.readouterr().err.split())

"""The pose of a camera by another calibration program: the same however it is written, refused where it cannot be."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.errors import raises
from tests.examples import examples
from toolee_robot.calibration.board import SHEETS
from toolee_robot.errors import ConfigError
from toolee_robot.frames import HALF_TURN, Array, inverse, is_rigid, rotation_angle, transform
from toolee_robot.runtime.yaml_files import to_record
from toolee_robot.sim_backend.cell_errors import NOMINAL, draw_errors
from toolee_robot.station import (
    StationConfig,
    ToolData,
    load_lab_station,
    load_station,
    sim_station,
    unmeasured,
    with_setup,
)
from toolee_robot.station.job import check_enclosed
from toolee_robot.stations.simulated import TAPE, simulated_board
from toolee_robot.stations.template import contradiction, open_fields, open_questions, told

LAB = Path(__file__).parents[1] / "examples" / "lab.yaml"
LOOK_AT = sim_station().camera.X_base_camera
DOWN = transform(Rotation.from_rotvec([np.pi, 0.0, 0.0]), [0.60, -0.15, 1.50])
"""A camera that looks straight down, the top of its image towards +y."""
_coordinate = st.floats(-3.0, 3.0)
_quaternion = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)


def _load(folder: Path, camera: dict[str, Any], frame: str | None = "base_link") -> StationConfig:
    path = folder / "lab.yaml"
    path.write_text(yaml.safe_dump({"camera": camera} | ({} if frame is None else {"frame": frame})))
    return load_station(path)


def _matrix(X: Array) -> list[list[float]]:
    rows: list[list[float]] = X.tolist()
    return rows


def _lab(X: Array) -> dict[str, Any]:
    """The complete file of a lab, its camera's pose by another program."""
    said: dict[str, Any] = yaml.safe_load(LAB.read_text())
    for name in ("position", "target"):
        del said["camera"][name]
    said["camera"]["X_base_camera"] = _matrix(X)
    return said


@examples(10)
@given(st.tuples(*[_coordinate] * 3), _quaternion)
def test_matrix_and_quaternion_in_either_frame_are_one_pose(
    tmp_path_factory: pytest.TempPathFactory, position: tuple[float, ...], q: tuple[float, ...]
) -> None:
    folder = tmp_path_factory.mktemp("poses")
    X = transform(Rotation.from_quat(q), position)
    for frame, there in (("base_link", X), ("pendant_base", HALF_TURN @ X)):
        quaternion = Rotation.from_matrix(there[:3, :3]).as_quat().tolist()
        for pose in (_matrix(there), {"position": there[:3, 3].tolist(), "quaternion": quaternion}):
            camera = _load(folder, {"X_base_camera": pose}, frame).camera
            np.testing.assert_allclose(camera.X_base_camera, X, atol=1e-9)
            np.testing.assert_allclose(camera.uncalibrated.X_base_camera, X, atol=1e-9)


def test_a_pose_is_the_camera_that_position_and_target_are(tmp_path: Path) -> None:
    q = Rotation.from_matrix(LOOK_AT[:3, :3]).as_quat().round(4).tolist()
    camera = _load(tmp_path, {"X_base_camera": {"position": [0.95, -0.62, 0.85], "quaternion": q}}).camera
    assert q == [0.7403, 0.2454, -0.1969, -0.5941], "the example of docs/how-to/calibrate.md"
    np.testing.assert_allclose(camera.X_base_camera, LOOK_AT, atol=2e-4)


@examples(10)
@given(_quaternion, st.integers(4, 6))
def test_the_digits_of_a_report_are_enough(
    tmp_path_factory: pytest.TempPathFactory, q: tuple[float, ...], digits: int
) -> None:
    """Rounded off, with exponents, which YAML takes for text: behind the loader it is a rotation."""
    folder = tmp_path_factory.mktemp("digits")
    X = transform(Rotation.from_quat(q), [0.95, -0.62, 0.85])
    for reported in (X.round(digits).tolist(), [[f"{x:.{digits}e}" for x in row] for row in X]):
        found = _load(folder, {"X_base_camera": reported}).camera.X_base_camera
        assert is_rigid(found, 1e-9)
        np.testing.assert_allclose(found, X, atol=1e-3)


def test_a_labs_file_is_complete_with_a_pose(tmp_path: Path) -> None:
    said = _lab(DOWN)
    path = tmp_path / "lab.yaml"
    path.write_text(yaml.safe_dump(said))
    assert unmeasured(path) == []
    np.testing.assert_allclose(load_lab_station(path).camera.X_base_camera, _in_base(said, DOWN), atol=1e-12)
    assert open_questions(said) == []
    assert contradiction(said, "camera") == ""
    del said["camera"]["X_base_camera"], said["calibration"]
    assert {"camera.position", "camera.target"} <= {question.name for question in open_questions(said)}
    said["camera"]["X_base_camera"] = _matrix(DOWN)
    assert "the other program's" in told(open_fields(said, path))


def _in_base(said: dict[str, Any], X: Array) -> Array:
    return HALF_TURN @ X if said["frame"] == "pendant_base" else X


def test_a_recording_s_station_is_read_back() -> None:
    """A recording holds the record's own fields, not those of a station file."""
    config = sim_station()
    config = replace(config, camera=replace(config.camera, measured_pose=tuple(map(tuple, DOWN.tolist()))))
    assert to_record(asdict(config), Path("station.json"), StationConfig, "station") == config


def test_a_displaced_camera_stands_beside_the_pose_and_the_simulated_one_at_it(tmp_path: Path) -> None:
    config = _load(tmp_path, {"X_base_camera": _matrix(DOWN)})
    moved = draw_errors(NOMINAL, 3).displaced(config).camera
    assert 0.0 < np.linalg.norm(moved.X_base_camera[:3, 3] - DOWN[:3, 3]) < 0.02
    assert 0.0 < rotation_angle(moved.X_base_camera[:3, :3].T @ DOWN[:3, :3]) < 0.05
    np.testing.assert_allclose(moved.uncalibrated.X_base_camera, DOWN, atol=1e-12)


def test_a_rehearsed_calibration_begins_beside_the_pose(tmp_path: Path) -> None:
    config = _load(tmp_path, {"X_base_camera": _matrix(DOWN)})
    lab = simulated_board(config, next(iter(SHEETS.values())), 0.12, 1.2, seed=3)
    np.testing.assert_allclose(lab.true.camera.X_base_camera, DOWN, atol=1e-12)
    X = lab.measured.camera.X_base_camera
    assert is_rigid(X)
    assert 0.0 < np.abs(X[:3, 3] - DOWN[:3, 3]).max() <= TAPE
    assert 0.0 < rotation_angle(X[:3, :3].T @ DOWN[:3, :3]) < 0.2


EXAMPLES = Path(__file__).parents[1] / "examples"
TOOL = """
tool: {name: ball peen, grip_radius: 0.014, face: [0.05, 0.0, 0.27], face_normal: [1.0, 0.0, 0.0], mass: 0.6,
  center_of_mass: [0.0, 0.0, 0.16]}
"""


def _written(folder: Path, text: str) -> Path:
    path = folder / "setup.yaml"
    path.write_text(text)
    return path


def test_the_rest_stays_the_station_files(tmp_path: Path) -> None:
    lab = load_lab_station(EXAMPLES / "lab.yaml")
    made = with_setup(lab, _written(tmp_path, TOOL))
    assert made.tool is not None
    assert (made.tool.name, made.tool.mass) == ("ball peen", 0.6)
    assert replace(made, tool=lab.tool) == lab
    made = with_setup(lab, _written(tmp_path, "work: {wood_specific_gravity: 0.68, nail_length: 0.04}"))
    assert made == replace(lab, work=replace(lab.work, wood_specific_gravity=0.68, nail_length=0.04))
    assert with_setup(lab, _written(tmp_path, "")) == lab


LONG = TOOL.replace("0.27]", "0.38]").replace("[0.05,", "[0.075,")


def test_another_tools_shape_is_given_with_it(tmp_path: Path) -> None:
    """A sledge hammer is longer than the station's claw hammer, and its handle farther behind its face."""
    lab = load_lab_station(EXAMPLES / "lab.yaml")
    with raises(ConfigError, says="Give `tool_envelope` as measured, or correct") as refused:
        with_setup(lab, _written(tmp_path, LONG))
    assert "380 mm from the face" in str(refused.value)
    made = with_setup(lab, _written(tmp_path, LONG + "tool_envelope: {handle_depth: 0.075, handle_length: 0.5}"))
    assert (made.tool_envelope.handle_depth, made.tool_envelope.handle_length) == (0.075, 0.5)
    no_face = LONG.replace("[0.075, 0.0, 0.38]", "null").replace("[1.0, 0.0, 0.0]", "null")
    assert with_setup(lab, _written(tmp_path, no_face)).tool_envelope == lab.tool_envelope


@given(
    depth=st.floats(0.0, 0.1), side=st.floats(-0.03, 0.03), length=st.floats(0.15, 0.5), tilt=st.floats(-0.3, 0.3),
    grip=st.floats(0.005, 0.025),
)  # fmt: skip
def test_what_passes_lies_within_the_cylinder(
    depth: float, side: float, length: float, tilt: float, grip: float
) -> None:
    """By points around the handle where the hand holds it, in the frame of `ToolEnvelope`."""
    tool = ToolData("hammer", grip, (depth, side, length), (np.cos(tilt), 0.0, np.sin(tilt)), 0.6, (0.0, 0.0, 0.1))
    config = replace(sim_station(), tool=tool)
    X_face_tool = inverse(tool.X_tool_face)  # type: ignore[arg-type]
    turns = np.linspace(0.0, 2.0 * np.pi, 60)
    around = np.stack([grip * np.cos(turns), grip * np.sin(turns), 0.0 * turns], axis=-1)
    x, y, z = (around @ X_face_tool[:3, :3].T + X_face_tool[:3, 3]).T
    envelope = config.tool_envelope
    inside = np.hypot(y, z + envelope.handle_depth).max() <= envelope.handle_radius + 1e-9
    try:
        check_enclosed(config, Path("lab.yaml"))
    except ConfigError:
        return
    assert inside
    assert x.mean() <= envelope.handle_length


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("tool: {name: ball peen, mass: 0.6}", "grip_radius"),
        ("work: {nail_xy: [0.1, 0.2]}", "nail_xy"),
        ("work: {nail_protrusion: 0.05}", "nail_length"),
        ("work: {nail_diameter: 3.1, nail_length: 65}", "nail_length"),
        ("camera: {fx: 3}", "camera"),
    ],
)
def test_what_it_cannot_say_is_refused(tmp_path: Path, text: str, what: str) -> None:
    with raises(ConfigError, says=what):
        with_setup(load_lab_station(EXAMPLES / "lab.yaml"), _written(tmp_path, text))


def test_of_several_nails_it_gives_the_wood_alone(tmp_path: Path) -> None:
    several = load_station(EXAMPLES / "nails.yaml")
    made = with_setup(several, _written(tmp_path, "work: {wood_specific_gravity: 0.5}"))
    assert made.work.wood_specific_gravity == 0.5
    assert made.work.nails == several.work.nails
    with raises(ConfigError):
        with_setup(several, _written(tmp_path, "work: {nail_diameter: 0.003}"))
    assert with_setup(sim_station(), _written(tmp_path, "work: {nail_diameter: 0.003}")).work.nail_diameter == 0.003

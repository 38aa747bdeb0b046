"""The page of a station file: every place with its name, in the file's frame, and marked if the file leaves it out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.viewer.logged import Logged
from toolee_robot.control.collision_shapes import station_bodies
from toolee_robot.station import load_station
from toolee_robot.viewer.station_view import StationView

EXAMPLES = Path(__file__).parents[2] / "examples"
pytestmark = pytest.mark.sim(seconds=10)


def _rows(page: StationView) -> dict[str, list[float]]:
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.texts()[0].splitlines()[4:]]
    return {name: [float(number) for number in numbers] for name, *numbers in cells}


def test_places_are_told_in_the_files_own_frame(tmp_path: Path) -> None:
    said = yaml.safe_load((EXAMPLES / "lab.yaml").read_text())
    page = StationView(EXAMPLES / "lab.yaml")
    rows = _rows(page)
    assert rows["camera"] == said["camera"]["position"]
    assert rows["nail"] == [0.75, 0.10, 0.28]
    assert rows["handover"] == said["scene"]["handover_position"]
    assert "obstacles" in page.texts()[1]
    assert f"station check {EXAMPLES / 'lab.yaml'}" in page.texts()[2]
    path = tmp_path / "pendant.yaml"
    path.write_text("frame: pendant_base\ncamera: {position: [-0.95, 0.62, 0.85], target: [-0.6, 0.15, 0.72]}\n")
    page = StationView(path)
    assert "`pendant_base`" in page.texts()[0]
    rows = _rows(page)
    assert rows["camera"] == [-0.95, 0.62, 0.85]
    assert rows["nail (not given)"][:2] == [-0.75, -0.10]


def test_the_table_is_drawn_where_the_collision_checks_have_it(tmp_path: Path) -> None:
    path = tmp_path / "pedestal.yaml"
    path.write_text(
        "frame: base_link\nscene: {table_center: [0.5, -0.2], table_height: -0.4}\nwork: {stand_height: -0.3}\n"
    )
    logged = Logged(tmp_path / "station.rrd")
    StationView(path).log(logged.stream)
    shown = logged.read()
    drawn = shown["world/table"][0][1]["centers"][0]
    (table,) = (body for body in station_bodies(load_station(path)) if body.name == "table")
    np.testing.assert_allclose(drawn[:2], table.X_joint_shape[:2, 3])
    assert drawn[2] == pytest.approx(-0.4, abs=0.01)


def test_all_that_the_file_places_is_drawn_and_named(tmp_path: Path) -> None:
    logged = Logged(tmp_path / "station.rrd")
    StationView(EXAMPLES / "lab.yaml").log(logged.stream)
    shown = logged.read()
    names = set(shown["world/names"][0][1]["labels"])
    assert names >= {"base_link", "camera", "flange at home", "handover", "nail", "person", "shelf", "workspace"}
    assert shown.keys() >= {"world/workspace", "world/view", "world/bodies/shelf", "world/bodies/forearm_link"}
    assert "Places in" in shown["text"][0][1]["text"][0]


def test_a_camera_by_another_program_s_pose_is_drawn_where_it_stands(tmp_path: Path) -> None:
    path = tmp_path / "pose.yaml"
    pose = "{position: [-0.60, 0.15, 1.50], quaternion: [1.0, 0.0, 0.0, 0.0]}"
    path.write_text(f"frame: pendant_base\ncamera: {{X_base_camera: {pose}}}\n")
    page = StationView(path)
    assert _rows(page)["camera"] == [-0.60, 0.15, 1.50]
    assert "as far as the nail" in page.texts()[1]


def test_what_the_file_leaves_out_is_marked() -> None:
    page = StationView(EXAMPLES / "nails.yaml")
    rows = _rows(page)
    assert {"camera (not given)", "nail left (not all given)", "person (not given)"} <= rows.keys()
    assert "obstacles" not in page.texts()[1], "there are none"

"""The page of a station file: every place with its name, in the file's frame, and what the file leaves out."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from toolee_robot.control.collision_shapes import station_bodies
from toolee_robot.station import load_station
from toolee_robot.viewer.station_page import StationPage
from toolee_robot.viewer.station_scene import CAMERA_BOX, OBSTACLE

EXAMPLES = Path(__file__).parents[2] / "examples"
CHROMIUM = next((p for p in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if p), None)
ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--use-gl=swiftshader", "--enable-unsafe-swiftshader"]
pytestmark = pytest.mark.sim(seconds=10)


@contextmanager
def _page(path: Path) -> Iterator[StationPage]:
    page = StationPage(path, 8240)
    try:
        yield page
    finally:
        page.close()


def _rows(page: StationPage) -> dict[str, list[float]]:
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.texts()[0].splitlines()[4:]]
    return {name: [float(number) for number in numbers] for name, *numbers in cells}


def test_places_are_told_in_the_files_own_frame(tmp_path: Path) -> None:
    said = yaml.safe_load((EXAMPLES / "lab.yaml").read_text())
    with _page(EXAMPLES / "lab.yaml") as page:
        rows = _rows(page)
        assert rows["camera"] == said["camera"]["position"]
        assert rows["nail"] == [0.75, 0.10, 0.28]
        assert rows["handover"] == said["scene"]["handover_position"]
        assert "calibrated on 2026-11-20" in page.texts()[2]
        assert "obstacles" in page.texts()[1]
        assert "nothing that a job needs" in page.texts()[3]
    path = tmp_path / "pendant.yaml"
    path.write_text("frame: pendant_base\ncamera: {position: [-0.95, 0.62, 0.85], target: [-0.6, 0.15, 0.72]}\n")
    with _page(path) as page:
        assert "`pendant_base`" in page.texts()[0]
        rows = _rows(page)
        assert rows["camera"] == [-0.95, 0.62, 0.85]
        assert rows["nail (not given)"][:2] == [-0.75, -0.10]


def test_the_table_is_drawn_where_the_collision_checks_have_it(tmp_path: Path) -> None:
    path = tmp_path / "pedestal.yaml"
    path.write_text(
        "frame: base_link\nscene: {table_center: [0.5, -0.2], table_height: -0.4}\nwork: {stand_height: -0.3}\n"
    )
    with _page(path) as page:
        drawn = page.picture.place("table")
    (table,) = (body for body in station_bodies(load_station(path)) if body.name == "table")
    np.testing.assert_allclose(drawn[:2], table.X_joint_shape[:2, 3])
    assert drawn[2] == pytest.approx(-0.4, abs=0.01)


def test_a_camera_by_another_program_s_pose_is_drawn_where_it_stands(tmp_path: Path) -> None:
    path = tmp_path / "pose.yaml"
    pose = "{position: [-0.60, 0.15, 1.50], quaternion: [1.0, 0.0, 0.0, 0.0]}"
    path.write_text(f"frame: pendant_base\ncamera: {{X_base_camera: {pose}}}\n")
    with _page(path) as page:
        assert _rows(page)["camera"] == [-0.60, 0.15, 1.50]
        assert "position, target" not in page.texts()[3], "nothing of it is missing"
        assert "as far as the nail" in page.texts()[1]


def test_what_the_file_leaves_out_is_marked_and_listed() -> None:
    with _page(EXAMPLES / "nails.yaml") as page:
        rows = _rows(page)
        assert {"camera (not given)", "nail left (not all given)", "person (not given)"} <= rows.keys()
        missing = page.texts()[3]
        assert "- camera: position, target" in missing
        assert "nail_xy" not in missing.split("(more exactly)")[0].replace("nails", ""), "its nails have places"
        assert "obstacles" not in page.texts()[1], "there are none"
        assert "not calibrated" in page.texts()[2]


@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine")
def test_the_browser_shows_panel_and_picture() -> None:
    from playwright.sync_api import sync_playwright

    with _page(EXAMPLES / "lab.yaml") as page, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        view = browser.new_page(viewport={"width": 1300, "height": 900})
        view.goto(page.address)
        for text in ("lab.yaml", "flange at home", "Colours", "what it sees", "nothing that a job needs"):
            view.get_by_text(text).first.wait_for(timeout=60_000)
        view.wait_for_timeout(8_000)  # software rendering: the meshes appear
        pixels = np.asarray(Image.open(io.BytesIO(view.screenshot())).convert("RGB")).astype(int)[:, :900]
        browser.close()
    for color in (CAMERA_BOX, OBSTACLE):
        assert (abs(pixels - color).max(axis=-1) < 40).sum() > 300, "in shades"

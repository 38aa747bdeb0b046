"""A folder of rendered frames, annotated from the true tools' outlines, scored as a lab would score its own."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.errors import raises
from tests.perception.data_sets import frames, held_out_tools
from tests.perception.offline.annotation.scenes import RenderedEnd, rendered_ends
from toolee_robot.cli.app import run
from toolee_robot.errors import ConfigError, UserError
from toolee_robot.perception.offline.annotation.clicks import (
    Click,
    ClickedEnd,
    ClickedFrame,
    ClicksFile,
    Role,
    Shape,
    read_clicks,
    write_clicks,
)
from toolee_robot.perception.offline.annotation.frame_set import FrameSet, Session
from toolee_robot.perception.offline.annotation.poses import AnnotatedEnd
from toolee_robot.perception.offline.evaluation.photographs import read_photographs

pytestmark = pytest.mark.sim(seconds=40)


@pytest.fixture(scope="module")
def data(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    held_out = getattr(request, "param", False)
    return held_out_tools(tmp_path_factory) if held_out else frames(tmp_path_factory, "test")


held_out = pytest.mark.parametrize("data", [pytest.param(True, marks=pytest.mark.nightly)], indirect=True)
"""With 24 images and their tools' meshes instead of four images."""


@pytest.fixture
def folder(data: Path, tmp_path: Path) -> Path:
    """Frames alone, without the truth."""
    scene, folder = data / "test" / "000000", tmp_path / "frames"
    folder.mkdir()
    for name in ("rgb", "depth"):
        shutil.copytree(scene / name, folder / name)
    shutil.copy(scene / "scene_camera.json", folder)
    return folder


@pytest.fixture(scope="module")
def ends(data: Path) -> list[RenderedEnd]:
    found = list(rendered_ends(data, "test"))
    assert len(found) >= 5
    return found


def _clicks(ends: list[RenderedEnd], empty: tuple[str, ...] = ()) -> ClicksFile:
    frames: dict[str, ClickedFrame] = {name: ClickedFrame(no_tool=True) for name in empty}
    for end in ends:
        before = frames.get(end.name, ClickedFrame()).ends
        frames[end.name] = ClickedFrame(ends=(*before, end.clicked))
    return ClicksFile("bench", frames=frames)


@held_out
def test_the_true_outlines_give_the_true_poses(folder: Path, ends: list[RenderedEnd]) -> None:
    write_clicks(folder / "clicks.yaml", _clicks(ends))
    frames = FrameSet(folder)
    rows = []
    for name in sorted({e.name for e in ends}):
        mine = [e for e in ends if e.name == name]
        for truth, end in zip(mine, frames.annotate(name).ends, strict=True):
            if isinstance(end, AnnotatedEnd):
                X, Y = end.fit.X_camera_ee, truth.X_camera_ee
                angle = np.rad2deg(end.category.symmetry.rotation_error(X[:3, :3], Y[:3, :3]))
                rows.append([1000 * np.linalg.norm(X[:3, 3] - Y[:3, 3]), angle, end.sigma_mm, end.sigma_deg])
            else:
                assert end.code in ("user.too_thin", "user.too_oblique")
    assert len(rows) >= 5
    mm, deg, expected_mm, expected_deg = np.median(rows, axis=0)
    assert mm < 3.0
    assert deg < 6.0
    assert expected_mm < 4.0
    assert expected_deg < 8.0
    off = np.array(rows)
    assert (off[:, 0] < 3 * off[:, 2]).mean() >= 0.8, "errors are of the size that is told"


@held_out
def test_annotate_then_evaluate(
    folder: Path, ends: list[RenderedEnd], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = {e.name for e in ends}
    faces = [e for e in ends if e.clicked.shape is Shape.FACE]
    none = next(f"{k:06d}" for k in range(24) if f"{k:06d}" not in shown)
    source = tmp_path / "elsewhere.yaml"
    write_clicks(source, _clicks(faces, (none,)))
    assert run(["annotate", str(folder), "--clicks", str(source), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["frames"] == len({e.name for e in faces}) + 1
    assert all(0.5 < end["sigma_mm"] < 8.0 for end in said["ends"])
    assert read_clicks(folder / "clicks.yaml") == read_clicks(source)
    photographs = read_photographs(folder)
    assert sum(not p.ends for p in photographs) == 1
    first = FrameSet(folder).read(photographs[0].name)
    assert np.allclose(photographs[0].frame.depth, first.depth, atol=1e-6), "depth in the folder's own unit"
    assert run(["evaluate", "photographs", str(folder), "--json"]) == 0
    row = next(r for r in json.loads(capsys.readouterr().out)["table"] if (r["half"], r["view"]) == ("B", "whole"))
    assert row["ends"] == row["known_poses"] == len(faces)
    assert row["empty_frames"] == 1
    assert row["found"] >= 0.5 * len(faces), "the boxes are those of the detector's end effectors"
    assert row["right"] >= 0.5 * row["found"]
    assert 0.5 < row["median_annotation_mm"] < 8.0


@held_out
def test_a_frame_with_an_unfinished_end_is_left_out_and_told(
    folder: Path, ends: list[RenderedEnd], capsys: pytest.CaptureFixture[str]
) -> None:
    face = next(e for e in ends if e.clicked.shape is Shape.FACE)
    few = replace(face.clicked, clicks=face.clicked.clicks[:4])
    write_clicks(folder / "clicks.yaml", ClicksFile("bench", frames={face.name: ClickedFrame(ends=(few,))}))
    assert run(["annotate", str(folder), "--clicks", str(folder / "clicks.yaml")]) == 1
    assert "4 of 5 clicks" in capsys.readouterr().out
    assert read_photographs(folder) == []
    boxed = few.with_click(Click(Role.BOX, 10, 60)).with_click(Click(Role.BOX, 50, 20))
    write_clicks(folder / "clicks.yaml", ClicksFile("bench", frames={face.name: ClickedFrame(ends=(boxed,))}))
    run(["annotate", str(folder), "--clicks", str(folder / "clicks.yaml")])
    (photograph,) = read_photographs(folder)
    assert photograph.ends[0].box == (10, 20, 50, 60)
    assert photograph.ends[0].X_camera_ee is None


@held_out
def test_a_pose_that_contradicts_the_tape_is_not_written(folder: Path, ends: list[RenderedEnd]) -> None:
    face = next(e for e in ends if e.clicked.shape is Shape.FACE)
    true_mm = 1000 * float(np.linalg.norm(face.X_camera_ee[:3, 3]))
    for off, known in ((0.0, True), (60.0, False)):
        clicked = replace(face.clicked, tape_mm=true_mm + off)
        clicks = ClicksFile("bench", tape_offset_mm=0.0, frames={face.name: ClickedFrame(ends=(clicked,))})
        write_clicks(folder / "clicks.yaml", clicks)
        FrameSet(folder).write()
        (photograph,) = read_photographs(folder)
        assert (photograph.ends[0].X_camera_ee is not None) is known


def test_work_is_saved_after_each_change_and_goes_on(folder: Path) -> None:
    session = Session(FrameSet(folder))
    assert session.next_role() is None
    with raises(UserError, code="user.no_end"):
        session.click(Role.RIM, 1.0, 2.0)
    session.add_end(Shape.FACE)
    for k in range(3):
        session.click(Role.RIM, 100.0 + k, 50.0)
        saved = read_clicks(folder / "clicks.yaml").frames[session.name].ends[0]
        assert saved == session.current
        assert len(saved.clicks) == k + 1
    session.undo()
    session.enter(caliper_mm=28.0)
    with raises(UserError, code="user.ends_clicked"):
        session.say_no_tool(True)
    session.look_at(1)
    session.say_no_tool(True)
    again = Session(FrameSet(folder))
    assert again.number == 2, "it goes on at the first frame that was not looked at"
    again.look_at(0)
    assert again.current == ClickedEnd(Shape.FACE, (Click(Role.RIM, 100, 50), Click(Role.RIM, 101, 50)), 28.0)
    assert again.next_role() is Role.RIM
    again.remove_end()
    assert again.clicked == ClickedFrame()
    assert again.frames.clicks.frames["000001"].no_tool


def test_other_people_s_files_are_not_overwritten(folder: Path, tmp_path: Path) -> None:
    (folder / "frames.json").write_text('{"frames": []}')
    with raises(UserError, code="user.frames_exist"):
        FrameSet(folder)
    (folder / "frames.json").unlink()
    write_clicks(folder / "clicks.yaml", ClicksFile("here"))
    write_clicks(tmp_path / "other.yaml", ClicksFile("there"))
    with raises(UserError, code="user.clicks_exist"):
        FrameSet(folder, tmp_path / "other.yaml")


def test_a_wrong_file_of_clicks_is_named(folder: Path) -> None:
    (folder / "clicks.yaml").write_text("place: bench\nframes: {'000000': {end: []}}\n")
    with raises(ConfigError):
        FrameSet(folder)
    write_clicks(folder / "clicks.yaml", ClicksFile("bench", frames={"000099": ClickedFrame(no_tool=True)}))
    with raises(UserError, code="user.clicks_file"):
        FrameSet(folder)

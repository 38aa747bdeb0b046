"""A station file with several nails: read, completed, refused where it cannot be; one with a single nail as ever."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from tests.nails import with_nails
from toolee_robot.control.collision_shapes import nail_bodies, station_bodies
from toolee_robot.frames import angle_between, inverse, is_rigid, transform_points
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.station import NailConfig, StationConfig, load_station, sim_station
from toolee_robot.tasks.common.outcome import Outcome
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tasks.hammering.task import HammeringTask

BLOCK = [0.08, 0.14, 0.06]
LEFT = {"name": "left", "xy": [0.75, 0.14]}
RIGHT = {"name": "right", "xy": [0.75, 0.06], "protrusion": 0.015}


def _load(folder: Path, work: dict[str, object], frame: str = "base_link") -> StationConfig:
    path = folder / "station.yaml"
    path.write_text(yaml.safe_dump({"frame": frame, "work": {"block_size": BLOCK, **work}}))
    return load_station(path)


def test_several_nails_have_sizes_of_their_own_or_those_of_all(tmp_path: Path) -> None:
    work = _load(tmp_path, {"nails": [LEFT, RIGHT], "nail_protrusion": 0.018}).work
    assert work.names == ("left", "right")
    assert work.block_center == pytest.approx((0.75, 0.10))
    heights = {name: one.nail_protrusion for name, one in work.each()}
    assert heights == {"left": 0.018, "right": 0.015}
    X = work.only("right").X_base_nail()
    np.testing.assert_allclose(X[:3, 3], [0.75, 0.06, work.wood_height + 0.015])
    assert [body.name for body in nail_bodies(work, ["left"])] == ["nail left"]


def test_one_nail_is_written_as_ever(tmp_path: Path) -> None:
    work = _load(tmp_path, {"nail_xy": [0.7, 0.05]}).work
    assert work.names == ("nail",)
    assert work.only("nail") == work
    assert work.block_center == work.nail_xy == (0.7, 0.05)


def test_the_pendants_frame_holds_for_every_nail(tmp_path: Path) -> None:
    def there(sign: int) -> dict[str, object]:
        nails = [
            {**nail, "xy": [sign * x for x in nail["xy"]], "lean": [sign * 0.02, sign * -0.03]}  # type: ignore[attr-defined]
            for nail in (LEFT, RIGHT)
        ]
        return {"nails": nails, "block_xy": [sign * 0.75, sign * 0.10], "wood_rise": [sign * 0.01, 0.0]}

    assert _load(tmp_path, there(-1), "pendant_base") == _load(tmp_path, there(1))


def test_the_wood_moves_with_its_nails() -> None:
    work = sim_station().work
    work = with_nails(work, NailConfig("a", (0.74, 0.10)), NailConfig("b", (0.78, 0.10)))
    moved = work.moved(0.01, -0.02, 0.003)
    for name in work.names:
        way = moved.only(name).X_base_nail()[:3, 3] - work.only(name).X_base_nail()[:3, 3]
        np.testing.assert_allclose(way, [0.01, -0.02, 0.003], atol=1e-12)
    assert np.subtract(moved.block_center, work.block_center) == pytest.approx((0.01, -0.02))


WORK = sim_station().work
Z = np.array([0.0, 0.0, 1.0])
_slope = st.floats(-0.06, 0.06)
_slopes = st.tuples(_slope, _slope)


@examples(50)
@given(_slopes, _slopes, st.floats(0.0, 0.03))
def test_the_nail_is_on_the_wood_and_along_its_axis(
    rise: tuple[float, float], lean: tuple[float, float], height: float
) -> None:
    work = replace(WORK, nail_xy=(0.76, 0.09), block_xy=(0.75, 0.1), wood_rise=rise, nail_lean=lean)
    X, entry = work.X_base_nail(height), work.p_base_entry
    assert is_rigid(X)
    np.testing.assert_allclose(X[:3, 3] - entry, -height * X[:3, 2], atol=1e-12)
    top = work.X_base_block[:3, 3] + work.block_size[2] / 2 * work.wood_normal
    np.testing.assert_allclose(top, [0.75, 0.1, work.wood_height], atol=1e-12)
    assert abs(work.wood_normal @ (entry - top)) < 1e-12, "it meets the wood in its plane"
    np.testing.assert_allclose(X[:2, 2] / X[2, 2], np.subtract(lean, rise), atol=1e-12)
    if lean == (0.0, 0.0):
        assert angle_between(-X[:3, 2], work.wood_normal) < 1e-9
    upright = replace(WORK, nail_xy=(0.76, 0.09), block_xy=(0.75, 0.1)).X_base_nail(height)
    np.testing.assert_array_equal(upright[:3, :3], np.diag([1.0, -1.0, -1.0]))


def test_several_nails_lean_each_for_itself_and_stand_at_the_height_of_the_wood_there() -> None:
    work = with_nails(
        replace(WORK, block_size=(0.08, 0.14, 0.06), wood_rise=(0.0, 0.05), nail_lean=(0.02, 0.0)),
        NailConfig("left", (0.75, 0.14)),
        NailConfig("right", (0.75, 0.06), lean=(0.0, 0.0)),
    )
    left, right = (work.only(name) for name in ("left", "right"))
    assert left.p_base_entry[2] - right.p_base_entry[2] == pytest.approx(0.05 * 0.08)
    np.testing.assert_allclose(left.nail_axis[:2] / left.nail_axis[2], [0.02, -0.05])
    np.testing.assert_allclose(right.nail_axis, right.wood_normal)


def test_the_block_is_tilted_where_collisions_are_looked_for() -> None:
    config = replace(sim_station(), work=replace(WORK, wood_rise=(0.15, 0.0)))
    block = next(body for body in station_bodies(config) if body.name == "block")
    top = inverse(block.X_joint_shape) @ [*config.work.block_center, config.work.wood_height, 1.0]
    np.testing.assert_allclose(top[:3], [0.0, 0.0, config.work.block_size[2] / 2], atol=1e-9)
    assert angle_between(block.X_joint_shape[:3, 2], Z) == pytest.approx(np.arctan(0.15))


@examples(50)
@given(st.floats(-np.pi / 2, np.pi / 2), st.floats(-0.6, 0.6), st.floats(0.0, 0.4))
def test_block_and_stand_are_turned_and_the_stand_is_between_table_and_block(
    turn: float, table: float, height: float
) -> None:
    work = replace(WORK, block_xy=(0.75, 0.1), block_turn=turn, stand_height=table + height, stand_size=(0.07, 0.03))
    scene = replace(sim_station().scene, table_center=(0.5, 0.2), table_height=table)
    bodies = {body.name: body for body in station_bodies(replace(sim_station(), work=work, scene=scene))}
    X, size = work.stand_box(table)
    top, foot = (X @ [0.0, 0.0, sign * size[2] / 2, 1.0] for sign in (1, -1))
    np.testing.assert_allclose(top[:3], [0.75, 0.1, table + height], atol=1e-9)
    assert foot[2] == pytest.approx(table, abs=1.1e-3), "a block on the table itself has a stand of 1 mm"
    along = [np.cos(turn), np.sin(turn), 0.0]
    for name in ("stand", "block"):
        np.testing.assert_allclose(bodies[name].X_joint_shape[:3, 0], along, atol=1e-9)
    table_top = bodies["table"].X_joint_shape @ [0.0, 0.0, 0.05, 1.0]
    np.testing.assert_allclose(table_top[:3], [0.5, 0.2, table], atol=1e-9)


def test_a_nail_is_in_the_wood_of_the_turned_block() -> None:
    """In the corner of a block of 80 mm that is turned by 45 degrees, which reaches 57 mm along x."""
    corner = replace(WORK, block_xy=(0.75, 0.1), nail_xy=(0.80, 0.1), block_turn=np.pi / 4)
    assert inverse(corner.X_base_block)[:3, :3] @ [1.0, 0.0, 0.0] == pytest.approx([0.5**0.5, -(0.5**0.5), 0.0])
    with pytest.raises(ValueError, match="outside the block"):
        replace(corner, block_turn=0.0)


@pytest.mark.nightly
@pytest.mark.sim(seconds=60)
def test_a_job_strikes_below_the_base_of_a_robot_on_a_pedestal() -> None:
    """The wood is 90 mm under the base plane, on a block that is turned."""
    config = sim_station()
    scene = replace(config.scene, table_height=-0.35, workspace_lower=(-1.0, -1.2, -0.30))
    work = replace(config.work, stand_height=-0.15, block_turn=0.5, nail_protrusion=0.006)
    config = replace(config, scene=scene, work=work)
    with SimStation.build(config, 100, SimOptions()) as simulation:
        task = HammeringTask(
            simulation.station, PerfectPerception(simulation.judge), config, nominal_grasp(simulation.tool, config)
        )
        result = task.run()
        assert result.outcome is Outcome.FLUSH, result.reason
        assert simulation.judge.verdict(result.estimates).worst().outcome == "flush"
        frame = simulation.station.camera.read()
    rows, columns = np.nonzero(frame.depth > 0)
    points = frame.intrinsics.rays(np.stack([columns, rows], axis=-1)) * frame.depth[rows, columns, None]
    heights = transform_points(config.camera.uncalibrated.X_base_camera, points)[:, 2]
    assert np.mean(np.abs(heights + 0.35) < 0.01) > 0.02, "the camera sees the lower table"
    assert np.mean(np.abs(heights) < 0.01) < 0.02, "and none at the base plane"


@pytest.mark.nightly
@pytest.mark.sim(seconds=60)
def test_a_job_strikes_along_a_nail_that_leans_in_wood_that_is_not_level() -> None:
    work = replace(WORK, nail_protrusion=0.006, wood_rise=(0.04, -0.03), nail_lean=(-0.05, 0.04))
    config = replace(sim_station(), work=work)
    with SimStation.build(config, 100, SimOptions()) as simulation:
        task = HammeringTask(
            simulation.station, PerfectPerception(simulation.judge), config, nominal_grasp(simulation.tool, config)
        )
        result = task.run()
        assert result.outcome is Outcome.FLUSH, result.reason
        verdict = simulation.judge.verdict(result.estimates)
        nail = verdict.worst()
        assert nail.outcome == "flush"
        assert nail.lean_deg == pytest.approx(np.rad2deg(angle_between(work.nail_axis, work.wood_normal)), abs=1.5)
        tilts = [strike.tilt_deg for strike in simulation.judge.strikes]
    assert angle_between(work.nail_axis, Z) > np.deg2rad(6.5)
    assert max(tilts[:2]) < 0.5, "along the nail"
    assert max(tilts) < 6.0, "square to the wood in the end"

"""Errors of a cell: as large as they say, independent of each other, and none where none is wanted."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from toolee_robot.config import StationConfig, load_station
from toolee_robot.end_effectors import Category
from toolee_robot.frames import inverse, rotation_angle
from toolee_robot.robots import load_robot
from toolee_robot.robots.dh import DhParameters
from toolee_robot.sim_backend.cell_errors import EXACT, NOMINAL, CellErrors, draw_errors
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.tools import NAIL_DRIVERS, make_tool
from toolee_robot.types import Payload

CONFIG, USUAL = StationConfig(), SimOptions()
SEEDS = range(400)
MOUNTED = Path(__file__).parents[2] / "examples" / "mount.yaml"


def test_without_errors_the_job_is_told_what_is_there() -> None:
    tool = make_tool(NAIL_DRIVERS[0], 5)
    errors = draw_errors(EXACT, 3)
    told = errors.displaced(CONFIG)
    np.testing.assert_allclose(told.camera.X_base_camera, CONFIG.camera.X_base_camera, atol=1e-12)
    assert told.work == CONFIG.work
    data = errors.measured(tool, "hammer")
    np.testing.assert_allclose(data.X_tool_face[:3, 3], tool.ee(Category.HAMMER_HEAD).X_tool_ee[:3, 3])
    assert (data.mass, data.grip_radius) == (tool.mass, tool.handle.grip_radius)
    assert (set(errors.options(USUAL).nail_leans), errors.options(USUAL).friction) == ({(0.0, 0.0)}, USUAL.friction)
    assert told.arm == CONFIG.arm
    assert errors.weighed(CONFIG) == CONFIG
    assert errors.options(USUAL).wrench_errors == 0.0
    assert errors.made_of(CONFIG) == CONFIG
    assert set(errors.facts.values()) == {0.0}


def test_the_errors_are_as_large_as_they_say() -> None:
    X = CONFIG.camera.X_base_camera
    told = [draw_errors(NOMINAL, seed).displaced(CONFIG) for seed in SEEDS]
    off = [inverse(X) @ other.camera.X_base_camera for other in told]
    assert np.sqrt(np.mean([np.sum(x[:3, 3] ** 2) for x in off]) / 3) == pytest.approx(NOMINAL.camera_position, rel=0.1)
    turned = np.sqrt(np.mean([rotation_angle(x[:3, :3]) ** 2 for x in off]) / 3)
    assert turned == pytest.approx(NOMINAL.camera_rotation, rel=0.1)
    beside = np.array([other.work.nail_xy for other in told]) - CONFIG.work.nail_xy
    assert np.std(beside, axis=0) == pytest.approx([NOMINAL.nail_beside] * 2, rel=0.15)
    heights = [other.work.stand_height for other in told]
    assert np.std(heights) == pytest.approx(NOMINAL.nail_height, rel=0.15)
    leans = [draw_errors(NOMINAL, seed).options(USUAL).nail_leans[0] for seed in SEEDS]
    assert np.std(leans, axis=0) == pytest.approx([NOMINAL.nail_lean] * 2, rel=0.15)
    assert len(set(draw_errors(NOMINAL, 3).options(USUAL).nail_leans)) > 2, "each nail leans for itself"
    gravity = [draw_errors(NOMINAL, seed).made_of(CONFIG).work.wood_specific_gravity for seed in SEEDS]
    assert np.std(gravity) / CONFIG.work.wood_specific_gravity == pytest.approx(NOMINAL.wood, rel=0.15)
    friction = [draw_errors(NOMINAL, seed).options(USUAL).friction for seed in SEEDS]
    assert np.std(friction) / USUAL.friction == pytest.approx(NOMINAL.friction, rel=0.15)
    tool = make_tool(NAIL_DRIVERS[0], 5)
    masses = [draw_errors(NOMINAL, seed).measured(tool, "hammer").mass for seed in SEEDS]
    assert np.std(masses) / tool.mass == pytest.approx(NOMINAL.scales, rel=0.15)


def test_the_hand_weighs_something_else_than_the_job_is_told() -> None:
    def weight(config: StationConfig) -> Payload:
        robot = load_robot(config.arm.model, None, config.hand)
        return robot.hand_payload(robot.hand_open)

    true = weight(CONFIG)
    told = weight(draw_errors(NOMINAL, 3).weighed(CONFIG))
    drawn = [draw_errors(NOMINAL, seed).hand for seed in SEEDS]
    assert told.mass == pytest.approx(true.mass * (1.0 + NOMINAL.payload * drawn[3]))
    np.testing.assert_allclose(told.center_of_mass, true.center_of_mass)
    assert np.mean(drawn) == pytest.approx(0.0, abs=0.15)
    assert np.std(drawn) == pytest.approx(1.0, rel=0.15)
    # A mount's data say what it weighs.
    mounted, errors = load_station(MOUNTED), draw_errors(NOMINAL, 3)
    assert weight(errors.weighed(mounted)).mass == pytest.approx(
        weight(mounted).mass * (1.0 + NOMINAL.payload * errors.hand), rel=1e-3
    )


def test_the_arm_is_not_where_its_calibration_says() -> None:
    q = np.array([0.3, -1.6, 1.9, -1.8, -1.57, 0.2])
    true = DhParameters.of(CONFIG.arm.model, None)
    told = [draw_errors(NOMINAL, seed).displaced(CONFIG).arm.calibration for seed in SEEDS]
    places = np.array([DhParameters.of(CONFIG.arm.model, dh).fk(q)[:3, 3] for dh in told])
    off = 1e3 * np.linalg.norm(places - true.fk(q)[:3, 3], axis=1)
    assert 0.4 < np.median(off) < 1.0
    assert max(off) < 3.0
    # A factory's calibration is kept, and off by as much.
    factory = replace(CONFIG, arm=replace(CONFIG.arm, calibration=told[0]))
    again = draw_errors(NOMINAL, 0).displaced(factory).arm.calibration
    assert again is not None
    assert told[0] is not None
    np.testing.assert_allclose(again.delta_d, 2.0 * np.array(told[0].delta_d))


def test_a_seed_keeps_the_errors_that_it_had() -> None:
    """Those of jobs that were run before the nail leaned."""
    facts = draw_errors(NOMINAL, 7401).facts
    assert (facts["camera_mm"], facts["nail_beside_mm"], facts["face_mm"]) == (3.116, 1.042, 2.058)
    assert (facts["mass_percent"], facts["balance_mm"]) == (-1.249, 2.585)


@pytest.mark.parametrize("name", [field.name for field in fields(CellErrors)])
def test_another_size_of_one_error_leaves_the_others_as_they_were(name: str) -> None:
    """Trials of one seed are paired: a curve over one error changes nothing else."""
    usual = draw_errors(NOMINAL, 7)
    larger = draw_errors(replace(NOMINAL, **{name: 3.0 * getattr(NOMINAL, name)}), 7)
    changed = {fact: (value, larger.facts[fact]) for fact, value in usual.facts.items() if larger.facts[fact] != value}
    # The ruler measures both the face's place and the handle.
    assert set(changed) <= {"face_mm", "handle_mm"} if name == "ruler" else len(changed) == 1, changed
    for value, grown in changed.values():
        assert value is not None
        assert grown == pytest.approx(3.0 * value, rel=0.02)


def test_a_calibrations_covariance_takes_the_place_of_the_cameras_sizes() -> None:
    known = draw_errors(NOMINAL, 7, np.zeros((6, 6)))
    assert (known.facts["camera_mm"], known.facts["camera_deg"]) == (None, None)
    np.testing.assert_array_equal(known.camera, np.zeros(6))
    np.testing.assert_array_equal(known.nail, draw_errors(NOMINAL, 7).nail)


def test_sizes_are_checked_where_a_file_gives_them() -> None:
    sizes = TypeAdapter(CellErrors)
    assert sizes.validate_python({"camera_position": 0.005}) == replace(NOMINAL, camera_position=0.005)
    for wrong in ({"camera_position": -1.0}, {"camera": 1.0}):
        with pytest.raises(ValidationError):
            sizes.validate_python(wrong)

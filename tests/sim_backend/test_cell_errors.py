"""Errors of a cell: as large as they say, independent of each other, and none where none is wanted."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from toolee_robot.end_effectors import Category
from toolee_robot.frames import inverse, rotation_angle
from toolee_robot.robots import load_robot
from toolee_robot.robots.urdf import DhParameters
from toolee_robot.sim_backend.cell_errors import EXACT, NOMINAL, CellErrors, draw_errors
from toolee_robot.sim_backend.options import InHandOffset, SimOptions
from toolee_robot.sim_backend.station import draw_handover
from toolee_robot.station import StationConfig, load_station, sim_station
from toolee_robot.tools import NAIL_DRIVERS, make_tool
from toolee_robot.types import Payload

CONFIG, USUAL = sim_station(), SimOptions()
SEEDS = range(400)
MOUNTED = Path(__file__).parents[2] / "examples" / "mount.yaml"


def test_without_errors_the_job_is_told_what_is_there() -> None:
    tool = make_tool(NAIL_DRIVERS[0], 5)
    errors = draw_errors(EXACT, 3)
    told = errors.displaced(CONFIG)
    np.testing.assert_allclose(told.camera.X_base_camera, CONFIG.camera.X_base_camera, atol=1e-12)
    assert told.work == CONFIG.work
    data = errors.measured(tool, "hammer")
    assert data.X_tool_face is not None
    np.testing.assert_allclose(data.X_tool_face[:3, 3], tool.ee(Category.HAMMER_HEAD).X_tool_ee[:3, 3])
    assert (data.mass, data.grip_radius) == (tool.mass, tool.handle.grip_radius)
    assert (set(errors.options(USUAL).nail_leans), errors.options(USUAL).friction) == ({(0.0, 0.0)}, USUAL.friction)
    assert told.arm == CONFIG.arm
    assert errors.weighed(CONFIG) == CONFIG
    assert errors.options(USUAL).wrench_errors == 0.0
    assert errors.made_of(CONFIG) == CONFIG
    assert {value for fact, value in errors.facts.items() if not fact.startswith("handover_")} == {0.0}
    assert errors.offset == draw_errors(NOMINAL, 3).offset, "how the hammer lies in the hand nobody tells it"


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
    assert np.std(np.array(masses, float)) / tool.mass == pytest.approx(NOMINAL.scales, rel=0.15)


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
    sizes = replace(NOMINAL, other_tool=0.3)  # it can be nominally 0 and not be 3
    usual = draw_errors(sizes, 7)
    larger = draw_errors(replace(sizes, **{name: 3.0 * getattr(sizes, name)}), 7)
    changed = {fact: (value, larger.facts[fact]) for fact, value in usual.facts.items() if larger.facts[fact] != value}
    # The ruler measures both the face's place and the handle; a person shifts, turns and tilts the hammer at once.
    several = {
        "ruler": {"face_mm", "handle_mm"},
        "handover": {"handover_mm", "handover_spin_deg", "handover_tilt_deg"},
    }
    assert set(changed) == several[name] if name in several else len(changed) == 1, changed
    for value, grown in changed.values():
        assert value is not None
        assert grown == pytest.approx(3.0 * value, rel=0.02)


def test_a_calibrations_covariance_takes_the_place_of_the_cameras_sizes() -> None:
    known = draw_errors(NOMINAL, 7, np.zeros((6, 6)))
    assert (known.facts["camera_mm"], known.facts["camera_deg"]) == (None, None)
    np.testing.assert_array_equal(known.camera, np.zeros(6))
    np.testing.assert_array_equal(known.nail, draw_errors(NOMINAL, 7).nail)


def test_a_seed_keeps_the_place_in_the_hand_that_it_had() -> None:
    for seed in range(5):
        _, without_errors = draw_handover(seed, USUAL)
        _, nominal = draw_handover(seed, draw_errors(NOMINAL, seed).options(USUAL))
        assert nominal == without_errors


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.floats(0.0, 3.0))
def test_the_handover_s_size_is_a_factor_on_its_range(seed: int, size: float) -> None:
    nominal, sized = (draw_errors(replace(NOMINAL, handover=each), seed).offset for each in (1.0, size))
    for name, most in (("along", 0.03), ("spin", 0.4364), ("tilt_x", 0.2095), ("tilt_y", 0.2095)):
        assert abs(getattr(nominal, name)) <= most
        assert getattr(sized, name) == pytest.approx(size * getattr(nominal, name))
    assert draw_errors(replace(NOMINAL, handover=0.0), seed).offset == InHandOffset(), "as it is asked for"


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), share=st.floats(0.0, 1.0))
def test_the_data_of_another_hammer_are_told_by_a_share(seed: int, share: float) -> None:
    tool = make_tool(NAIL_DRIVERS[seed % len(NAIL_DRIVERS)], seed)
    own, part, other = (
        draw_errors(replace(EXACT, other_tool=each), seed).measured(tool, "hammer") for each in (0.0, share, 1.0)
    )
    for name in ("grip_radius", "face", "face_normal", "mass", "center_of_mass"):
        mine, theirs = np.array(getattr(own, name)), np.array(getattr(other, name))
        np.testing.assert_allclose(getattr(part, name), (1.0 - share) * mine + share * theirs, atol=1e-12)
    assert part.X_tool_face is not None
    again = draw_errors(replace(EXACT, other_tool=1.0), seed).measured(make_tool(tool.kind, seed + 1), "hammer")
    assert replace(again, name=other.name) == other, "it is another hammer of the kind, whatever is handed over"


@pytest.mark.nightly
def test_another_hammer_is_off_by_more_than_a_ruler_and_scales() -> None:
    tool = make_tool(NAIL_DRIVERS[0], 5)
    told = [draw_errors(replace(EXACT, other_tool=1.0), seed).measured(tool, "hammer") for seed in range(40)]
    true = draw_errors(EXACT, 0).measured(tool, "hammer")
    face = np.linalg.norm(np.array([data.face for data in told]) - true.face, axis=1)
    assert np.median(face) > 5.0 * NOMINAL.ruler
    mass = np.array([data.mass for data in told]) / true.mass - 1.0
    assert np.median(abs(mass)) > 5.0 * NOMINAL.scales


def test_sizes_are_checked_where_a_file_gives_them() -> None:
    sizes = TypeAdapter(CellErrors)
    assert sizes.validate_python({"camera_position": 0.005}) == replace(NOMINAL, camera_position=0.005)
    for wrong in ({"camera_position": -1.0}, {"camera": 1.0}, {"other_tool": 1.1}):
        with pytest.raises(ValidationError):
            sizes.validate_python(wrong)

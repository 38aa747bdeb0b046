"""The station's physics against MuJoCo, and its own sweeps. Their tables: python -m tests.cross_checks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.cross_checks.free_head import in_mujoco, in_pybullet, wire_mass
from tests.cross_checks.grip_sweep import Case, cases, hammers, lost_by_arithmetic, series
from tests.cross_checks.held_hammer import Rig
from tests.cross_checks.tables import (
    BAD_HITS,
    BY_FRICTION,
    HELD,
    MASSES,
    SPEC,
    SPEEDS,
    THICK,
    by_friction,
    held_strikes,
)
from tests.sim_backend.physics.energy_balance import driven_by
from toolee_robot.sim_backend.physics import grip
from toolee_robot.sim_backend.physics.wood import NailSpec
from toolee_robot.sim_backend.station import draw_hammer

pytestmark = [pytest.mark.sim, pytest.mark.nightly]


@pytest.mark.parametrize("spec", [SPEC, THICK], ids=["2.2 x 30", "3.1 x 65"])
@pytest.mark.parametrize("mass", MASSES)
@pytest.mark.parametrize("speed", SPEEDS)
def test_a_free_head_drives_a_nail_as_in_mujoco(spec: NailSpec, mass: float, speed: float) -> None:
    """0.022 mm off at most, and what a head drives a nail of its own mass in MuJoCo agrees with the energy balance."""
    ours, theirs = in_pybullet(spec, mass, speed), in_mujoco(spec, mass, speed)
    assert ours == pytest.approx(theirs, abs=3e-5)
    wire = in_mujoco(spec, mass, speed, nail=wire_mass(spec))
    assert wire == pytest.approx(driven_by(spec, spec.protrusion, 0.5 * mass * speed**2), rel=0.05)


@pytest.mark.parametrize(("offset", "tilt"), BAD_HITS)
def test_a_head_off_its_middle_or_tilted_drives_as_in_mujoco(offset: float, tilt: float) -> None:
    ours, theirs = (drive(SPEC, 0.6, 1.5, offset, np.deg2rad(tilt)) for drive in (in_pybullet, in_mujoco))
    assert ours == pytest.approx(theirs, rel=0.05)


@pytest.mark.parametrize(("name", "rig"), HELD, ids=[name for name, _ in HELD])
def test_a_held_hammer_strikes_and_slips_as_in_mujoco(name: str, rig: Rig) -> None:
    ours, theirs = held_strikes(rig)
    assert not ours.lost, name
    assert not theirs.lost
    assert ours.driven == pytest.approx(theirs.driven, rel=0.065)
    assert ours.along == pytest.approx(theirs.along, rel=0.07, abs=5e-5)
    assert ours.across == pytest.approx(theirs.across, abs=8e-4)
    assert ours.tilt == pytest.approx(theirs.tilt, rel=0.07, abs=np.deg2rad(0.3))
    assert ours.left == pytest.approx(theirs.left, rel=0.07, abs=np.deg2rad(0.4))
    assert ours.rebound == pytest.approx(theirs.rebound, abs=0.08)
    assert ours.yielded == pytest.approx(theirs.yielded, abs=np.deg2rad(1.0))


@pytest.mark.parametrize(("force", "friction"), BY_FRICTION)
def test_what_friction_alone_holds_in_mujoco_the_grip_holds_here(force: float, friction: float) -> None:
    """Rough, since a palm and four fingers are not the assisted grip: less drive here, and less slip."""
    ours, theirs = by_friction(force, friction)
    assert not ours.lost
    assert not theirs.lost
    assert 0.72 < ours.driven / theirs.driven < 1.1
    assert abs(ours.along - theirs.along) < 0.004
    assert ours.tilt < theirs.tilt + np.deg2rad(8.0)


@pytest.mark.parametrize("case", list(cases()), ids=str)
def test_no_hammer_is_lost_by_arithmetic(case: Case) -> None:
    """Numbers stay finite, and what is lost is lost with steps a quarter as long, too."""
    assert [tool.name for tool in hammers() if lost_by_arithmetic(tool, case)] == []


def test_the_sweep_would_see_a_loss_by_arithmetic(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains that ignore the tool's inertia, as they once did, lose the hammer that is lightest about its handle."""
    monkeypatch.setattr(grip, "STABILITY_NUMBER", np.inf)
    assert lost_by_arithmetic(draw_hammer(np.random.default_rng([151, 10])), Case(0.9, 100.0))


def test_firmer_fingers_and_more_friction_lose_fewer_hammers() -> None:
    def lost(case: Case) -> int:
        return sum(series(tool, case).lost for tool in hammers())

    assert lost(replace(Case(), finger_force=10.0)) > lost(Case()) == 0
    slips = [
        np.median([abs(strike.along) for tool in hammers() for strike in series(tool, Case(friction=mu)).strikes])
        for mu in (0.2, 0.6)
    ]
    assert slips[0] >= slips[1]

"""What shakes the arm while it feels its way, and what the job makes of it: on the simulated station itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.rigs.job_rig import CONFIG, Bench, at_rest, grip_kept
from tests.tasks.bench import Log, is_home
from tests.tasks.noisy_arm import Rig
from toolee_robot.hal import ArmState, ContactGuard, MotionReport, MotionWatch
from toolee_robot.perception.nail.sight import HeadOffset
from toolee_robot.sim_backend.physics.bodies import pb
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.outcome import HammerResult, Outcome, Strike
from toolee_robot.tasks.hammering.nail_driving import STRIKES_BEFORE_SECOND_LOOK
from toolee_robot.tasks.hammering.nail_gauge import (
    CLEAR,
    LEAST_RESISTANCE,
    MAX_DEPTH_PER_STRIKE,
    NailGauge,
    deepest_strike,
)
from toolee_robot.tasks.hammering.nail_watch import is_bent
from toolee_robot.tasks.hammering.touch import Contact, SidewaysContactError, Touch
from toolee_robot.types import Trajectory

pytestmark = pytest.mark.sim(seconds=50)


def knock_at_the_wood(bench: Bench, monkeypatch: pytest.MonkeyPatch, force: float, seconds: float) -> None:
    """The first time that the arm feels for the wood, the hand is pushed up [N] for so long, far from the wood."""
    world, execute, touches = bench.sim.world, bench.arm.execute, [0]
    until = [0.0, 0.0]

    def push(_dt: float) -> None:
        if until[0] <= world.time < until[1]:
            body, link = world.robot.body, world.robot.sensor_link
            at = world.robot.link_pose(link)[:3, 3].tolist()
            pb.applyExternalForce(body, link, [0.0, 0.0, force], at, pb.WORLD_FRAME, physicsClientId=world.client)

    def touch(
        trajectory: Trajectory, guard: ContactGuard | None = None, watch: MotionWatch | None = None
    ) -> MotionReport:
        if guard is not None and guard.averaging_window > 0.0:
            touches[0] += 1
            if touches[0] == 2:
                # From the middle of a step: just so many steps, however the clock is rounded.
                until[:] = world.time + 0.0605, world.time + 0.0605 + seconds
        return execute(trajectory, guard, watch)

    world.before_step.append(push)
    monkeypatch.setattr(bench.arm, "execute", touch)


def measured(bench: Bench, log: Log, result: HammerResult) -> None:
    """The one strike was done, and measured as it is."""
    assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
    (strike,) = log.strikes
    assert strike.protrusion == pytest.approx(bench.sim.world.nail.protrusion, abs=0.001)


@pytest.mark.nightly
def test_a_head_that_stands_higher_than_expected_ends_the_fast_way(bench: Bench) -> None:
    """What was expected 12 mm lower is met fast, and then touched slowly from the start."""
    rig = Rig(bench, 1, scale=0.0)
    gauge = NailGauge(rig.motions, CONFIG)
    protrusion = bench.sim.world.nail.protrusion
    rig.go_over(CLEAR)
    measured, rig.held = gauge.measure(protrusion, rig.held)
    assert measured == pytest.approx(protrusion, abs=0.001)
    rig.back_over(CLEAR)
    assert gauge.measure(protrusion - 0.012, rig.held)[0] == pytest.approx(protrusion, abs=0.001)
    assert rig.log.motions.count("touch the nail") == 2


@pytest.mark.nightly
def test_what_later_touches_tell_of_the_stiffness_counts_for_earlier_ones(bench: Bench) -> None:
    rig = Rig(bench, 6)
    gauge = NailGauge(rig.motions, CONFIG)
    protrusion = bench.sim.world.nail.protrusion
    rig.go_over(CLEAR)
    first, rig.held = gauge.measure(protrusion, rig.held)
    touches = gauge.latest
    assert touches is not None
    rig.back_over(CLEAR)
    assert gauge.measure(protrusion, rig.held)[0] == pytest.approx(protrusion, abs=0.0015)
    assert gauge.protrusion(touches) == pytest.approx(protrusion, abs=0.0015)
    assert gauge.protrusion(touches) != first
    assert touches[0].height != touches[0].felt


@pytest.mark.nightly
def test_a_knock_of_one_cycle_is_no_wood(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A servo packet that comes late shakes the arm by 10 N for a cycle."""
    knock_at_the_wood(bench, monkeypatch, force=20.0, seconds=0.008)
    log = Log()
    measured(bench, log, bench.blind_task(log).run())
    assert log.motions.count("touch the wood") == 2  # before the strike and after it


@pytest.mark.nightly
def test_wood_that_was_felt_too_early_is_touched_again(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    knock_at_the_wood(bench, monkeypatch, force=30.0, seconds=0.08)
    log = Log()
    measured(bench, log, bench.blind_task(log).run())
    assert log.motions.count("touch the wood") == 3


@pytest.mark.nightly
@pytest.mark.parametrize(("touch", "begun"), [(1, 2), (3, 1)])
def test_a_tool_that_is_pressed_from_the_side_is_lifted_and_looked_at_again(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, touch: int, begun: int
) -> None:
    """At the first touch of the nail, and at that after a strike."""
    lower, touches = Touch.lower, [0]

    def pressed(self: Touch, what: str, reach: float, held: HeldTool) -> Contact | None:
        touches[0] += 1
        if touches[0] == touch:
            raise SidewaysContactError(11.0)
        return lower(self, what, reach, held)

    monkeypatch.setattr(Touch, "lower", pressed)
    log = Log()
    result = bench.seeing_task(log).run()
    (told,) = [message for message in log.messages if "on the tool's side" in message]
    assert told.startswith("something pressed on the tool's side with 11 N on the way to the nail")
    assert "see where the face is" in told
    assert told.endswith("looking again")
    assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
    assert log.motions.count("to the touch") == begun


@pytest.mark.nightly
@pytest.mark.parametrize(("swings", "outcome"), [(0.3, Outcome.OUT_OF_STRIKES), (np.inf, Outcome.DEVICE_FAULT)])
def test_an_arm_that_a_strike_has_left_swinging_is_waited_for_but_not_for_ever(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, swings: float, outcome: Outcome
) -> None:
    clock, state = bench.sim.station.clock, bench.arm.state
    since = [np.inf]

    def swinging(max_age: float = 0.1) -> ArmState:
        now = state(max_age)
        fast = since[0] <= clock.now() < since[0] + swings
        return replace(now, joints=replace(now.joints, qd=np.full(6, 0.14))) if fast else now

    monkeypatch.setattr(bench.arm, "state", swinging)
    log = Log(after={"strike": lambda: since.__setitem__(0, clock.now())})
    result = bench.blind_task(log).run()
    assert result.outcome is outcome
    if outcome is Outcome.DEVICE_FAULT:
        assert "the arm still moves" in result.reason
        assert log.motions[-1] == "strike"
        assert clock.now() - since[0] < 2.0


def test_a_heavy_hammer_may_drive_a_nail_deeper_before_it_counts_as_bent() -> None:
    assert deepest_strike(0.4, 1.2) == deepest_strike(0.8, 1.2) == MAX_DEPTH_PER_STRIKE
    assert deepest_strike(1.5, 1.2) * LEAST_RESISTANCE == pytest.approx(0.5 * 1.5 * 1.2**2)
    assert deepest_strike(1.5, 1.2) < 0.015, "a nail that stands 20 mm and falls over is still told"


USUAL = CONFIG.task.strikes_between_looks
LONG = replace(CONFIG, task=replace(CONFIG.task, max_strikes=20))


def test_a_nail_that_leans_as_it_was_set_is_not_struck(bench: Bench) -> None:
    nail = bench.sim.world.nail
    nail.place(nail.spec.protrusion, (0.0, np.deg2rad(25)))
    log = Log()
    result = bench.seeing_task(log).run()
    assert result.outcome is Outcome.BENT
    assert "the camera sees the nail lean" in result.reason
    assert not result.strikes
    assert is_home(bench.sim)
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


@pytest.mark.nightly
def test_a_lab_whose_camera_sees_it_wrongly_leaves_it_out(bench: Bench) -> None:
    nail = bench.sim.world.nail
    nail.place(nail.spec.protrusion, (0.0, np.deg2rad(25)))
    config = replace(CONFIG, task=replace(CONFIG.task, watch_nail=False))
    log = Log()
    result = bench.seeing_task(log, config).run()
    assert "the camera sees" not in result.reason
    assert "touch the nail" in log.motions


class Bending(Log):
    """Pushes the nail's head aside after the last strike before a look at the tool."""

    def __init__(self, bench: Bench, aside: float) -> None:
        super().__init__()
        self._bench, self._aside = bench, aside

    def strike(self, strike: Strike) -> None:
        super().strike(strike)
        if len(self.strikes) == USUAL:
            nail = self._bench.sim.world.nail
            nail.place(nail.protrusion, (float(np.arcsin(self._aside / nail.protrusion)), 0.0))


@pytest.mark.nightly
@pytest.mark.parametrize(("aside", "bent"), [(0.0, False), (0.004, True)])
def test_a_nail_that_strikes_have_bent_is_seen_and_struck_no_further_once_it_is_seen_again(
    bench: Bench, aside: float, bent: bool
) -> None:
    log = Bending(bench, aside)
    result = bench.seeing_task(log, LONG).run()
    if not bent:
        assert result.outcome is Outcome.FLUSH, result.reason
        assert not any("does not see the nail" in message for message in log.messages)
        return
    assert result.outcome is Outcome.BENT
    assert "the camera sees the nail's head" in result.reason
    assert "for the second time" in result.reason
    assert any("it may be bent" in message for message in log.messages), "it is told at the first look"
    assert len(result.strikes) == USUAL + STRIKES_BEFORE_SECOND_LOOK
    assert is_home(bench.sim)
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


def test_a_head_that_is_seen_aside_twice_but_not_on_the_same_side_is_none() -> None:
    def seen(angle: float, distance: float = 0.004) -> HeadOffset:
        return HeadOffset(distance * np.array([np.cos(angle), np.sin(angle)]), 0.0005**2 * np.eye(2))

    assert is_bent(seen(0.3), seen(1.0))
    assert not is_bent(seen(0.3), seen(2.5))
    assert not is_bent(seen(0.3), seen(0.3, distance=0.002)), "it is not aside at the next one"
    assert not is_bent(seen(0.3), None)
    assert not is_bent(None, seen(0.3))

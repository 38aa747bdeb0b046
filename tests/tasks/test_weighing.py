"""Jobs with a hammer of which nobody has measured anything: the arm weighs it, and the camera finds its face."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from tests.examples import examples
from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control import RobotModel
from toolee_robot.end_effectors import Category
from toolee_robot.errors import LimitError, UserError
from toolee_robot.frames import inverse
from toolee_robot.hal import HandState, MotionReport
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.devices.arm import SimArm
from toolee_robot.sim_backend.station import draw_hammer
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import CollisionDetection
from toolee_robot.sim_backend.world import Sample
from toolee_robot.station import StationConfig, ToolData, sim_station
from toolee_robot.tasks.common.observer import HandCourse, TaskObserver
from toolee_robot.tasks.common.outcome import Outcome, Stage
from toolee_robot.tasks.hammering.grasp import UNKNOWN_FACE, UNKNOWN_FACE_OFF, measured_grasp
from toolee_robot.tasks.hammering.task import HammeringTask
from toolee_robot.tasks.hammering.weighing import since_empty
from toolee_robot.types import ArmModel, Payload

pytestmark = pytest.mark.sim(seconds=120)

UNKNOWN = ToolData("old hammer", None, None, None, None, None)
SEED = 100
ERRORS = SimOptions(wrench_errors=1.0)
"""Noise, offset and drift of the wrench as of the arm's generation."""


class Enough(Exception):
    """Ends the job."""


class Until(TaskObserver):
    """Ends the job as a stage begins; keeps messages and speeds of the flange; does something after a motion."""

    def __init__(self, stage: Stage | None = None) -> None:
        self.stage = stage
        self.after: dict[str, Callable[[], None]] = {}
        self.messages: list[str] = []
        self.fastest: dict[str, float] = {}
        self._robot = RobotModel.of_station(sim_station())

    def stage_started(self, stage: Stage) -> None:
        if stage is self.stage:
            raise Enough

    def message(self, text: str) -> None:
        self.messages.append(text)

    def motion(self, name: str, report: MotionReport, hand: HandCourse) -> None:  # noqa: ARG002
        flange = self._robot.arm.fk(report.q_commanded)[:, :3, 3]
        speed = np.linalg.norm(np.diff(flange, axis=0), axis=1) / np.diff(report.stamps)
        self.fastest[name] = max(self.fastest.get(name, 0.0), float(np.max(speed)))
        self.after.pop(name, _nothing)()


def _nothing() -> None: ...


@pytest.fixture
def never_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm that does not stop by itself, as it would by a reading that is six times as bad as a CB3's."""
    monkeypatch.setattr(CollisionDetection, "step", lambda *_: None)


def _task(simulation: SimStation, config: StationConfig, observer: TaskObserver | None = None) -> HammeringTask:
    perception = PerfectPerception(simulation.judge)
    return HammeringTask(
        simulation.station, perception, config, measured_grasp(UNKNOWN, config), observer=observer or TaskObserver()
    )


@pytest.mark.nightly
@pytest.mark.parametrize("model", ArmModel)
def test_the_arm_weighs_the_tool_and_is_told_its_weight(model: ArmModel, monkeypatch: pytest.MonkeyPatch) -> None:
    config = replace(sim_station(), arm=replace(sim_station().arm, model=model))
    observer, told = Until(Stage.VIEW), list[Payload]()
    with SimStation.build(config, SEED, ERRORS) as simulation:
        arm, tool, world = simulation.station.arm, simulation.tool, simulation.world
        take = arm.set_payload

        def noted(payload: Payload) -> None:
            take(payload)
            told.append(payload)

        monkeypatch.setattr(arm, "set_payload", noted)
        task = _task(simulation, config, observer)
        with suppress(Enough):
            task.run()
        weight = task.result(Outcome.INTERRUPTED, "enough").weight
        assert weight is not None
        assert abs(weight.mass - tool.mass) < 3.0 * weight.mass_sigma
        assert weight.mass_sigma < 0.15
        robot, q_hand = RobotModel.of_station(config), world.robot.hand_state()[0]
        X_base_flange = robot.fk(world.robot.arm_state()[0], q_hand)[0]
        center = (inverse(X_base_flange) @ world.X_base_tool() @ np.append(tool.center_of_mass, 1.0))[:3]
        off = weight.center_of_mass - center
        assert off @ np.linalg.solve(weight.center_covariance, off) < 14.0, "1 in 300"
        hand = robot.description.hand_payload(q_hand)
        assert told[0].mass == pytest.approx(hand.mass), "while it weighs"
        assert told[-1].mass == pytest.approx(hand.mass + weight.mass)
    assert any("weighs the tool" in text for text in observer.messages)
    for motion in ("to feel the empty hand", "to weigh the tool"):
        assert observer.fastest[motion] <= config.supervisor.handover_speed


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [SEED, 104])
def test_the_nail_is_driven_with_a_hammer_that_nobody_has_measured(seed: int) -> None:
    config = sim_station()
    with SimStation.build(config, seed, ERRORS) as simulation:
        result = _task(simulation, config).run()
        assert result.outcome is Outcome.FLUSH, result.reason
        verdict = simulation.judge.verdict(result.estimates)
        assert verdict.worst().outcome == "flush"
        assert Stage.WEIGH in result.stage_seconds
        assert result.weight is not None
        assert abs(result.weight.mass - simulation.tool.mass) < 3.0 * result.weight.mass_sigma


@pytest.mark.nightly
@pytest.mark.usefixtures("never_stops")
def test_a_weight_that_is_too_uncertain_is_not_struck_with() -> None:
    config = sim_station()
    with SimStation.build(config, SEED, replace(ERRORS, wrench_errors=6.0)) as simulation:
        observer = Until()
        task = _task(simulation, config, observer)
        result = task.run()
        assert result.outcome is Outcome.WEIGHT_UNKNOWN
        assert result.stage is Stage.WEIGH
        assert "on scales" in result.reason
        assert "Nothing opens it by itself" in result.reason
        assert not result.strikes
        assert list(observer.fastest) == ["to the handover", "to feel the empty hand", "to weigh the tool"], "and back"
        assert any("on scales" in text for text in observer.messages), "before it moves back"
        assert task.holds_tool
        assert task.give_back()


@pytest.mark.usefixtures("never_stops")
@pytest.mark.nightly  # the doubt itself is weighed in every run
def test_a_device_that_fails_on_the_way_back_does_not_hide_the_reason() -> None:
    config = sim_station()
    with SimStation.build(config, SEED, replace(ERRORS, wrench_errors=6.0)) as simulation:
        arm = simulation.station.arm
        assert isinstance(arm, SimArm)
        observer = Until()
        message = observer.message

        def stopped(text: str) -> None:
            message(text)
            if "on scales" in text:
                arm.protective_stop()

        observer.message = stopped  # type: ignore[method-assign]
        result = _task(simulation, config, observer).run()
        assert result.outcome is Outcome.DEVICE_FAULT
        assert any("on scales" in text for text in observer.messages)


@pytest.mark.nightly
def test_a_tool_heavier_than_the_job_is_planned_for_is_refused() -> None:
    config = sim_station()
    with SimStation.build(config, SEED, ERRORS) as simulation:
        observer = Until()
        grasp = replace(measured_grasp(UNKNOWN, config), mass=0.3)
        perception = PerfectPerception(simulation.judge)
        result = HammeringTask(simulation.station, perception, config, grasp, observer=observer).run()
        assert result.outcome is Outcome.WEIGHT_UNKNOWN
        assert "planned for at most 0.3 kg" in result.reason
        assert "home" not in observer.fastest


@pytest.mark.nightly  # another refusal is in every run
def test_a_tool_that_the_arm_cannot_carry_leaves_the_arm_at_the_handover(monkeypatch: pytest.MonkeyPatch) -> None:
    config = sim_station()
    with SimStation.build(config, SEED, ERRORS) as simulation:
        arm, observer = simulation.station.arm, Until()
        take, hand = arm.set_payload, RobotModel.of_station(config).description.hand_payload
        most = hand(simulation.world.robot.hand_state()[0]).mass + 0.2

        def limited(payload: Payload) -> None:
            if payload.mass > most:
                raise LimitError("too heavy", code="limit.payload")
            take(payload)

        monkeypatch.setattr(arm, "set_payload", limited)
        result = _task(simulation, config, observer).run()
        assert result.outcome is Outcome.WEIGHT_UNKNOWN
        assert "cannot carry" in result.reason
        assert "home" not in observer.fastest


@pytest.mark.nightly
def test_no_motion_to_weigh_the_tool_leaves_the_arm_at_the_handover(monkeypatch: pytest.MonkeyPatch) -> None:
    config = sim_station()

    def blocked(*_: object) -> None:
        raise LimitError("no way", code="limit.velocity")

    monkeypatch.setattr("toolee_robot.tasks.hammering.weighing.plan_wrist_turns", blocked)
    with SimStation.build(config, SEED, ERRORS) as simulation:
        observer = Until()
        result = _task(simulation, config, observer).run()
        assert result.outcome is Outcome.WEIGHT_UNKNOWN
        assert "no way" in result.reason
        assert list(observer.fastest) == ["to the handover"]


@given(age=st.floats(0.0, 1e4), model=st.sampled_from(list(ArmModel)))
def test_the_empty_hand_is_believed_less_with_time_and_after_a_reset(age: float, model: ArmModel) -> None:
    soon, later = since_empty(model, age, False), since_empty(model, age + 60.0, False)
    reset = since_empty(model, age, True)
    drift = ARM_DATA[model].wrench_drift
    assert all(a < b for a, b in zip(soon, later, strict=True))
    assert all(a >= b + c for a, b, c in zip(reset, soon, (0.999 * drift[0], 0.999 * drift[1]), strict=True))


@pytest.mark.nightly
def test_a_stop_while_the_tool_is_weighed_does_not_leave_it_unweighed() -> None:
    config = sim_station()
    with SimStation.build(config, SEED, ERRORS) as simulation:
        arm = simulation.station.arm
        assert isinstance(arm, SimArm)
        observer = Until()
        observer.after["to weigh the tool"] = arm.protective_stop
        task = _task(simulation, config, observer)
        result = task.run()
        assert result.outcome is Outcome.DEVICE_FAULT
        assert result.weight is None
        assert task.resumable
        arm.make_ready()
        observer.stage = Stage.VIEW
        with pytest.raises(Enough):  # it is weighed well enough for a strike
            task.resume(confirmed=True)
        weight = task.result(Outcome.INTERRUPTED, "enough").weight
        assert weight is not None
        assert abs(weight.mass - simulation.tool.mass) < 3.0 * weight.mass_sigma


@pytest.mark.nightly
@pytest.mark.parametrize(("blinks", "weighed"), [(1, True), (3, False)])
def test_a_doubt_about_the_grip_is_answered_by_weighing_again(
    blinks: int, weighed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tool may have moved. The third doubt needs a person."""
    config = sim_station()
    with SimStation.build(config, SEED, ERRORS) as simulation:
        hand, observer = simulation.station.hand, Until(Stage.VIEW)
        state, doubted = hand.state, [False]

        def blinking(**asked: float) -> HandState:
            told = state(**asked)
            if doubted[0] and told.holding and not asked:  # the watch asks so, not who only reads the fingers
                doubted[0] = False
                return replace(told, holding=False)
            return told

        def again() -> None:
            """In the midst of a motion after this one."""
            due = simulation.world.time + 1.0

            def watch(sample: Sample) -> None:
                nonlocal blinks
                if sample.stamp >= due and np.abs(simulation.world.robot.arm_state()[1]).max() > 0.1:
                    simulation.world.observers.remove(watch)
                    blinks, doubted[0] = blinks - 1, True

            if blinks:
                simulation.world.observers.append(watch)
                observer.after["to weigh the tool"] = again

        def keep(dt: float) -> None:
            """No faster than real time until the watch, a thread of its own, has asked."""
            if doubted[0]:
                time.sleep(dt)

        monkeypatch.setattr(hand, "state", blinking)
        simulation.world.before_step.append(keep)
        observer.after["to weigh the tool"] = again
        task = _task(simulation, config, observer)
        result = None
        with suppress(Enough):
            result = task.run()
        assert blinks == 0
        assert len([text for text in observer.messages if "weighing again" in text]) == (1 if weighed else 2)
        if weighed:
            weight = task.result(Outcome.INTERRUPTED, "enough").weight
            assert weight is not None
            assert abs(weight.mass - simulation.tool.mass) < 3.0 * weight.mass_sigma
        else:
            assert result is not None
            assert result.outcome is Outcome.DEVICE_FAULT
            assert "doubted its grip" in result.reason
            assert task.resumable


def test_without_a_look_an_unknown_face_is_not_struck_with() -> None:
    config = sim_station()
    with SimStation.build(config, SEED, ERRORS) as simulation, raises(UserError, code="user.unknown_face"):
        HammeringTask(simulation.station, None, config, measured_grasp(UNKNOWN, config))


@examples(10)
@given(seed=st.integers(0, 10**6))
def test_every_simulated_hammer_is_where_an_unknown_one_may_be(seed: int) -> None:
    face = draw_hammer(np.random.default_rng([seed, 10])).ee(Category.HAMMER_HEAD).X_tool_ee
    assert np.linalg.norm(face[:3, 3] - UNKNOWN_FACE[:3, 3]) <= UNKNOWN_FACE_OFF

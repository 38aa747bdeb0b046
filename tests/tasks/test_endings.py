"""Endings of the hammering job: each has its name and a reason, and leaves the arm at a standstill.

Those by a fault of a device, a person or the nail are rows of the fault table (`faults/rows/job_faults.py`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.examples import seldom
from tests.rigs.job_rig import CONFIG, Bench, at_rest, grip_kept
from tests.rigs.people import People, ScriptedPerception, unsure
from tests.tasks.bench import Log, is_home, soon
from toolee_robot.control import RobotModel
from toolee_robot.end_effectors import Category
from toolee_robot.errors import PerceptionError, UserError
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.station import CameraDevice, StationConfig
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.look import Views
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import Outcome, Stage
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tasks.hammering.handover import CLOSINGS
from toolee_robot.tasks.hammering.task import HammeringTask
from toolee_robot.types import CameraError, InHandEstimate, Payload, RgbdFrame, ToolEstimate

pytestmark = pytest.mark.sim(seconds=80)


@pytest.fixture(scope="module")
def empty() -> Iterator[SimStation]:
    """An empty hand, and nobody who brings a tool."""
    with SimStation.build(CONFIG, 0, SimOptions(hands_over=False)) as sim:
        yield sim


# -- nobody, nothing, too near -----------------------------------------------------------------------------------


@pytest.mark.nightly
def test_nobody_comes(empty: SimStation) -> None:
    log = Log()
    result = HammeringTask(
        empty.station, PerfectPerception(empty.judge), CONFIG, nominal_grasp(empty.tool, CONFIG), observer=log
    ).run()
    assert (result.outcome, result.strikes, result.protrusion) == (Outcome.NO_HANDOVER, (), None)
    assert result.stage is Stage.HANDOVER
    assert "Run the job again" in result.reason
    assert log.motions == ["to the handover", "home"]
    assert is_home(empty)
    assert at_rest(empty)


@pytest.mark.nightly
def test_the_hand_closes_on_nothing(empty: SimStation) -> None:
    people = People()  # who say that they laid a tool into the hand
    log = Log()
    result = HammeringTask(
        replace(empty.station, person=people),
        PerfectPerception(empty.judge),
        CONFIG,
        nominal_grasp(empty.tool, CONFIG),
        observer=log,
    ).run()
    assert result.outcome is Outcome.NO_GRIP
    assert "holds nothing" in result.reason
    assert people.asked == [*["handover"] * CLOSINGS, "release"], "it goes home only once they have stepped back"
    assert is_home(empty)
    assert at_rest(empty)


def test_the_tool_leaves_the_hand_as_it_is_let_go(bench: Bench) -> None:
    bench.people.on_release = bench.drop
    log = Log()
    result = bench.blind_task(log).run()
    assert result.outcome is Outcome.NO_GRIP
    assert "was released" in result.reason
    assert log.motions == ["to the handover", "home"]
    assert at_rest(bench.sim)


# -- devices ---------------------------------------------------------------------------------------------------


def test_a_stop_from_outside_ends_the_job(bench: Bench) -> None:
    log = Log(at={Stage.TOUCH: soon(bench, bench.arm.stop, 0.5)})
    result = bench.blind_task(log).run()
    assert result.outcome is Outcome.DEVICE_FAULT
    assert "'to the touch'" in result.reason
    assert log.motions == ["to the handover", "to the touch"]
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


# -- the tool in the hand ----------------------------------------------------------------------------------------


def test_the_tool_is_lost_in_a_motion(bench: Bench) -> None:
    """The arm retreats from where the tool may lie, and from the person's place, and no further."""
    ends: list[Array] = []
    log = Log(at={Stage.TOUCH: soon(bench, bench.drop, 0.3)})
    log.after["to the touch"] = lambda: ends.append(bench.sim.world.X_base_hand()[:3, 3])
    result = bench.blind_task(log).run()
    assert result.outcome is Outcome.TOOL_LOST
    assert "Pick it up" in result.reason
    assert log.motions[-2:] == ["to the touch", "retreat"]
    before, after = ends[0], bench.sim.world.X_base_hand()[:3, 3]
    person = np.array(CONFIG.scene.person_center)
    assert np.linalg.norm((after - person)[:2]) > np.linalg.norm((before - person)[:2]) + 0.05
    assert after[2] > before[2] + 0.1
    assert not is_home(bench.sim)
    assert at_rest(bench.sim)
    force = bench.arm.state().wrench[:3]
    assert np.linalg.norm(force) < 0.5 * 9.81 * bench.true_grasp.mass, "the arm knows that the hammer is gone"


@pytest.mark.parametrize(
    ("X", "reason"),
    [
        (transform(p=[0.13, 0.0, 0.0]), "130 mm and 0° outside"),
        (transform(R=np.diag([1.0, -1.0, -1.0])), "0 mm and 180° outside"),
        (np.full((4, 4), np.nan), "outside of where a held hammer can be"),
    ],
)
def test_a_pose_that_no_held_hammer_has_is_not_believed(bench: Bench, X: Array, reason: str) -> None:
    nominal = bench.true_grasp.X_hand_ee
    perceiver = ScriptedPerception(bench.sim.judge, lambda e: replace(e, X_hand_ee=nominal @ X))
    look = Views(CONFIG, RobotModel.load(), perceiver, Log(), _held(nominal))
    look.take(bench.station)
    with pytest.raises(PerceptionError, match=reason):
        look.fuse(0.0)


@pytest.mark.parametrize(
    ("millimetres", "sigma", "again"), [(3.0, 0.001, False), (9.0, 0.004, False), (9.0, 0.001, True)]
)
def test_a_look_tells_how_far_the_camera_is_off(bench: Bench, millimetres: float, sigma: float, again: bool) -> None:
    found = CameraError(np.array([0.0, 1e-3 * millimetres, 0.0, 0.0, 0.0, 0.0]), np.eye(6) * 1e-12)
    found.covariance[:3, :3] = np.eye(3) * sigma**2
    perceiver = ScriptedPerception(bench.sim.judge, lambda e: replace(e, camera=found))
    said = []
    for known in (None, found):
        log = Log()
        before = None if known is None else replace(_estimate(bench.true_grasp.X_hand_ee), camera=known)
        held = replace(_held(bench.true_grasp.X_hand_ee), seen=before)
        look = Views(CONFIG, RobotModel.load(), perceiver, log, held)
        look.take(bench.station)
        look.fuse(0.0)
        said.append([text for text in log.messages if "camera" in text])
    assert said[1] == [], "once a job"
    (text,) = said[0]
    assert f"{millimetres:.0f} ± {1e3 * sigma:.0f} mm at the tool (corrected)" in text
    assert ("Calibrate it again" in text) is again


@pytest.mark.nightly
@pytest.mark.parametrize("sees", [True, False])
def test_a_job_that_ends_without_a_pose_says_that_the_camera_is_too_near(bench: Bench, sees: bool) -> None:
    perceiver = ScriptedPerception(bench.sim.judge, unsure)
    perceiver.sees = sees
    result = bench.seeing_task(Log(), _with_least_range(0.6), perceiver).run()
    assert result.outcome is Outcome.POSE_UNKNOWN
    assert "The camera measures from 0.60 m (camera.device.least_range)" in result.reason
    assert "Use a smaller depth image" in result.reason
    assert ("sigma 31 mm" in result.reason) is sees
    told = float(result.reason.split(" m away")[0].split()[-1])
    assert 0.3 < told < 0.56


@pytest.mark.parametrize("least", [0.2, 0.6])
def test_a_camera_is_too_near_only_where_no_pose_was_found_within_its_least_range(bench: Bench, least: float) -> None:
    X_camera_hand = transform(p=[0.0, 0.0, 0.5]) @ inverse(bench.true_grasp.X_hand_ee)  # the face at 0.5 m
    scripted = ScriptedPerception(bench.sim.judge, lambda e: e, unsure)
    held = _held(bench.true_grasp.X_hand_ee)
    look = Views(_with_least_range(least), RobotModel.load(), scripted, Log(), held)
    look.add(bench.station.camera.read(), X_camera_hand)
    look.fuse(0.0)
    with pytest.raises(PerceptionError) as error:
        look.fuse(0.0)
    assert error.value.code == ("perception.too_near" if least == 0.6 else "perception.not_usable")
    assert ("In 1 of 1 views the face is only 0.50 m away" in str(error.value)) is (least == 0.6)


def _held(X_hand_ee: Array) -> HeldTool:
    return HeldTool.nominally(X_hand_ee, Payload(0.6, np.zeros(3)))


def _estimate(X_hand_ee: Array) -> InHandEstimate:
    return InHandEstimate(Category.HAMMER_HEAD, X_hand_ee, 1e-6 * np.eye(6), 0.9, 2, 2, True, "ok")


def _with_least_range(least: float) -> StationConfig:
    return replace(CONFIG, camera=replace(CONFIG.camera, device=CameraDevice("realsense", "832112070123", least)))


def test_a_detection_that_no_held_hammer_can_be_is_left_out(bench: Bench) -> None:
    perceiver = ScriptedPerception(bench.sim.judge, lambda e: e)
    far = bench.true_grasp.X_hand_ee @ transform(p=[0.0, 0.4, 0.0])
    look = Views(CONFIG, RobotModel.load(), perceiver, Log(), _held(far))
    look.take(bench.station)
    with pytest.raises(PerceptionError, match="where a held hammer cannot have it"):
        look.fuse(0.0)


@pytest.mark.nightly
def test_a_camera_whose_frames_perception_refuses_is_a_device_fault(bench: Bench) -> None:
    class Refuses(PerfectPerception):
        def estimate(self, frame: RgbdFrame, *_args: Any, **_kwargs: Any) -> list[ToolEstimate]:
            raise UserError(f"depth up to {1000 * frame.depth.max():.0f} m: it is in millimetres")

    result = bench.seeing_task(Log(), perceiver=Refuses(bench.sim.judge)).run()
    assert result.outcome is Outcome.DEVICE_FAULT
    assert "millimetres" in result.reason
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


def test_perception_stays_unsure(bench: Bench) -> None:
    log, perceiver = Log(), ScriptedPerception(bench.sim.judge, unsure)
    result = bench.seeing_task(log, perceiver=perceiver).run()
    assert result.outcome is Outcome.POSE_UNKNOWN
    assert "sigma 31 mm" in result.reason
    assert len(perceiver.hands) == 2, "it looks twice"
    assert np.abs(perceiver.hands[0] - perceiver.hands[1]).max() > 0.05, "and not twice from the same side"
    assert log.motions == ["to the handover", "to a view", "to a view", "home"]
    assert [m for m in log.messages if "looking again" in m]
    assert is_home(bench.sim)
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


# -- the nail --------------------------------------------------------------------------------------------------


def test_a_nail_out_of_reach_is_refused_before_anyone_is_asked(bench: Bench) -> None:
    config = replace(CONFIG, work=replace(CONFIG.work, nail_xy=(2.5, 0.1)))
    log = Log()
    result = bench.seeing_task(log, config).run()
    assert result.outcome is Outcome.NO_PLAN
    assert "move the block" in result.reason
    assert (bench.people.asked, bench.hand.opened, log.strikes) == ([], 0, [])
    assert set(log.motions) <= {"home"}
    assert at_rest(bench.sim)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"nail_xy": (0.785, 0.10)}, "expected nail and met nothing"),
        (
            {"nail_xy": (0.785, 0.10), "stand_height": CONFIG.work.stand_height - 0.006},
            "met nothing above the wood",
        ),
        ({"nail_protrusion": 0.012}, "mm too high"),
    ],
)
def test_the_nail_is_not_where_the_station_file_has_it(bench: Bench, change: dict[str, object], reason: str) -> None:
    config = replace(CONFIG, work=replace(CONFIG.work, **change))  # type: ignore[arg-type]
    log = Log()
    result = bench.seeing_task(log, config).run()
    assert result.outcome is Outcome.NAIL_MISSED
    assert reason in result.reason
    if "too high" in reason:  # by 8 mm; a touch is good to half a millimetre
        assert float(result.reason.split(" mm too high")[0].split()[-1]) == pytest.approx(8.0, abs=0.5)
    assert result.strikes == ()
    assert len(result.estimates) == 2, "it has looked again"
    assert "strike" not in log.motions
    assert is_home(bench.sim)
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


@pytest.mark.nightly
def test_a_nail_that_stops_just_over_the_wood_is_not_called_flush(bench: Bench) -> None:
    """1.3 mm over it, where 1.0 mm counts as flush, in wood that no strike drives it into."""
    nail, height = bench.sim.world.nail, 0.0013
    nail.spec = replace(nail.spec, specific_gravity=1.2, pilot_diameter=0.0)
    nail.place(height)
    config = replace(
        CONFIG, work=replace(CONFIG.work, nail_protrusion=height), task=replace(CONFIG.task, max_strikes=5)
    )
    result = bench.blind_task(Log(), config).run()
    assert nail.protrusion > CONFIG.task.flush_protrusion
    assert (result.outcome, result.stage) == (Outcome.STUCK, Stage.TOUCH)
    assert result.protrusion == pytest.approx(nail.protrusion, abs=0.0005)


@pytest.mark.nightly
def test_out_of_strikes_without_correction_and_without_perception(bench: Bench) -> None:
    log = Log()
    result = bench.blind_task(log).run()  # a perceiver that is asked fails the job
    assert result.outcome is Outcome.OUT_OF_STRIKES
    assert not result.success
    assert "after 1 strikes" in result.reason
    assert len(result.strikes) == 1
    assert result.protrusion == result.strikes[0].protrusion
    assert result.protrusion == pytest.approx(bench.sim.world.nail.protrusion, abs=0.001)
    assert result.protrusion is not None
    assert result.protrusion < CONFIG.work.nail_protrusion - 0.0005
    assert result.estimates == ()
    assert log.last is result
    assert log.motions[-1] == "home"
    assert is_home(bench.sim)
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)
    # Stages come one at a time, each ended before the next, and their times add up to what the result says.
    pairs = list(zip(log.stages[::2], log.stages[1::2], strict=True))
    assert all(begin == ("begin", end[1]) and end[0] == "end" for begin, end in pairs)
    assert set(result.stage_seconds) == {stage for _, stage in log.stages}
    assert next(iter(result.stage_seconds)) == Stage.HANDOVER
    assert list(result.stage_seconds)[-1] == Stage.PARK


# -- what escapes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("error", seldom(KeyboardInterrupt, ZeroDivisionError))
def test_an_interrupt_or_a_bug_in_mid_motion_stops_the_arm_and_escapes(
    bench: Bench, error: type[BaseException]
) -> None:
    def fail() -> None:
        raise error

    log = Log(at={Stage.TOUCH: soon(bench, fail, 0.5)})
    with pytest.raises(error):
        bench.blind_task(log).run()
    assert log.last is None
    assert not is_home(bench.sim)
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


def test_an_observer_that_raises_leaves_the_arm_at_rest(bench: Bench) -> None:
    class Broken(TaskObserver):
        def planned(self, *_args: object) -> None:
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        bench.blind_task(Broken()).run()
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)

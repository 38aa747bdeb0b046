"""What can be wrong with hand, camera, calibration, work and people, and what the job then does: it stands, and keeps
the grip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pybullet as pb
import pytest

from toolee_robot.config import CalibrationConfig, StationConfig
from toolee_robot.control import Meeting
from toolee_robot.faults.rigs.job_rig import CONFIG, Bench, Log, at_rest, grip_kept
from toolee_robot.frames import Array
from toolee_robot.tasks.common.outcome import HammerResult, Outcome, Stage

pytestmark = pytest.mark.sim(seconds=30)


def stands(bench: Bench, result: HammerResult, outcome: Outcome, expected_text: str) -> None:
    assert result.outcome is outcome
    assert expected_text in result.reason
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


# -- calibration ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("calibration", "expected_text"),
    [
        (None, "not calibrated"),
        (CalibrationConfig("2026-01-01", "20235012345", "simulated", 0.001, valid_days=None), "robot '20235012345'"),
        (CalibrationConfig("2026-01-01", "simulated", "F1370001", 0.001, valid_days=None), "camera 'F1370001'"),
        (CalibrationConfig("2020-01-01", "simulated", "simulated", 0.001), "days old"),
        (CalibrationConfig("2026-01-01", "simulated", "simulated", 0.02, valid_days=None), "residual"),
    ],
)
def test_a_calibration_that_does_not_hold_is_refused_before_anything_moves(
    bench: Bench, calibration: CalibrationConfig | None, expected_text: str
) -> None:
    log = Log()
    result = bench.blind_task(log, replace(CONFIG, calibration=calibration)).run()
    stands(bench, result, Outcome.NOT_READY, expected_text)
    assert "nothing was moved" in result.reason
    assert (log.motions, bench.people.asked, bench.hand.opened) == ([], [], 0)


# -- people ------------------------------------------------------------------------------------------------------


def test_a_tool_from_the_last_job_is_taken_out_of_the_hand_first(bench: Bench) -> None:
    bench.hand.closed = True
    bench.people.takes = False
    log = Log()
    result = bench.blind_task(log).run()
    stands(bench, result, Outcome.NOT_READY, "nobody took it")
    assert (log.motions, bench.people.asked, bench.hand.opened) == ([], ["take"], 0)
    bench.people.takes, bench.people.gives = True, False
    bench.people.asked.clear()
    result = bench.blind_task(Log()).run()
    assert result.outcome is Outcome.NO_HANDOVER
    assert bench.people.asked[:2] == ["take", "handover"]
    assert bench.hand.opened == 1


def test_the_enabling_switch_is_not_held(bench: Bench) -> None:
    bench.people.holds_switch = False
    log = Log()
    stands(bench, bench.blind_task(log).run(), Outcome.PERSON_NEAR, "enabling switch")
    assert log.motions == []


def test_somebody_is_still_inside_after_they_said_they_stepped_back(bench: Bench) -> None:
    bench.people.on_release = bench.people.step_in
    log = Log()
    stands(bench, bench.blind_task(log).run(), Outcome.PERSON_NEAR, "within the arm's reach")
    assert log.motions == ["to the handover"]


def test_nobody_confirms_the_first_swing(bench: Bench) -> None:
    bench.people.confirms = False
    log = Log()
    result = bench.blind_task(log).run()
    stands(bench, result, Outcome.PERSON_NEAR, "nobody confirmed that the arm may swing")
    assert bench.people.asked[-1] == "swing"
    assert log.motions[-1] == "to the run-up"
    assert result.strikes == ()


# -- hand ----------------------------------------------------------------------------------------------------------


def test_the_hand_does_not_close_in_time(bench: Bench) -> None:
    log = Log(after={"to the handover": lambda: setattr(bench.sim_hand, "hangs", True)})
    stands(bench, bench.blind_task(log).run(), Outcome.DEVICE_FAULT, "its grip too")
    assert log.motions == ["to the handover"]


@pytest.mark.parametrize(
    ("name", "value", "expected_text"),
    [("temperature", 71.0, "71 deg C"), ("fault", "index finger stalled", "finger stalled")],
)
def test_a_hand_that_is_hot_or_complains_gets_no_further_strike(
    bench: Bench, name: str, value: float | str, expected_text: str
) -> None:
    log = Log(after={"to the run-up": lambda: setattr(bench.sim_hand, name, value)})
    result = bench.blind_task(log).run()
    stands(bench, result, Outcome.DEVICE_FAULT, expected_text)
    assert log.motions[-1] == "to the run-up"
    assert result.strikes == ()


# -- camera --------------------------------------------------------------------------------------------------------


def test_a_camera_that_repeats_itself(bench: Bench) -> None:
    config = replace(CONFIG, task=replace(CONFIG.task, views=2))
    bench.camera.read()
    log = Log(at={Stage.VIEW: bench.camera.repeat})
    stands(bench, bench.seeing_task(log, config).run(), Outcome.DEVICE_FAULT, "repeats old ones")
    assert "strike" not in log.motions


def test_a_camera_without_depth_is_looked_through_again_and_then_no_more(bench: Bench) -> None:
    bench.camera.blinded = True
    log = Log()
    result = bench.seeing_task(log).run()
    assert result.outcome is Outcome.POSE_UNKNOWN
    assert len([m for m in log.messages if "depth is known" in m]) == 2
    assert "strike" not in log.motions
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


# -- work ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stays", [pytest.param(True, marks=pytest.mark.nightly), False])
def test_a_strike_that_meets_something_too_early_is_looked_at_again_once(bench: Bench, stays: bool) -> None:
    """A plate lies over the nail: the arm brakes on it, goes up, looks again, and strikes once more."""
    config: StationConfig = replace(CONFIG, task=replace(CONFIG.task, max_strikes=2))
    client, nail = bench.sim.world.client, CONFIG.work.X_base_nail()[:3, 3]
    plates: list[int] = []

    def lay(_: Array = nail) -> None:
        shape = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=[0.03, 0.03, 0.005], physicsClientId=client)
        plates.append(pb.createMultiBody(0.0, shape, -1, [*nail[:2], nail[2] + 0.10], physicsClientId=client))

    def take_away() -> None:
        while plates:
            pb.removeBody(plates.pop(), physicsClientId=client)

    after: dict[str, Callable[[], None]] = {"to the run-up": lay}
    if not stays:
        after["up"] = lambda: log.after.update(strike=lambda: log.after.update(up=take_away))
    log = Log(after=after)
    try:
        result = bench.seeing_task(log, config).run()
    finally:
        take_away()
    assert [m for m in log.messages if "looking again" in m]
    assert len(result.estimates) == 2
    meetings = [b.meeting for b in result.strikes]
    if stays:
        assert result.outcome in (Outcome.NAIL_MISSED, Outcome.OUT_OF_STRIKES)
        assert meetings == [Meeting.EARLY, Meeting.EARLY]
        assert result.strikes[0].protrusion is None
    else:
        assert result.outcome is Outcome.OUT_OF_STRIKES
        assert meetings == [Meeting.EARLY, Meeting.EXPECTED]
        assert result.protrusion == pytest.approx(bench.sim.world.nail.protrusion, abs=0.001)
    early = log.reports[log.motions.index("strike")]
    assert early.contact is not None
    # It braked: from the contact on not further than it takes.
    assert np.sum(early.stamps > early.contact.stamp) < 60
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)

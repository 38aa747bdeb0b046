"""Faults in mid-swing: how soon the arm stands, where, latched, and the hammer still in the hand."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest

from tests.faults.record import Phase
from tests.faults.rows.job_fault import Scene
from tests.faults.rows.job_faults import JOB_FAULTS
from tests.rigs.job_rig import CONFIG, Bench, at_rest, grip_kept
from tests.rigs.people import ScriptedPerception
from tests.tasks.bench import Log, soon
from toolee_robot.control import CollisionWorld, Mode, RobotModel, StrikePlan, plan_strike
from toolee_robot.control.planning.straight import plan_straight
from toolee_robot.errors import (
    DeviceError,
    EmergencyStopError,
    GripError,
    LatchedError,
    LinkLostError,
    MotionFaultError,
    OverrunError,
    PersonNearError,
    ProtectiveStopError,
    StaleDataError,
    TrackingError,
)
from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport
from toolee_robot.sim_backend.devices.arm import HOLD_TIME, RATE
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.types import Trajectory

BRAKING = 0.168
"""[s] The longest stop of such a swing (tests/control/test_path_stop.py)."""
SETTLING = 0.05
"""[s] until the simulated motors have come to rest after the last command."""


@dataclass
class Swing:
    """The hammer held over the nail, and the strike that comes next."""

    bench: Bench
    robot: RobotModel
    plan: StrikePlan
    motions: Motions
    log: Log

    @property
    def scene(self) -> Scene:
        """What a row of the fault matrix may touch."""
        self.log.plan = self.plan
        return Scene(self.bench, self.log, ScriptedPerception(self.bench.sim.judge))

    def run(self) -> MotionReport:
        return self.motions.swing("strike", self.plan, self.motions.held)[0]

    def fails(self, error: type[MotionFaultError]) -> MotionReport:
        """The swing ends with this error; the arm stands and goes on standing, on its path, before the nail."""
        with pytest.raises(error) as caught:
            self.run()
        report = caught.value.report
        assert report is not None
        assert on_path(report.q_commanded, self.plan.strike) < 1e-3
        qd = np.diff(report.q_commanded, axis=0) * RATE
        assert np.abs(np.diff(qd, axis=0)).max() * RATE < 1.05 * CONFIG.arm.stop_acceleration.max()
        assert grip_kept(self.bench.sim)
        assert self.log.motions == ["strike"], "the recording has it, too"
        with pytest.raises(LatchedError):
            self.run()
        return report


def on_path(q: Array, path: Trajectory) -> float:
    """The greatest distance [rad] of rows q (N, 6) from a trajectory's path."""
    dense = np.array([path.sample(t)[0] for t in np.linspace(0.0, path.duration, 3000)])
    return max(float(np.abs(dense - row).max(axis=1).min()) for row in q)


@pytest.fixture(scope="module")
def over_nail() -> Iterator[tuple[Bench, StrikePlan]]:
    robot, bench = RobotModel.load(), Bench()
    with bench.sim:
        q, q_hand, X_hand_ee = bench.arm.state().q_commanded, bench.hand.state().joints.q, bench.true_grasp.X_hand_ee
        world = CollisionWorld(robot, CONFIG, q_hand, X_hand_ee)
        nail = CONFIG.work.X_base_nail()
        plan = plan_strike(robot, CONFIG, world, q, q_hand, X_hand_ee, nail, tool=bench.true_grasp.swung)
        bench.arm.execute(plan.approach)
        bench.sim.world.advance(0.5)
        bench.keep()
        yield bench, plan


@pytest.fixture
def swing(over_nail: tuple[Bench, StrikePlan]) -> Swing:
    bench, plan = over_nail
    bench.reset()
    bench.hand.closed = True
    log = Log()
    robot = RobotModel.load()
    motions = Motions(bench.station, CONFIG, robot, log)
    motions.begin()
    motions.carry(HeldTool.nominally(bench.true_grasp.X_hand_ee, bench.true_grasp.swung))
    assert motions.person.hold_switch("", 1.0)
    assert motions.person.request_handover("", 1.0)
    assert motions.person.release("", 1.0)
    motions.arm.mode = Mode.UNATTENDED
    motions.arm.permit_swings(1.0)
    return Swing(bench, robot, plan, motions, log)


@pytest.mark.nightly
@pytest.mark.sim
def test_the_strike_itself_meets_the_nail(swing: Swing) -> None:
    report, verdict = swing.motions.swing("strike", swing.plan, swing.motions.held)
    assert report.contact is not None
    assert verdict.meeting == "expected"
    # Two cycles of the arm and of the force at 1.2 m/s, and what wrist and wood give way.
    assert -0.022 < verdict.before < 0.005
    assert at_rest(swing.bench.sim)


FAULTS = {fault.fault: fault for fault in JOB_FAULTS if fault.arm_latches and fault.phase is Phase.SWING}
"""The arm's rows of the fault matrix, here under a swing alone."""
ERRORS: dict[int, type[MotionFaultError]] = {
    7: TrackingError,
    9: LinkLostError,
    10: OverrunError,
    12: ProtectiveStopError,
    13: EmergencyStopError,
}
"""What each is called, by the rows' numbers."""


@pytest.mark.sim
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_mid_swing(swing: Swing, name: str) -> None:
    fault, bench, happened = FAULTS[name], swing.bench, []
    assert fault.braking is not None
    assert fault.braking.cycles is not None
    noticed, sticks = (fault.braking.cycles + 1) / RATE, fault.braking.arm_off

    def act() -> None:
        happened.append(bench.sim.world.time)
        fault.inject(swing.scene)

    soon(bench, act, 0.2)()
    report = swing.fails(ERRORS[fault.number])
    # Where the commands stop changing.
    moving = np.abs(np.diff(report.q_commanded, axis=0)).max(axis=1) > 1e-9
    stood = report.stamps[1:][moving][-1] - happened[0]
    assert stood <= BRAKING + noticed
    assert report.stamps[-1] - happened[0] - HOLD_TIME <= BRAKING + noticed + SETTLING or sticks
    # A joint that stops dead shakes the hammer, which feels like a contact: the arm brakes at once, and then finds out.
    assert report.contact is None or sticks
    if fault.number == 10:
        assert report.overruns > CONFIG.supervisor.overruns
    if not sticks:
        assert at_rest(bench.sim)
    assert bench.sim.world.nail.protrusion == pytest.approx(CONFIG.work.nail_protrusion, abs=1e-4)


@pytest.mark.sim
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_at_rest_and_the_way_out(swing: Swing, name: str) -> None:
    """Nothing moves; after a person has made it ready and confirmed the reset it does, slowly at first."""
    fault, bench, supervisor = FAULTS[name], swing.bench, swing.motions.arm
    before = bench.sim.world.robot.arm_state()[0]
    fault.inject(swing.scene)
    bench.sim.world.advance(0.3)
    if fault.number in (7, 10):  # which only a motion tells
        swing.fails(ERRORS[fault.number])
    else:
        with pytest.raises(Exception, match=r"robot is in|newest state"):
            swing.run()
        np.testing.assert_allclose(bench.sim.world.robot.arm_state()[0], before, atol=1e-3)
    bench.arm.make_ready()
    if fault.number in (12, 13):
        with pytest.raises(LatchedError):
            swing.run()
    bench.arm.restore_link()
    supervisor.reset(confirmed=True)
    swing.motions.begin()
    assert supervisor.mode is Mode.HANDOVER
    swing.motions.straight("up", (0.0, 0.0, 1.0), 0.02, swing.motions.held)
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)


@pytest.mark.realtime
def test_somebody_steps_in(swing: Swing) -> None:
    """A thread of its own asks for it every 10 ms: how many cycles later it is heard depends on the machine."""
    soon(swing.bench, swing.bench.people.step_in, 0.05)()
    with swing.bench.in_real_time(), pytest.raises(PersonNearError, match="was stopped") as caught:
        swing.run()
    assert caught.value.report is not None
    assert on_path(caught.value.report.q_commanded, swing.plan.strike) < 1e-3
    assert at_rest(swing.bench.sim)
    assert grip_kept(swing.bench.sim)
    swing.bench.people.is_inside = False
    with pytest.raises(LatchedError):
        swing.run()


@pytest.mark.sim
def test_real_time_that_was_lost_is_not_caught_up(swing: Swing) -> None:
    """Else the simulation would run away from the threads that watch it, after every plan that took long to check."""
    world = swing.bench.sim.world
    with swing.bench.in_real_time():
        time.sleep(0.5)
        begun = time.monotonic()
        world.advance(0.4)
        assert time.monotonic() - begun > 0.35


HAND_TROUBLE: dict[str, tuple[Callable[[Bench], None], type[DeviceError], str]] = {
    "tool dropped": (lambda bench: bench.drop(), GripError, "lost the tool"),
    "no grip felt": (lambda bench: setattr(bench.hand, "closed", False), GripError, "lost the tool"),
    "finger stalled": (lambda bench: setattr(bench.sim_hand, "fault", "index finger stalled"), DeviceError, "stalled"),
    "hand silent": (lambda bench: bench.sim_hand.cut_link(), StaleDataError, "newest state"),
}


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("motion", "name"),
    [
        ("strike", "hand silent"),
        ("transfer", "tool dropped"),
        *(pytest.param("strike", name, marks=pytest.mark.nightly) for name in HAND_TROUBLE if name != "hand silent"),
        *(pytest.param("transfer", name, marks=pytest.mark.nightly) for name in HAND_TROUBLE if name != "tool dropped"),
    ],
)
def test_the_hand_is_watched_all_the_way(swing: Swing, motion: str, name: str) -> None:
    """The arm brakes on its path, at once as a thread sees it; it does not latch, since it may have to retreat."""
    cause, error, expected_text = HAND_TROUBLE[name]
    bench, motions = swing.bench, swing.motions
    path = swing.plan.strike
    move: Callable[[], object] = swing.run
    if motion == "transfer":
        path = plan_straight(swing.robot, CONFIG, motions.world(motions.held), motions.q, 0.15, (0.0, 0.0, 1.0), 0.15)
        move = partial(motions.execute, "to a view", path, motions.held)
    soon(bench, lambda: cause(bench), 0.05)()
    with bench.in_real_time(), pytest.raises(error, match=expected_text):
        move()
    report = swing.log.reports[-1]
    assert on_path(report.q_commanded, path) < 1e-3
    assert np.abs(report.q_commanded[-1] - path.q[-1]).max() > 0.01, "it went on to the end"
    assert report.contact is None
    assert at_rest(bench.sim)
    assert not motions.arm.latched
    if error is GripError:
        motions.retreat()
        assert swing.log.motions[-1] == "retreat"
        assert at_rest(bench.sim)

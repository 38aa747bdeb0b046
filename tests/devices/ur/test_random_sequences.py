"""Whatever people, programs and networks do to the robot, in whatever order, it moves only while it is being commanded.

Sequences of commands, stops, releases, pauses, Plays, lost links and killed processes are drawn at random and executed
on the controller stand-in in real time, each model ideal and harsh (a CB3 that resumes by itself when the safeguard
closes). The witness is the stand-in's own trace: which joints move, and when the newest set-point had come. `pytest
--nightly` draws 200 sequences for each of the four sessions; more with `TOOLEE_SEQUENCES=10000 pytest --nightly
tests/devices/ur/test_random_sequences.py`, at some 4 s each.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, event, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.devices.ur.swings import MOVING, swing
from tests.stand_in import HOME, PATIENT, SERVO, held, stand_in
from toolee_robot.arm_data import ARM_DATA
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.errors import DeviceError, MotionFaultError, TooleeError
from toolee_robot.hal import MotionReport, MotionWatch
from toolee_robot.sim_backend.ur_controller.faults.fault_port import Trace
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.profile import ProfileName, profile
from toolee_robot.sim_backend.ur_controller.robot.machine import RATE_SLEW
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.sim_backend.ur_controller.urscript.program import RuntimeState
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel, Trajectory

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.nightly,
    pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning"),
]

SEQUENCES = int(os.environ.get("TOOLEE_SEQUENCES", "200"))
WATCH = replace(PATIENT, data_cycles=MotionWatch().data_cycles)
"""Patient with a busy machine, but not with old data. A driver that may be blind for as long as a network stalls here
does not see a pause that a person ends meanwhile: the joints then catch up with their commands, at up to their own
2.1 rad/s."""
READY_TIME = 20.0
"""[s] in which a robot that a person has made ready must be usable again."""
QUIET = 0.25
"""[s] of observation after the last step: a program that could still go on would."""

# How long a joint may move after the newest set-point has come, by the robot's ticks.
SPEED = 1.5
"""[rad/s] Of the fastest joint in a swing (`FAST`), and 5 % more; the test asserts it."""
STALL = 0.2
"""[s] of a stalled network, for which the driver sees nothing."""
SLIDER, SCALING = 0.3, 0.8
"""The slowest that slider and controller make a motion here; both lengthen the lag of `servoj`."""
PAUSE = max(1.0 / RATE_SLEW, STALL) + 0.1
"""[s] The most that a pause may add, in which the watchdog does not count: until the robot has braked on its path, or
the network is back, and 0.1 s for the driver's answer (a cycle and the way of the dashboard's `stop`) on a busy
machine."""

SESSIONS: dict[tuple[ArmModel, ProfileName], str] = {
    (ArmModel.UR10, "ideal"): "127.0.0.24",
    (ArmModel.UR10E, "ideal"): "127.0.0.25",
    (ArmModel.UR10, "harsh"): "127.0.0.26",
    (ArmModel.UR10E, "harsh"): "127.0.0.27",
}


def kill_servo_process(arm: UnsupervisedUrArm, _: ControllerProcess) -> None:
    pid = arm.servo_pid
    with suppress(OSError):
        if b"servo.process" in Path(f"/proc/{pid}/cmdline").read_bytes():  # else it is dead already
            os.kill(pid, signal.SIGKILL)


STEPS: dict[str, Callable[[UnsupervisedUrArm, ControllerProcess], object]] = {
    "stop": lambda arm, _: arm.stop(),
    "protective stop": lambda _, robot: robot.fault("protective_stop"),
    "unlock": lambda _, robot: robot.fault("unlock"),
    "open the safeguard": lambda _, robot: robot.fault("safeguard_stop"),
    "close the safeguard": lambda _, robot: robot.fault("safeguard_stop", active=False),
    "press the emergency stop": lambda _, robot: robot.fault("emergency_stop"),
    "release the emergency stop": lambda _, robot: robot.fault("emergency_stop", pressed=False),
    "pause": lambda _, robot: robot.fault("pause"),
    "play": lambda _, robot: robot.fault("play"),
    f"slider to {SLIDER:.0%}": lambda _, robot: robot.fault("speed_slider", fraction=SLIDER),
    "slider to 100%": lambda _, robot: robot.fault("speed_slider", fraction=1.0),
    f"scaling to {SCALING:.0%}": lambda _, robot: robot.fault("speed_scaling", fraction=SCALING),
    "scaling to 100%": lambda _, robot: robot.fault("speed_scaling", fraction=1.0),
    "drop the link": lambda _, robot: robot.fault("drop", port="rtde"),
    "reset the link": lambda _, robot: robot.fault("drop", port="rtde", reset=True),
    "stall the network": lambda _, robot: robot.fault("stall", port="rtde", seconds=STALL),
    "kill the servo process": kill_servo_process,
    "reset": lambda arm, _: arm.reset(),
}
"""Everything but "swing", which starts a motion in another thread. What the robot or driver refuses is fine."""
RELEASES = ("unlock", "close the safeguard", "slider to 100%", "scaling to 100%")
STOPS = ("protective stop", "open the safeguard", "pause")
LOSSES = ("drop the link", "reset the link", "stall the network", "kill the servo process")


@dataclass(frozen=True)
class Step:
    """What is done, and the time [s] until the next step."""

    name: str
    wait: float


def sequences() -> st.SearchStrategy[list[Step]]:
    """A swing first, then anything; in the end every stop is released and Play pressed."""
    waits, soon = st.floats(0.0, 0.3), st.floats(0.0, 0.03)
    anything = st.builds(lambda name, wait: [Step(name, wait)], st.sampled_from(["swing", *STEPS]), waits)
    pair = st.tuples(st.sampled_from(STOPS), st.sampled_from(LOSSES)).flatmap(st.permutations)
    accident = st.builds(
        lambda names, between, wait: [Step(names[0], between), Step(names[1], wait)], pair, soon, waits
    )
    release = st.permutations(RELEASES)

    def sequence(wait: float, steps: list[list[Step]], released: Sequence[str], pause: float) -> list[Step]:
        end = [Step(name, pause) for name in (*released, "play")]
        return [Step("swing", wait), *(step for some in steps for step in some), *end]

    some = st.one_of(anything, anything, accident)
    return st.builds(sequence, waits, st.lists(some, min_size=1, max_size=6), release, st.floats(0.0, 0.1))


class Session:
    """One arm on one stand-in."""

    def __init__(self, arm: UnsupervisedUrArm, robot: ControllerProcess, config: UrArmConfig) -> None:
        self.arm, self.robot = arm, robot
        self.model = MODELS[robot.options.model]
        followed, servo = profile(robot.options.profile, self.model.e_series), config.servo
        # How long the joints follow the last set-point, at the slowest that slider and controller make them.
        lag = 0.0
        if followed.servo is not None:
            lag = followed.servo.lag(servo.gain, servo.lookahead, self.model.period) / (SLIDER * SCALING)
        # The watchdog ends the program, and the arm brakes with the program's deceleration.
        self.grace = 1.0 / servo.watchdog + SPEED / followed.stops.program + lag
        self.sent: list[tuple[Trajectory, MotionReport]] = []
        self.unexpected: list[TooleeError] = []
        self._threads: list[threading.Thread] = []

    def make_ready(self) -> None:
        """As a person does: release everything at the robot, look, then reset the driver."""
        self.robot.fault("reset")
        time.sleep(0.2)  # the program has ended, which the driver has to see
        deadline = time.monotonic() + READY_TIME
        while True:
            try:
                self.arm.reset()
                return
            except DeviceError as error:
                if time.monotonic() > deadline:
                    pytest.fail(f"a robot that was made ready stays unusable: {error}")
                time.sleep(0.05)

    def execute(self, steps: list[Step]) -> Trace:
        """The trace of the joints over the whole sequence and some time after it."""
        before = self.robot.state()["tick"]
        self.sent.clear()
        for step in steps:
            if step.name == "swing":
                thread = threading.Thread(target=self._swing)
                self._threads.append(thread)
                thread.start()
            else:
                with suppress(DeviceError):
                    STEPS[step.name](self.arm, self.robot)
            time.sleep(step.wait)
        for thread in self._threads:
            thread.join()
        self._threads.clear()
        time.sleep(self.grace + QUIET)
        return self.robot.trace(before)

    def _swing(self) -> None:
        try:
            trajectory = swing(held(self.arm))
            report = self.arm.execute(trajectory, None, WATCH)
        except MotionFaultError as error:
            if error.report is None:
                return
            report = error.report
        except DeviceError:
            return  # refused: nothing may move
        except TooleeError as error:  # the arm has moved since the swing was planned
            if error.code != "limit.start":
                self.unexpected.append(error)
            return
        self.sent.append((trajectory, report))

    def uncommanded(self, trace: Trace) -> NDArray[np.intp]:
        """Ticks in which a joint moves although the newest set-point is older than `grace`."""
        ticks = np.arange(len(trace.ticks))
        came = np.diff(trace.commands, prepend=trace.commands[:1]) > 0
        newest = np.maximum.accumulate(np.where(came, ticks, -1))
        paused = np.cumsum(trace.program == RuntimeState.PAUSED)
        pause = np.minimum((paused - paused[np.maximum(newest, 0)]) * self.model.period, PAUSE)
        age = np.where(newest < 0, np.inf, (ticks - newest) * self.model.period) - pause
        moving = np.abs(trace.qd).max(axis=1) > MOVING
        return np.flatnonzero(moving & (age > self.grace))


@pytest.fixture(scope="module", params=list(SESSIONS), ids="-".join)
def session(request: pytest.FixtureRequest) -> Iterator[Session]:
    model, kind = request.param
    # The stand-in's harsh profile lags as its generation does: the driver assumes an upper bound.
    config = UrArmConfig(SESSIONS[request.param], SERVO if kind == "ideal" else replace(SERVO, lag=None))
    with (
        stand_in(model, config.host, profile=kind) as robot,
        UnsupervisedUrArm(config, replace(sim_station().arm, model=model)) as arm,
    ):
        yield Session(arm, robot, config)


@settings(
    max_examples=SEQUENCES,
    deadline=None,
    phases=[Phase.explicit, Phase.generate],  # it runs in real time: a smaller example costs minutes
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(steps=sequences())
def test_the_arm_moves_only_while_it_is_commanded(session: Session, steps: list[Step]) -> None:
    session.make_ready()
    trace = session.execute(steps)
    model, velocity = session.model, np.asarray(ARM_DATA[ArmModel(session.model.name)].velocity)
    event("moved" if np.ptp(trace.q, axis=0).max() > 1e-3 else "stood")
    assert not session.unexpected
    assert np.all(np.diff(trace.ticks) == 1)
    late = session.uncommanded(trace)
    assert len(late) == 0, f"moves in {len(late)} ticks from {(late[0] + 1) * model.period:.3f} s on"
    speed = np.abs(trace.qd).max()
    assert speed <= SPEED
    assert np.all(np.abs(np.diff(trace.q_target, axis=0)) <= 1.01 * velocity * model.period)
    # Where slider or pause slow a motion down, their slope adds to the program's own acceleration.
    acceleration = np.abs(np.diff(trace.qd, axis=0)).max() / model.period
    assert acceleration <= 1.01 * model.acceleration + RATE_SLEW * speed
    assert np.abs(trace.q - HOME).max() < 2.0
    for trajectory, report in session.sent:
        assert smooth(trajectory, report, model.period)


def smooth(trajectory: Trajectory, report: MotionReport, period: float) -> bool:
    """Whether what was sent keeps to the accelerations of the path and of a stop on it."""
    q = report.q_commanded[: report.commands]
    if len(q) < 3:
        return True
    q = np.vstack([trajectory.q[:1], q])
    limit = np.abs(trajectory.qdd).max() + sim_station().arm.stop_acceleration.max()
    return bool(np.abs(np.diff(q, n=2, axis=0)).max() <= 1.05 * limit * period**2)

"""Whatever people and program do to the robot, in whatever order, it moves only while a motion is being commanded.

Sequences of commands, stops, releases, pauses and Plays are drawn at random and executed on the controller stand-in in
real time; the property is asserted on the stand-in's own trace. `pytest --nightly` draws 200 of them; more with
`TOOLEE_SEQUENCES=10000 pytest --nightly tests/hardware/ur/test_random_sequences.py`, at 2 to 4 s each.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, event, given, settings
from hypothesis import strategies as st

from tests.hardware.ur.swings import MOVING, swing
from tests.stand_in import HOME, PATIENT, held, patient, stand_in
from toolee_robot.arm_data import ARM_DATA
from toolee_robot.config import ArmLimits
from toolee_robot.errors import DeviceError, MotionFaultError
from toolee_robot.frames import Array
from toolee_robot.hardware.ur.config import UrArmConfig
from toolee_robot.hardware.ur.driver import UnsupervisedUrArm
from toolee_robot.sim_backend.ur_controller.faults.client import Trace
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.types import ArmModel

pytestmark = [pytest.mark.realtime, pytest.mark.nightly]

SEQUENCES = int(os.environ.get("TOOLEE_SEQUENCES", "200"))
READY_TIME = 20.0
"""[s] in which a robot that a person has made ready must be usable again."""
BRAKING = 0.4
"""[s] in which a joint at the highest speed drawn comes to rest, by the driver's path stop or the robot's own stop."""
QUIET = 0.25
"""[s] of observation after the last step: a program that could still go on would."""
HOSTS = {ArmModel.UR10: "127.0.0.24", ArmModel.UR10E: "127.0.0.25"}

STEPS: dict[str, Callable[[UnsupervisedUrArm, ControllerProcess], object]] = {
    "stop": lambda arm, _: arm.stop(),
    "protective stop": lambda _, robot: robot.fault("protective_stop"),
    "unlock": lambda _, robot: robot.fault("unlock"),
    "open the safeguard": lambda _, robot: robot.fault("safeguard_stop"),
    "close the safeguard": lambda _, robot: robot.fault("safeguard_stop", active=False),
    "pause": lambda _, robot: robot.fault("pause"),
    "play": lambda _, robot: robot.fault("play"),
    "slider to 30 %": lambda _, robot: robot.fault("speed_slider", fraction=0.3),
    "slider to 100 %": lambda _, robot: robot.fault("speed_slider", fraction=1.0),
    "reset": lambda arm, _: arm.reset(),
}
"""Everything but "swing", which starts a motion in another thread. What the robot or driver refuses is fine."""


@dataclass(frozen=True)
class Step:
    """What is done, and the time [s] until the next step."""

    name: str
    wait: float


def sequences() -> st.SearchStrategy[list[Step]]:
    """A swing first, so that something moves; then anything; in the end every stop is released and Play pressed."""
    waits = st.floats(0.0, 0.3)
    anything = st.builds(Step, st.sampled_from(["swing", *STEPS]), waits)
    release = st.permutations(("unlock", "close the safeguard", "slider to 100 %"))

    def sequence(wait: float, steps: list[Step], released: Sequence[str], pause: float) -> list[Step]:
        return [Step("swing", wait), *steps, *(Step(name, pause) for name in (*released, "play"))]

    return st.builds(sequence, waits, st.lists(anything, min_size=1, max_size=8), release, st.floats(0.0, 0.1))


class Session:
    """One arm on one stand-in, and when motions were being commanded.

    Attributes:
        commanded: Start and end of every motion that was not refused, time.monotonic [s].
    """

    def __init__(self, arm: UnsupervisedUrArm, robot: ControllerProcess, config: UrArmConfig) -> None:
        self.arm, self.robot, self.config = arm, robot, config
        self.commanded: list[tuple[float, float]] = []
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
            except DeviceError:
                assert time.monotonic() < deadline, "a robot that was made ready stays unusable"
                time.sleep(0.05)

    def execute(self, steps: list[Step]) -> Trace:
        """The trace of the joints over the whole sequence and some time after it."""
        before = self.robot.state()["tick"]
        self.commanded.clear()
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
        time.sleep(BRAKING + QUIET)
        return self.robot.trace(before)

    def _swing(self) -> None:
        began = time.monotonic()
        try:
            self.arm.execute(swing(held(self.arm)), None, PATIENT)
        except MotionFaultError:
            pass
        except DeviceError:
            return  # refused: nothing may move
        self.commanded.append((began, time.monotonic()))

    def uncommanded(self, trace: Trace) -> Array:
        """Stamps of the ticks in which a joint moves although no command is younger than the robot's watchdog."""
        moving = trace.stamps[np.abs(trace.qd).max(axis=1) > MOVING]
        grace = 1.0 / self.config.servo.watchdog + BRAKING
        allowed = np.zeros(len(moving), dtype=bool)
        for start, end in self.commanded:
            allowed |= (start <= moving) & (moving <= end + grace)
        return moving[~allowed]


@pytest.fixture(scope="module", params=list(ArmModel), ids=str)
def session(request: pytest.FixtureRequest) -> Iterator[Session]:
    model: ArmModel = request.param
    config = patient(HOSTS[model])
    with stand_in(model, config.host) as robot, UnsupervisedUrArm(config, ArmLimits(model=model)) as arm:
        yield Session(arm, robot, config)


@settings(
    max_examples=SEQUENCES,
    deadline=None,
    phases=[Phase.explicit, Phase.generate],  # it runs in real time: a smaller example costs minutes
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(steps=sequences())
def test_the_arm_moves_only_while_a_motion_is_commanded(session: Session, steps: list[Step]) -> None:
    session.make_ready()
    trace = session.execute(steps)
    period = float(np.median(np.diff(trace.stamps)))
    velocity = np.asarray(ARM_DATA[ArmModel(session.robot.state()["model"])].velocity)
    event("moved" if np.ptp(trace.q, axis=0).max() > 1e-3 else "stood")
    late = session.uncommanded(trace)
    assert len(late) == 0, f"moves in {len(late)} ticks from {late[0]:.3f} s on, commanded were {session.commanded}"
    assert np.all(np.abs(trace.qd) <= velocity)
    assert np.all(np.abs(np.diff(trace.q_target, axis=0)) <= 1.01 * velocity * period)
    assert np.abs(trace.q - HOME).max() < 2.0

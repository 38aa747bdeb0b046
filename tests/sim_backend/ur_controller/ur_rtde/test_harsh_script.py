"""The control script of the installed ur_rtde, verbatim, on a harsh controller: it stops when ur_rtde asks for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from tests.sim_backend.ur_controller.server.wire import robot as wire_robot
from tests.sim_backend.ur_controller.ur_rtde.control_script import control_script
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.sim_backend.ur_controller.robot.safety_system import SafetyMode
from toolee_robot.sim_backend.ur_controller.urscript.compiling import compiled
from toolee_robot.sim_backend.ur_controller.urscript.program import RuntimeState

pytestmark = pytest.mark.sim
HOSTS = {"UR10": "127.0.0.91", "UR10e": "127.0.0.92"}
MOVEJ, ZERO_FORCE, SPEEDJ, SERVOJ, SPEED_STOP, SERVO_STOP, WATCHDOG = 1, 8, 9, 11, 15, 16, 35


class HarshRemote:
    """What ur_rtde does with the registers of a harsh controller."""

    def __init__(self, model: str) -> None:
        self.robot = wire_robot(model, "harsh")
        self.period = self.robot.model.period
        self.robot.machine.set_payload(1.5, [0.0, 0.0, 0.08])
        script = control_script(MODELS[model], HOSTS[model])
        compiled(script, MODELS[model].e_series)  # else beside the steps, for as long as the machine takes
        self.robot.program.upload(script)
        for _ in range(4000):
            self.robot.step()
            if self.robot.registers.int_out[0] == 1:
                break
        else:
            raise AssertionError(f"the script does not begin: {self.robot.program.last_error}")
        self.start = self.robot.plant.q.copy()

    def send(self, command: int, numbers: Sequence[float] = (), integers: Sequence[int] = ()) -> None:
        registers = self.robot.registers
        registers.float_in[: len(numbers)] = [float(number) for number in numbers]
        registers.int_in[: len(integers) + 1] = [command, *integers]
        self.robot.machine.fed("input_int_register_0")
        self.robot.step()

    def call(self, command: int, numbers: Sequence[float] = (), integers: Sequence[int] = ()) -> None:
        self.send(command, numbers, integers)
        for _ in range(round(10 / self.period)):
            if self.robot.registers.int_out[0] == 2:
                break
            self.robot.step()
        else:
            raise AssertionError(f"command {command} was not done: {self.robot.safety.reason}")
        self.send(0)
        self.robot.step()

    def servo(self, seconds: float) -> None:
        """A stream that moves on until it ends."""
        for k in range(round(seconds / self.period)):
            q = self.start + 0.2 * (1 - np.cos(2.0 * k * self.period))
            self.send(SERVOJ, [*q, 0, 0, self.period, 0.03, 1200])

    def rest(self, seconds: float) -> None:
        for _ in range(round(seconds / self.period)):
            self.robot.step()


@pytest.fixture(params=["UR10", "UR10e"])
def remote(request: pytest.FixtureRequest) -> HarshRemote:
    return HarshRemote(request.param)


def test_streams_and_moves_that_ur_rtde_ends_are_no_sudden_stops(remote: HarshRemote) -> None:
    remote.servo(0.6)
    remote.call(SERVO_STOP, [5.0])
    remote.send(SPEEDJ, [0.3, 0, 0, 0, 0, 0, 2.0, 0.0])
    remote.rest(0.3)
    remote.call(SPEED_STOP, [5.0])
    remote.call(MOVEJ, [*remote.start, 1.0, 2.0], [0])
    remote.call(ZERO_FORCE)
    remote.servo(0.6)
    remote.call(SERVO_STOP, [5.0])
    remote.rest(0.2)
    robot = remote.robot
    assert robot.safety.mode is SafetyMode.NORMAL, robot.safety.reason
    assert robot.program.state is RuntimeState.PLAYING, robot.program.last_error


def test_a_client_that_falls_silent_is_stopped_by_its_watchdog_and_not_by_a_sudden_stop(remote: HarshRemote) -> None:
    remote.call(WATCHDOG, [10.0])
    remote.servo(0.6)
    remote.rest(2.0)
    robot = remote.robot
    assert robot.program.state is RuntimeState.STOPPED
    assert robot.safety.mode is SafetyMode.NORMAL, robot.safety.reason
    assert not robot.plant.qd.any()

"""The control script of the installed ur_rtde, verbatim, on the interpreter: no client, the registers by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from tests.sim_backend.ur_controller.ur_rtde.control_script import control_script
from tests.sim_backend.ur_controller.urscript.script_robot import READY, ScriptRobot
from toolee_robot.sim_backend.ur_controller.profile import StopDecelerations
from toolee_robot.sim_backend.ur_controller.robot import poses
from toolee_robot.sim_backend.ur_controller.robot.kinematics import forward
from toolee_robot.sim_backend.ur_controller.robot.plant import UR10, UR10E, ControllerModel
from toolee_robot.sim_backend.ur_controller.robot.registers import EventKind

pytestmark = pytest.mark.sim

HOSTS = {UR10: "127.0.0.91", UR10E: "127.0.0.92"}
MOVEJ, MOVEL, SPEEDJ, SERVOJ, SPEED_STOP, SERVO_STOP, PAYLOAD, TCP, IK, PROTECTIVE, STOPJ, WATCHDOG, END = (
    *(1, 3, 9, 11, 15, 16, 17, 29, 30, 31, 34, 35, 255),
)


class Remote(ScriptRobot):
    """What ur_rtde does with the registers."""

    def __init__(self, model: ControllerModel) -> None:
        super().__init__(model)
        self.start(control_script(model, HOSTS[model]))
        self.tick(3)
        assert self.ready

    @property
    def ready(self) -> bool:
        return self.registers.int_out[0] == 1

    def send(self, command: int, numbers: Sequence[float] = (), integers: Sequence[int] = ()) -> None:
        self.registers.float_in[: len(numbers)] = [float(number) for number in numbers]
        self.registers.int_in[: len(integers) + 1] = [command, *integers]
        self.machine.fed("input_int_register_0")
        self.tick()

    def call(self, command: int, numbers: Sequence[float] = (), integers: Sequence[int] = ()) -> None:
        """Send, wait until it is done, and tell that this has been seen."""
        self.send(command, numbers, integers)
        for _ in range(round(10 * self.model.rate)):
            if self.registers.int_out[0] == 2:
                break
            self.tick()
        else:
            raise AssertionError(f"command {command} was not done within 10 s")
        self.send(0)
        self.tick()
        assert self.ready


@pytest.fixture(params=[UR10, UR10E], ids=lambda m: m.name)
def robot(request: pytest.FixtureRequest) -> Remote:
    return Remote(request.param)


def test_moves_settings_and_questions(robot: Remote) -> None:
    goal = np.add(READY, [0.1, -0.2, 0.1, 0.0, 0.2, -0.3])
    robot.call(MOVEJ, [*goal, 1.0, 2.0], [0])
    np.testing.assert_allclose(robot.plant.q, goal, atol=1e-9)
    tcp = [0.0, 0.01, 0.12, 0.1, 0.0, 0.0]
    robot.call(TCP, tcp)
    robot.call(PAYLOAD, [2.5, 0.0, 0.01, 0.05])
    assert robot.machine.payload == 2.5
    np.testing.assert_allclose(robot.machine.payload_cog, [0.0, 0.01, 0.05])
    X = robot.machine.tcp_pose()
    X[2, 3] += 0.1
    robot.call(MOVEL, [*poses.vector(X), 0.2, 1.0], [0])
    np.testing.assert_allclose(robot.machine.tcp_pose(), X, atol=1e-9)
    robot.call(IK, [*poses.vector(X), *robot.plant.q, 1e-10, 1e-10])
    np.testing.assert_allclose(robot.registers.float_out[:6], robot.plant.q, atol=1e-8)
    np.testing.assert_allclose(forward(robot.model, robot.registers.float_out[:6]) @ poses.matrix(tcp), X, atol=1e-8)


def test_servoing_follows_exactly_and_stops(robot: Remote) -> None:
    period = robot.model.period
    for k in range(round(1.0 * robot.model.rate)):
        q = np.add(READY, 0.1 * (1 - np.cos(np.pi * k * period)))
        robot.send(SERVOJ, [*q, 0, 0, period, 0.1, 300])
        np.testing.assert_allclose(robot.plant.q, q, atol=1e-6)
    robot.call(SERVO_STOP, [5.0])
    assert not robot.machine.moving


def test_speed_goes_on_until_it_is_stopped(robot: Remote) -> None:
    robot.send(SPEEDJ, [0, 0, 0, 0, 0.5, 0, 2.0, 0.1])
    robot.tick(round(1.0 * robot.model.rate))  # ten times the time that was given: the script issues it again
    assert robot.plant.qd[4] == pytest.approx(0.5)
    robot.call(SPEED_STOP, [2.0])
    assert not robot.machine.moving


def test_an_asynchronous_move_tells_its_progress_and_can_be_stopped(robot: Remote) -> None:
    goal = np.add(READY, [1.0, 0, 0, 0, 0, 0])
    robot.call(MOVEJ, [*goal, 0.5, 1.0], [1])
    assert robot.registers.int_out[2] & 0x8000
    robot.tick(round(0.5 * robot.model.rate))
    robot.call(STOPJ, [2.0], [0])
    assert not robot.registers.int_out[2] & 0x8000
    assert not robot.machine.moving
    assert READY[0] + 0.05 < robot.plant.q[0] < goal[0] - 0.3


def test_the_watchdog_ends_the_program_and_the_motion(robot: Remote) -> None:
    robot.call(WATCHDOG, [10.0])
    assert robot.runtime is not None
    robot.send(SPEEDJ, [0, 0, 0, 0, 0.5, 0, 2.0, 0.0])
    for _ in range(20):  # kicked every 0.05 s it lives
        robot.tick(round(0.05 * robot.model.rate))
        robot.machine.fed("input_int_register_0")
    assert robot.runtime.running
    assert robot.plant.qd[4] == pytest.approx(0.5)
    robot.tick(round(0.1 * robot.model.rate) + 2)
    assert not robot.runtime.running
    robot.tick(round(0.5 / StopDecelerations().program * robot.model.rate) + 2)
    assert not robot.machine.moving


def test_what_the_script_reports_and_how_it_ends(robot: Remote) -> None:
    robot.call(PROTECTIVE)
    assert [e.kind for e in robot.events if e.kind is not EventKind.TEXT] == [EventKind.PROTECTIVE_STOP]
    runtime = robot.runtime
    assert runtime is not None
    robot.send(IK, [9, 9, 9, 0, 0, 0, *READY, 0, 0])  # out of reach: the script dies, as on the robot
    assert not runtime.running
    assert "get_inverse_kin" in str(runtime.error)
    again = Remote(robot.model)
    assert again.runtime is not None
    again.send(END)
    again.tick(2)
    assert not again.runtime.running
    assert again.runtime.error is None
    assert again.messages[-1] == "RTDE Control Script Terminated"

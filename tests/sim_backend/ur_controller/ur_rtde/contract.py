"""What the unmodified ur_rtde must be able to do with a stand-in, whichever model it is. Judged by the simulated
joints, not by what ur_rtde returns."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from tests.sim_backend.ur_controller.ur_rtde.client import UrRtde, servo_sine, servo_up, speed_with_kicks
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.faults.fault_port import Trace
from toolee_robot.sim_backend.ur_controller.process import Q_START, ControllerProcess
from toolee_robot.sim_backend.ur_controller.robot.kinematics import forward
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS, ControllerModel

STANDING = 1e-6  # [rad/s]


def wait_for(condition: Callable[[], bool], timeout: float = 10.0) -> None:
    """Until it holds; fails after `timeout` [s]."""
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, f"{condition} did not become true within {timeout} s"
        time.sleep(0.02)


class Bench:
    """A stand-in and ur_rtde connected to it."""

    def __init__(self, controller: ControllerProcess, ur_rtde: UrRtde) -> None:
        self.controller, self.ur_rtde = controller, ur_rtde
        self.model: ControllerModel = MODELS[controller.options.model]

    @property
    def q(self) -> Array:
        return np.array(self.controller.state()["q"])

    def trace(self, after: int) -> Trace:
        return self.controller.trace(after)

    def tick(self) -> int:
        return int(self.controller.state()["tick"])

    def standing(self) -> bool:
        return bool(np.max(np.abs(self.controller.state()["qd"])) < STANDING)

    def ready(self) -> None:
        """Back to normal: no fault, the control script running, at the start posture."""
        state = self.controller.state()
        if state["program_state"] != "PLAYING" or state["safety_mode"] != "NORMAL":
            self.controller.fault("reset")
            self.ur_rtde.control("reuploadScript")
            wait_for(lambda: self.controller.state()["program_state"] == "PLAYING")
        if not np.allclose(state["q"], Q_START, atol=1e-4):
            assert self.ur_rtde.control("moveJ", list(Q_START), 3.0, 10.0)


@contextmanager
def open_bench(model: str, host: str) -> Iterator[Bench]:
    """A stand-in with all four interfaces connected to it."""
    with ControllerProcess(model=model, host=host) as controller, UrRtde(host) as ur_rtde:
        ur_rtde.open("control", "receive", "io", "dashboard")
        yield Bench(controller, ur_rtde)


class UrRtdeContract:
    """Test modules have a fixture `rig`, an open bench."""

    @pytest.fixture
    def bench(self, rig: Bench) -> Bench:
        rig.ready()
        return rig

    def test_tells_what_it_is(self, bench: Bench) -> None:
        dashboard = [bench.ur_rtde.call("dashboard", method) for method in ("polyscopeVersion", "getRobotModel")]
        assert dashboard == [".".join(str(number) for number in bench.model.version), bench.model.name]
        assert bench.ur_rtde.call("dashboard", "running") is True
        assert bench.ur_rtde.control("isProgramRunning") is True
        assert bench.ur_rtde.receive("getRobotMode") == 7
        assert bench.ur_rtde.receive("getSafetyMode") == 1
        assert bench.ur_rtde.receive("getRuntimeState") == 2

    def test_receives_what_is_measured(self, bench: Bench) -> None:
        np.testing.assert_allclose(bench.ur_rtde.receive("getActualQ"), Q_START, atol=1e-6)
        X = forward(bench.model, bench.q)
        np.testing.assert_allclose(bench.ur_rtde.receive("getActualTCPPose")[:3], X[:3, 3], atol=1e-6)
        bench.controller.fault("force", wrench=[1.0, 2.0, -3.0, 0.0, 0.0, 0.0])
        wait_for(lambda: np.allclose(bench.ur_rtde.receive("getActualTCPForce")[:3], [1.0, 2.0, -3.0]))
        bench.controller.fault("force", wrench=[0.0] * 6)

    def test_move_j(self, bench: Bench) -> None:
        target = np.add(Q_START, [0.2, -0.1, 0.1, 0.05, -0.1, 0.3])
        before = bench.tick()
        assert bench.ur_rtde.control("moveJ", target.tolist(), 1.0, 5.0)
        np.testing.assert_allclose(bench.q, target, atol=1e-6)
        assert np.abs(bench.trace(before).qd).max() <= 1.0 + 1e-6

    def test_move_l_is_straight(self, bench: Bench) -> None:
        before = bench.tick()
        start = forward(bench.model, bench.q)[:3, 3]
        pose = bench.ur_rtde.receive("getActualTCPPose")
        goal = np.add(pose[:3], [0.1, 0.05, 0.1])
        assert bench.ur_rtde.control("moveL", [*goal, *pose[3:]], 0.5, 2.0)
        path = np.array([forward(bench.model, q)[:3, 3] for q in bench.trace(before).q])
        along = (goal - start) / np.linalg.norm(goal - start)
        aside = (path - start) - np.outer((path - start) @ along, along)
        assert np.linalg.norm(path[-1] - goal) < 1e-5
        assert np.linalg.norm(aside, axis=1).max() < 1e-4

    def test_servo_j_follows(self, bench: Bench) -> None:
        before = bench.tick()
        duration, amplitude = 1.0, 0.1
        assert bench.ur_rtde.run(servo_sine, duration, amplitude, bench.model.period)
        trace = bench.trace(before)
        moved = trace.q[:, 0] - Q_START[0]
        assert moved.max() == pytest.approx(amplitude, rel=0.1)
        assert np.abs(trace.qd[:, 0]).max() <= bench.model.velocity[0] + 1e-9
        np.testing.assert_allclose(bench.q, Q_START, atol=2e-3)

    def test_servo_l_follows(self, bench: Bench) -> None:
        height = forward(bench.model, bench.q)[2, 3]
        bench.ur_rtde.run(servo_up, 0.5, 0.04, bench.model.period)
        assert forward(bench.model, bench.q)[2, 3] - height == pytest.approx(0.04, abs=3e-3)

    def test_speed_j_and_stop(self, bench: Bench) -> None:
        assert bench.ur_rtde.control("speedJ", [0.0, 0.0, 0.0, 0.0, 0.0, 0.3], 2.0, 0.0)
        wait_for(lambda: abs(bench.controller.state()["qd"][5] - 0.3) < 1e-6)
        bench.ur_rtde.control("speedStop", 5.0)
        wait_for(bench.standing)
        assert bench.q[5] > Q_START[5]

    def test_speed_l(self, bench: Bench) -> None:
        before = forward(bench.model, bench.q)[:3, 3]
        assert bench.ur_rtde.control("speedL", [0.0, 0.0, 0.05, 0.0, 0.0, 0.0], 1.0, 0.0)
        wait_for(lambda: float(forward(bench.model, bench.q)[2, 3] - before[2]) > 0.02)
        bench.ur_rtde.control("speedStop")
        wait_for(bench.standing)
        aside = (forward(bench.model, bench.q)[:3, 3] - before)[:2]
        assert np.abs(aside).max() < 2e-3

    def test_stop_j_ends_an_asynchronous_move(self, bench: Bench) -> None:
        target = [1.0, *Q_START[1:]]
        assert bench.ur_rtde.control("moveJ", target, 0.5, 1.0, True)
        wait_for(lambda: bench.q[0] > 0.05)
        bench.ur_rtde.control("stopJ", 5.0)
        wait_for(bench.standing)
        assert 0.05 < bench.q[0] < 0.9

    def test_jog(self, bench: Bench) -> None:
        before = forward(bench.model, bench.q)[:3, 3]
        assert bench.ur_rtde.control("jogStart", [0.0, 0.0, 50.0 / 1000, 0.0, 0.0, 0.0])
        wait_for(lambda: float(np.linalg.norm(forward(bench.model, bench.q)[:3, 3] - before)) > 0.005)
        bench.ur_rtde.control("jogStop")
        wait_for(bench.standing)

    def test_tcp_and_payload(self, bench: Bench) -> None:
        tcp = [0.0, 0.01, 0.15, 0.0, 0.0, 0.0]
        flange = forward(bench.model, bench.q)
        assert bench.ur_rtde.control("setTcp", tcp)
        np.testing.assert_allclose(bench.ur_rtde.control("getTCPOffset"), tcp, atol=1e-9)
        wait_for(
            lambda: np.allclose(bench.ur_rtde.receive("getActualTCPPose")[:3], flange[:3, :3] @ tcp[:3] + flange[:3, 3])
        )
        assert bench.ur_rtde.control("setPayload", 1.5, [0.0, 0.0, 0.07])
        wait_for(lambda: bench.ur_rtde.receive("getPayload") == 1.5)
        np.testing.assert_allclose(bench.ur_rtde.receive("getPayloadCog"), [0.0, 0.0, 0.07])
        assert bench.ur_rtde.control("setTcp", [0.0] * 6)

    def test_kinematics_of_the_controller(self, bench: Bench) -> None:
        pose = bench.ur_rtde.receive("getActualTCPPose")
        np.testing.assert_allclose(bench.ur_rtde.control("getInverseKinematics", pose), bench.q, atol=1e-6)
        np.testing.assert_allclose(bench.ur_rtde.control("getForwardKinematics")[:3], pose[:3], atol=1e-6)
        assert bench.ur_rtde.control("isPoseWithinSafetyLimits", pose)

    def test_force_mode_yields(self, bench: Bench) -> None:
        height = forward(bench.model, bench.q)[2, 3]
        frame, selection = [0.0] * 6, [0, 0, 1, 0, 0, 0]
        wrench, limits = [0.0, 0.0, -20.0, 0.0, 0.0, 0.0], [0.1, 0.1, 0.1, 0.5, 0.5, 0.5]
        assert bench.ur_rtde.control("forceMode", frame, selection, wrench, 2, limits)
        wait_for(lambda: float(forward(bench.model, bench.q)[2, 3]) < height - 0.005)
        assert bench.ur_rtde.control("forceModeStop")
        wait_for(bench.standing)

    def test_custom_script(self, bench: Bench) -> None:
        script = "write_output_float_register(18, 2.5)\nwrite_output_integer_register(18, 42)\n"
        assert bench.ur_rtde.control("sendCustomScriptFunction", "custom", script)
        wait_for(lambda: bench.controller.fault("registers")["int_out"][18] == 42)
        wait_for(lambda: bench.ur_rtde.receive("getOutputDoubleRegister", 18) == 2.5)
        wait_for(lambda: bench.controller.state()["program_name"] == "rtde_control")

    def test_io(self, bench: Bench) -> None:
        assert bench.ur_rtde.call("io", "setStandardDigitalOut", 3, True)
        wait_for(lambda: bench.ur_rtde.receive("getDigitalOutState", 3))
        assert bench.ur_rtde.call("io", "setSpeedSlider", 0.5)
        wait_for(lambda: bench.ur_rtde.receive("getTargetSpeedFraction") == 0.5)
        assert bench.ur_rtde.call("io", "setSpeedSlider", 1.0)
        wait_for(lambda: bench.controller.state()["speed_slider"] == 1.0)

    def test_watchdog_stops_the_arm(self, bench: Bench) -> None:
        assert bench.ur_rtde.control("setWatchdog", 10.0)
        before = bench.tick()
        assert bench.ur_rtde.run(speed_with_kicks, 0.5)
        wait_for(lambda: bench.controller.state()["program_state"] == "STOPPED")
        wait_for(bench.standing)
        trace = bench.trace(before)
        stopped = np.flatnonzero(trace.program != 2)[0]
        assert np.abs(trace.qd[:stopped, 5]).max() == pytest.approx(0.5, rel=0.05)

    def test_protective_stop_unlock_and_reupload(self, bench: Bench) -> None:
        assert bench.ur_rtde.control("moveJ", [1.0, *Q_START[1:]], 0.5, 2.0, True)
        wait_for(lambda: bench.q[0] > 0.05)
        bench.controller.fault("force", wrench=[0.0, 200.0, 0.0, 0.0, 0.0, 0.0], seconds=0.3)
        wait_for(lambda: bench.controller.state()["safety_mode"] == "PROTECTIVE_STOP")
        wait_for(bench.standing)
        wait_for(lambda: bench.ur_rtde.receive("isProtectiveStopped"))
        assert not bench.ur_rtde.control("isProgramRunning")
        with pytest.raises(RuntimeError, match="Cannot unlock protective stop until 5s"):
            bench.ur_rtde.call("dashboard", "unlockProtectiveStop")
        stopped_at = bench.q
        time.sleep(0.5)  # until the push is over
        bench.controller.fault("unlock")
        assert bench.ur_rtde.control("reuploadScript")
        wait_for(lambda: bench.ur_rtde.control("isProgramRunning"))
        np.testing.assert_allclose(bench.q, stopped_at, atol=1e-6)
        assert bench.ur_rtde.control("moveJ", list(Q_START), 2.0, 5.0)
        np.testing.assert_allclose(bench.q, Q_START, atol=1e-6)

    def test_emergency_stop_and_recovery(self, bench: Bench) -> None:
        assert bench.ur_rtde.control("moveJ", [1.0, *Q_START[1:]], 0.5, 2.0, True)
        wait_for(lambda: bench.q[0] > 0.05)
        bench.controller.fault("emergency_stop")
        wait_for(lambda: bench.controller.state()["robot_mode"] == "POWER_OFF")
        assert bench.standing()
        assert bench.ur_rtde.receive("isEmergencyStopped")
        with pytest.raises(RuntimeError):
            bench.ur_rtde.call("dashboard", "play")
        bench.controller.fault("emergency_stop", pressed=False)
        bench.ur_rtde.call("dashboard", "powerOn")
        bench.ur_rtde.call("dashboard", "brakeRelease")
        wait_for(lambda: bench.ur_rtde.call("dashboard", "robotmode") == "Robotmode: RUNNING")
        assert bench.ur_rtde.control("reuploadScript")
        wait_for(lambda: bench.ur_rtde.control("isProgramRunning"))
        assert bench.ur_rtde.control("moveJ", list(Q_START), 2.0, 5.0)

    def test_a_second_control_interface_is_refused(self, bench: Bench) -> None:
        with UrRtde(bench.controller.host) as second, pytest.raises(RuntimeError, match="in use"):
            second.open("control")

    def test_leaving_and_coming_back(self, bench: Bench) -> None:
        bench.ur_rtde.close("control")
        wait_for(lambda: bench.controller.state()["clients"]["realtime"] == 0)
        bench.ur_rtde.open("control")
        assert bench.ur_rtde.control("moveJ", [0.1, *Q_START[1:]], 2.0, 5.0)
        assert bench.q[0] == pytest.approx(0.1, abs=1e-6)

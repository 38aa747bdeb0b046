"""Faults of following and measuring, called as the fault port calls them, on a controller without sockets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from toolee_robot.sim_backend.ur_controller.controller import Controller, ControllerOptions
from toolee_robot.sim_backend.ur_controller.process import resting_joints
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.sim_backend.ur_controller.robot.safety_system import SafetyMode

STREAM = """def stream():
  q = get_target_joint_positions()
  while True:
    q[0] = q[0] + 0.0008
    servoj(q, t=0.002, lookahead_time=0.03, gain=1200)
    write_output_float_register(0, q[0])
  end
end
"""
Faulty = tuple[Controller, Callable[..., dict[str, Any]]]


def faulty(model: str, profile: ProfileName) -> Faulty:
    controller = Controller(ControllerOptions(model=model, profile=profile), resting_joints)

    def fault(name: str, **arguments: object) -> dict[str, Any]:
        return controller.faults.do({"fault": name, **arguments})

    return controller, fault


def run(controller: Controller, seconds: float) -> None:
    for _ in range(round(seconds * controller.robot.model.rate)):
        controller.robot.step()


def behind(controller: Controller) -> float:
    """Lag of the joint behind the stream [s]."""
    goal = controller.robot.registers.float_out[0]
    return float(goal - controller.robot.plant.q[0]) / (0.0008 * controller.robot.model.rate)


@pytest.mark.parametrize("profile", ["ideal", "harsh"])
def test_lag_is_added_to_the_generations_and_ends(profile: ProfileName) -> None:
    controller, fault = faulty("UR10e", profile)
    assert fault("lag", seconds=0.02)["ok"]
    controller.robot.program.upload(STREAM)
    run(controller, 1.5)
    assert behind(controller) == pytest.approx(0.054, abs=0.002)
    assert fault("lag", seconds=0.0)["ok"]
    controller.robot.program.upload(STREAM)
    run(controller, 1.5)
    assert behind(controller) == pytest.approx(0.034 if profile == "harsh" else 0.0, abs=0.002)


def test_noise_is_set_and_ends() -> None:
    controller, fault = faulty("UR10e", "ideal")
    assert fault("noise", position=1e-3, force=5.0, offset=12.0)["ok"]
    forces, positions = [], []
    for _ in range(1500):
        controller.robot.step()
        forces.append(controller.robot.reading.tcp_force[:3])
        positions.append(controller.robot.reading.q)
    assert np.std(forces, axis=0) == pytest.approx([5.0] * 3, rel=0.15)
    assert np.linalg.norm(np.mean(forces, axis=0)) == pytest.approx(12.0, abs=1.0)
    assert np.std(positions, axis=0) == pytest.approx([1e-3] * 6, rel=0.15)
    assert fault("noise")["ok"]
    controller.robot.step()
    assert not controller.robot.reading.tcp_force.any()


def test_an_unknown_payload_weighs_on_the_force() -> None:
    controller, fault = faulty("UR10", "ideal")
    assert fault("payload_error", mass=2.0, cog=[0.0, 0.0, 0.1])["ok"]
    controller.robot.step()
    np.testing.assert_allclose(controller.robot.reading.tcp_force[:3], [0.0, 0.0, -2.0 * 9.82], atol=1e-9)
    assert fault("payload_error", mass=0.0, cog=[0.0, 0.0, 0.0])["ok"]
    controller.robot.step()
    assert not controller.robot.reading.tcp_force.any()


def test_the_accelerometer_feels_how_the_base_stands_whatever_the_program_says() -> None:
    """URScript manual: its axes are the tool's, and one that points up reads positive. The tool looks down."""
    controller, fault = faulty("UR10e", "ideal")
    robot = controller.robot
    robot.machine.gravity = np.array([0.0, 9.82, 0.0])
    robot.step()
    np.testing.assert_allclose(robot.reading.tool_acceleration, [0.0, 0.0, -9.82], atol=1e-3)
    assert fault("mounting", up=[0.0, 0.0, -9.82])["ok"]
    robot.step()
    np.testing.assert_allclose(robot.reading.tool_acceleration, [0.0, 0.0, 9.82], atol=1e-3)
    fault("reset")
    robot.step()
    np.testing.assert_allclose(robot.reading.tool_acceleration, [0.0, 0.0, -9.82], atol=1e-3)


def test_a_door_opens_the_safeguard_also_where_its_input_is_stuck() -> None:
    controller, fault = faulty("UR10e", "ideal")
    machine, safety = controller.robot.machine, controller.robot.safety
    assert fault("door", opened=False, index=3)["ok"]
    assert machine.digital_in[3]
    assert fault("stuck_input", index=3)["ok"]
    assert fault("door", opened=True, index=3)["ok"]
    assert machine.digital_in[3]
    assert safety.mode is SafetyMode.SAFEGUARD_STOP
    fault("door", opened=False, index=3)
    fault("stuck_input", index=3, stuck=False)
    fault("digital_input", index=3, high=False)
    assert not machine.digital_in[3]
    assert safety.mode is SafetyMode.NORMAL
    assert not fault("digital_input", index=18, high=True)["ok"]


@pytest.mark.parametrize(("model", "profile", "state"), [("UR10", "harsh", "PLAYING"), ("UR10", "ideal", "PAUSED")])
def test_the_safeguard_of_a_harsh_cb3_resumes_by_itself(model: str, profile: ProfileName, state: str) -> None:
    controller, fault = faulty(model, profile)
    controller.robot.program.upload("def a():\n  sleep(60)\nend\n")
    run(controller, 0.3)
    fault("safeguard_stop", active=True)
    run(controller, 0.3)
    assert controller.robot.program.state.name == "PAUSED"
    fault("safeguard_stop", active=False)
    assert controller.robot.program.state.name == state

"""Each way to stop by itself, with Universal Robots' code, once; and none in an ordinary slow motion."""

from __future__ import annotations

import struct
from math import inf

import numpy as np
import pytest

from tests.examples import seldom
from tests.sim_backend.ur_controller.server.wire import Recorder, robot
from toolee_robot.sim_backend.ur_controller.robot.safety_system import SafetyMode
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.server.primary import StateSession
from toolee_robot.sim_backend.ur_controller.server.rtde_variables import Outputs

both = pytest.mark.parametrize("model", seldom("UR10e", "UR10"))
LOOSE = {"force": inf, "power": inf, "momentum": inf, "collision_torque": inf, "sudden_stop": inf}
SLOW = """def slow():
  movej([0.2, -1.4, 1.4, -1.5, -1.5, 0.2], 0.8, 0.4)
  q = get_target_joint_positions()
  i = 0
  while i < 200:
    q[0] = q[0] + 0.0005
    servoj(q, t=get_steptime(), lookahead_time=0.1, gain=300)
    i = i + 1
  end
  stopj(2)
  movel(p[0.5, -0.4, 0.5, 0, 3.1, 0], 0.3, 0.15)
end
"""
STREAM = """def stream():
  q = get_target_joint_positions()
  i = 0
  while i < {ticks}:
    q[0] = q[0] + 0.002
    servoj(q, t=0.002, lookahead_time=0.03, gain=1200)
    i = i + 1
  end
{end}
  sleep(1)
end
"""


def run(served: Robot, seconds: float) -> None:
    for _ in range(round(seconds * served.model.rate)):
        served.step()


def codes(served: Robot) -> list[str]:
    """Codes in the log, such as C153A2."""
    return [str(said).partition(":")[0] for _, said in served.messages if not isinstance(said, str)]


def stopped_by(served: Robot, code: str) -> None:
    """It has stopped for this reason and says so once, and once only as long as it stands."""
    run(served, 0.5)
    assert served.safety.mode is SafetyMode.PROTECTIVE_STOP, served.safety.reason
    assert codes(served) == [code], served.safety.reason
    assert served.safety.reason.startswith(f"{code}: ")
    assert not served.plant.qd.any()


@both
def test_an_ordinary_slow_motion_triggers_nothing(model: str) -> None:
    served = robot(model, "harsh")
    served.machine.set_payload(2.0, [0.0, 0.0, 0.1])
    served.program.upload(SLOW.replace("get_steptime()", str(served.model.period)))
    run(served, 8.0)
    assert served.program.uploads == 1
    assert served.program.last_error == ""
    assert served.safety.mode is SafetyMode.NORMAL, served.safety.reason
    assert codes(served) == []
    assert served.safety.detection.deviation_ratio < 0.2
    assert served.safety.detection.collision_ratio < 0.6


@both
@pytest.mark.parametrize(("payload", "code"), [(1.0, "C153A2"), (0.0, "C159A2")])
def test_a_joint_off_its_path(model: str, payload: float, code: str) -> None:
    served = robot(model, "harsh")
    served.machine.set_payload(payload, [0.0, 0.0, 0.0])
    served.joint_offset = np.array([0.0, 0.0, 0.11, 0.0, 0.0, 0.0])
    stopped_by(served, code)


@both
@pytest.mark.parametrize(("payload", "code"), [(1.0, "C157A5"), (0.0, "C158A5")])
def test_a_torque_at_a_joint(model: str, payload: float, code: str) -> None:
    """30 Nm about the last joint's axis and no force."""
    served = robot(model, "harsh")
    served.machine.set_payload(payload, [0.0, 0.0, 0.0])
    run(served, 0.1)
    axis = served.machine.tcp_pose()[:3, 2]
    served.plant.external_force = np.concatenate([np.zeros(3), 30.0 * axis])
    stopped_by(served, code)


@both
def test_a_force(model: str) -> None:
    served = robot(model, "harsh", limits=LOOSE | {"force": 150.0})
    served.plant.external_force = np.array([0.0, 0.0, 190.0, 0.0, 0.0, 0.0])
    stopped_by(served, "C191A7")


@both
@pytest.mark.parametrize(
    ("limits", "code"),
    [({"power": 100.0}, "C191A6"), ({"momentum": 4.0}, "C191A12"), ({"tcp_speed": 0.5}, "C191A3")],
)
def test_a_motion_beyond_the_safety_limits(model: str, limits: dict[str, float], code: str) -> None:
    served = robot(model, "harsh", limits=LOOSE | limits)
    served.program.upload("def swing():\n  speedj([1.5, 0, 0, 0, 0, 0], 4, 5)\nend\n")
    served.plant.external_force = np.array([120.0, 120.0, 0.0, 0.0, 0.0, 0.0])
    run(served, 1.0)
    stopped_by(served, code)


@both
def test_a_joint_that_leaves_its_range(model: str) -> None:
    served = robot(model, "harsh", limits=LOOSE | {"joint_position": (0.2, 1.0, 1.0, 1.0, 1.0, 1.0)})
    served.program.upload("def swing():\n  speedj([1.0, 0, 0, 0, 0, 0], 4, 5)\nend\n")
    run(served, 0.5)
    assert codes(served) == []
    run(served, 2.0)
    stopped_by(served, "C191A1")


@both
def test_a_joint_that_is_too_fast(model: str) -> None:
    served = robot(model, "harsh", limits=LOOSE | {"joint_speed": 0.5})
    served.program.upload("def swing():\n  speedj([1.5, 0, 0, 0, 0, 0], 4, 5)\nend\n")
    run(served, 1.0)
    stopped_by(served, "C191A2")


@both
def test_a_motion_that_needs_more_torque_than_a_joint_has(model: str) -> None:
    """The largest payload at the end of the stretched arm: its elbow is the first to lack torque."""
    served = robot(model, "harsh", limits=LOOSE | {"motion_torque": 0.6})
    served.machine.set_payload(10.0, [0.0, 0.0, 0.3])
    served.program.upload("def lift():\n  movej([0, 0, 0, 0, 0, 0], 1.0, 1.0)\nend\n")
    run(served, 4.0)
    stopped_by(served, "C173A2")


@both
def test_a_motion_whose_torque_jumps(model: str) -> None:
    served = robot(model, "harsh", limits=LOOSE | {"motion_torque": inf, "torque_jump": 0.3})
    served.machine.set_payload(8.0, [0.0, 0.0, 0.2])
    served.program.upload("def jerk():\n  speedj([0, -2, 0, 0, 0, 0], 40, 1)\nend\n")
    run(served, 0.5)
    stopped_by(served, "C174A2")


@both
def test_a_stream_that_just_ends_and_one_that_is_stopped(model: str) -> None:
    ended, braked = robot(model, "harsh"), robot(model, "harsh")
    ended.program.upload(STREAM.format(ticks=100, end=""))
    braked.program.upload(STREAM.format(ticks=100, end="  stopj(5)"))
    run(ended, 1.5)
    run(braked, 1.5)
    stopped_by(ended, "C204A3")
    assert codes(braked) == []
    assert braked.safety.mode is SafetyMode.NORMAL


def test_a_mass_that_the_controller_does_not_know_looks_like_a_collision() -> None:
    served = robot("UR10e", "harsh")
    served.machine.set_payload(1.0, [0.0, 0.0, 0.0])
    served.machine.sensors.payload_error.mass = 12.0
    served.machine.sensors.payload_error.cog = np.array([0.3, 0.3, 0.1])
    run(served, 0.5)
    assert codes(served)[0].startswith("C157")


@both
def test_a_payload_that_is_set_anew_is_no_motion(model: str) -> None:
    served = robot(model, "harsh", limits={"momentum": 1.0, "torque_jump": 0.3})
    run(served, 0.1)
    served.machine.set_payload(5.0, [0.0, 0.1, 0.2])
    run(served, 0.1)
    assert codes(served) == []


def test_clients_of_the_primary_interface_are_told_the_code() -> None:
    served = robot("UR10e", "harsh")
    sink = Recorder()
    session = StateSession(sink, served)
    served.joint_offset = np.array([0.0, 0.0, 0.0, 0.2, 0.0, 0.0])
    for _ in range(100):
        served.step()
        session.tick()
    errors = [message for message in messages(sink.take()) if message[4] == 20 and message[14] == 6]
    assert len(errors) == 1
    code, argument, level, _type, _data = struct.unpack(">iiiII", errors[0][15:35])
    assert (code, argument, level) == (159, 3, 3)
    assert errors[0][35:].startswith(b"C159A3: ")


def messages(data: bytes) -> list[bytes]:
    found = []
    while data:
        (size,) = struct.unpack(">i", data[:4])
        found.append(data[:size])
        data = data[size:]
    return found


def test_ratios_are_in_rtde_from_the_versions_that_have_them() -> None:
    names = ["joint_position_deviation_ratio", "collision_detection_ratio"]
    for without in (robot("UR10", "harsh"), robot("UR10e")):
        assert [Outputs(without).type_of(each) for each in names] == ["NOT_FOUND"] * 2
    served = robot("UR10e", "harsh")
    assert [Outputs(served).type_of(each) for each in names] == ["DOUBLE"] * 2
    served.joint_offset = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    run(served, 0.1)
    deviation, collision = Outputs(served).values(names)
    assert deviation == pytest.approx(0.5, abs=0.01)
    assert 0.0 < collision < 1.0
    assert served.safety.mode is SafetyMode.NORMAL

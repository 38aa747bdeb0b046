"""The emulated Shadow Hand without a network: its controllers, its motors, its rosbridge, and with one: its topics."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tests.errors import raises
from toolee_robot.errors import UserError
from toolee_robot.sim_backend.hands.kit import happen
from toolee_robot.sim_backend.hands.shadow import FINGERS_TOPIC, Controller, Hand, ShadowEmulator


class Bench:
    """A hand whose time is set by hand."""

    def __init__(self) -> None:
        self.now = 100.0
        self.hand = Hand(lambda: self.now)

    def command(self, seconds: float, **angles: float) -> None:
        """All joints to 0 rad, but for some."""
        controller = self.hand.controllers[FINGERS_TOPIC]
        positions = [angles.get(joint.removeprefix("rh_"), 0.0) for joint in controller.joints]
        controller.command(trajectory(controller, positions, seconds), self.now)

    def wait(self, seconds: float) -> None:
        self.now += seconds
        self.hand.run()


def trajectory(controller: Controller, positions: list[float], seconds: float = 0.02) -> dict[str, Any]:
    point = {"positions": positions, "time_from_start": {"secs": 0, "nsecs": round(seconds * 1e9)}}
    return {"joint_names": list(controller.joints), "points": [point]}


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_trajectory_is_followed_on_a_straight_line(bench: Bench) -> None:
    bench.command(0.5, FFJ3=1.0)
    index = bench.hand.controllers[FINGERS_TOPIC].joints.index("rh_FFJ3")
    assert bench.hand.controllers[FINGERS_TOPIC].desired(100.25)[index] == pytest.approx(0.5)
    bench.wait(0.25)
    assert 10.0 < bench.hand.motor("FFJ3").position < 29.0, "the motor lags"
    bench.wait(1.0)
    assert bench.hand.motor("FFJ3").position == pytest.approx(57.3, abs=0.1)
    assert bench.hand.motor("MFJ3").position == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("wrong", ["part", "another joint", "past"])
def test_a_controller_refuses_in_silence(bench: Bench, wrong: str) -> None:
    controller = bench.hand.controllers[FINGERS_TOPIC]
    message = trajectory(controller, [0.1] * len(controller.joints))
    if wrong == "part":
        message["joint_names"] = message["joint_names"][:3]
        message["points"][0]["positions"] = [0.1] * 3
    elif wrong == "another joint":
        message["joint_names"][0] = "rh_WRJ1"
    else:
        message["points"][0]["time_from_start"] = {"secs": 0, "nsecs": 0}
    controller.command(message, bench.now)
    assert controller.refused == 1
    assert set(controller.desired(bench.now + 1.0)) == {0.0}


def test_a_finger_presses_on_what_it_meets_and_lets_go_of_its_force_when_it_is_halted(bench: Bench) -> None:
    bench.hand.hold(40.0)
    bench.command(0.02, FFJ3=1.0)
    bench.wait(2.0)
    motor = bench.hand.motor("FFJ3")
    assert 40.0 < motor.position < 42.5
    assert 500.0 < motor.effort < 1024.0
    motor.temperature = 61.0
    bench.wait(0.5)
    assert motor.halted
    assert motor.effort == 0.0
    assert motor.pressed < 5.0
    motor.temperature = 58.0
    bench.wait(0.1)
    assert motor.halted, "it works again only once it has cooled"
    motor.temperature = 50.0
    bench.wait(1.0)
    assert motor.effort > 500.0


def test_operations_of_the_protocol() -> None:
    with ShadowEmulator() as emulator:
        subscribed: set[str] = set()

        def take(**operation: object) -> str:
            answer = emulator.take(json.dumps(operation), subscribed)
            return "" if answer is None else str(answer["msg"])

        command = "/rh_trajectory_controller/command"
        assert not take(op="subscribe", topic="/joint_states", type="sensor_msgs/JointState")
        assert subscribed == {"/joint_states"}
        assert "has the type" in take(op="subscribe", topic="/joint_states", type="std_msgs/String")
        assert not take(op="advertise", topic=command, type="trajectory_msgs/JointTrajectory")
        assert "has the type" in take(op="advertise", topic=command, type="std_msgs/String")
        assert not take(op="publish", topic=command, msg={"points": []})
        assert "not yet advertised" in take(op="publish", topic="/nothing", msg={})
        assert "Unknown operation" in take(op="dance")
        for text in ("no JSON", "[" * 30_000, "9" * 5_000):
            assert emulator.take(text, subscribed) is None
        answer = emulator.take('{"op": "publish", "id": "7", "topic": "/nothing"}', subscribed)
        assert answer is not None
        assert (answer["op"], answer["level"], answer["id"]) == ("status", "error", "7")


def test_messages_have_the_fields_of_their_definitions(bench: Bench) -> None:
    states = bench.hand.message("/joint_states", 5)
    assert set(states) == {"header", "name", "position", "velocity", "effort"}
    assert len(states["name"]) == len(states["effort"]) == 24
    state = bench.hand.message("/rh_wr_trajectory_controller/state", 6)
    assert set(state) == {"header", "joint_names", "desired", "actual", "error"}
    assert set(state["desired"]) == {"positions", "velocities", "accelerations", "effort", "time_from_start"}
    bench.hand.heat(70.0)
    bench.wait(0.01)
    statuses = {status["name"]: status for status in bench.hand.message("/diagnostics", 7)["status"]}
    hot = statuses["rh SRDMotor LFJ5"]
    assert set(hot) == {"level", "name", "message", "hardware_id", "values"}
    assert (hot["level"], hot["message"]) == (2, "Motor over temperature | ")
    assert {"key": "Temperature", "value": "70.000000"} in hot["values"]


def test_two_cannot_have_one_port() -> None:
    with ShadowEmulator() as emulator:
        taken = int(emulator.port.rpartition(":")[2])
        with raises(UserError, "user.address"):
            ShadowEmulator(address=("127.0.0.1", taken))
        with raises(UserError, "user.address"):
            ShadowEmulator(address=("127.0.0.1", 70_000))
        for nonsense in ("heat", "jam", "jam nose", "controllers", "controllers maybe", "diagnostics", "break", "boo"):
            with raises(UserError, "user.hand_event"):
                happen(emulator, nonsense)
        assert "THJ5 0" in happen(emulator, "heat THJ5 33")
        assert happen(emulator, "unplug") == "unplugged"

"""The dashboard server: a line in, a line out."""

from __future__ import annotations

import pytest

from tests.sim_backend.ur_controller.server.wire import Recorder, robot
from toolee_robot.sim_backend.ur_controller.robot.safety_system import UNLOCK_DELAY, RobotMode
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.server.dashboard import DashboardSession

FOREVER = "def job():\n  while True:\n    sync()\n  end\nend\n"


class Client:
    """A dashboard client without a socket."""

    def __init__(self, served: Robot) -> None:
        self.sink = Recorder()
        self.session = DashboardSession(self.sink, served)
        self.greeting = self.sink.take().decode()

    def ask(self, line: str) -> str:
        self.session.feed(line.encode() + b"\n")
        (answer, rest) = self.sink.take().decode().split("\n", 1)
        assert rest == ""
        return answer


def ticks(served: Robot, seconds: float) -> None:
    for _ in range(round(seconds * served.model.rate)):
        served.step()


def test_greets() -> None:
    assert Client(robot()).greeting == "Connected: Universal Robots Dashboard Server\n"


@pytest.mark.parametrize(
    ("model", "line", "answer"),
    [
        ("UR10", "PolyscopeVersion", "3.15.8.106339"),
        ("UR10e", "PolyscopeVersion", "URSoftware 5.11.0.108249"),
        ("UR10e", "get robot model", "UR10e"),
        ("UR10e", "is in remote control", "true"),
        ("UR10", "robotmode", "Robotmode: RUNNING"),
        ("UR10", "safetymode", "Safetymode: NORMAL"),
        ("UR10", "safetystatus", "Safetystatus: NORMAL"),
        ("UR10", "running", "Program running: false"),
        ("UR10", "programState", "STOPPED"),
        ("UR10", "load job.urp", "File not found: job.urp"),
        ("UR10", "stop", "Stopped"),
        ("UR10", "play", "Failed to execute: play"),
        ("UR10", "pause", "Failed to execute: pause"),
        ("UR10", "popup watch out", "showing popup"),
        ("UR10", "addToLog hello", "Added log message"),
        ("UR10", "setUserRole operator", "Setting user role: operator"),
        ("UR10", "make coffee", 'could not understand: "make coffee"'),
    ],
)
def test_answers(model: str, line: str, answer: str) -> None:
    assert Client(robot(model)).ask(line) == answer


def test_program_control() -> None:
    served = robot()
    client = Client(served)
    served.program.upload(FOREVER)
    ticks(served, 0.1)
    assert client.ask("running") == "Program running: true"
    assert client.ask("programState") == "PLAYING job"
    assert client.ask("pause") == "Pausing program"
    assert client.ask("programState") == "PAUSED job"
    assert client.ask("play") == "Starting program"
    assert client.ask("stop") == "Stopped"
    assert client.ask("running") == "Program running: false"


def test_brake_release_alone_powers_on_too() -> None:
    served = robot()
    served.safety.power_off()
    Client(served).ask("brake release")
    ticks(served, 2.0)
    assert served.safety.robot_mode is RobotMode.RUNNING


def test_a_protective_stop_is_not_unlocked_within_five_seconds() -> None:
    served = robot()
    client = Client(served)
    served.safety.protective_stop("test")
    ticks(served, UNLOCK_DELAY - 0.1)
    assert client.ask("unlock protective stop").startswith("Cannot unlock protective stop until 5s after occurrence")
    assert client.ask("safetystatus") == "Safetystatus: PROTECTIVE_STOP"
    ticks(served, 0.2)
    assert client.ask("unlock protective stop") == "Protective stop releasing"
    assert client.ask("safetystatus") == "Safetystatus: NORMAL"


def test_local_control_takes_no_orders_and_answers_questions() -> None:
    served = robot("UR10e")
    client = Client(served)
    served.safety.remote = False
    assert client.ask("power off") == "Failed to execute: power off"
    assert client.ask("is in remote control") == "false"
    assert client.ask("robotmode") == "Robotmode: RUNNING"


def test_quit_ends_the_connection() -> None:
    client = Client(robot())
    assert client.ask("quit") == "Disconnected"
    assert not client.sink.open

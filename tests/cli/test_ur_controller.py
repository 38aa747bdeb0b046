"""`toolee emulate ur` as a person meets it."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from tests.errors import raises
from toolee_robot.errors import UserError
from toolee_robot.sim_backend.ur_controller.controller import Controller, ControllerOptions
from toolee_robot.sim_backend.ur_controller.faults.fault_port import FaultClient
from toolee_robot.sim_backend.ur_controller.process import resting_joints

pytestmark = pytest.mark.sim

COMMAND = [sys.executable, "-c", "from toolee_robot.cli import main; main()", "emulate", "ur"]


def test_says_what_listens_where_and_ends_cleanly_with_ctrl_c() -> None:
    command = [*COMMAND, "--host", "127.0.0.19", "--payload-kg", "1.1", "--payload-cog", "0", "0", "0.07"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines: list[str] = []
        while not (lines and lines[-1].startswith("Ctrl-C ends it")):
            lines.append(process.stdout.readline())
            assert lines[-1], "it ended by itself"
        with FaultClient("127.0.0.19") as client:
            state = client.state()
        process.send_signal(signal.SIGINT)
        rest = process.stdout.read()
        assert process.wait(30.0) == 0
    text = "".join(lines)
    assert "UR10, controller software 3.15" in text
    assert [port for port in (29999, 30001, 30002, 30003, 30004, 30020) if str(port) not in text] == []
    assert (state["payload"], state["payload_cog"]) == (1.1, [0.0, 0.0, 0.07])
    assert "Ended after" in rest
    assert "Traceback" not in rest


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--host", "10.0.0.1"], "not a loopback address"),
        (["--real-time-factor", "2"], "0.05 to 1"),
        (["--payload-kg", "70"], "between 0 and 50 kg"),
    ],
)
def test_says_what_to_change(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    from toolee_robot.cli.app import run

    assert run(["emulate", "ur", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_a_speed_slider_has_two_ends() -> None:
    with raises(UserError, says="between 0 and 1"):
        Controller(ControllerOptions(speed_slider=2.0), resting_joints)

"""Safety system, power, program state and script ports of the stand-in, without sockets or a clock."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples, seldom
from tests.sim_backend.ur_controller.server.wire import robot
from toolee_robot.sim_backend.ur_controller.process import Q_START
from toolee_robot.sim_backend.ur_controller.profile import StopDecelerations
from toolee_robot.sim_backend.ur_controller.robot.safety_system import SafetyMode
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.server.primary import ScriptReader
from toolee_robot.sim_backend.ur_controller.urscript.program import RuntimeState

SWING = "def swing():\n  speedj([1.5, 0, 0, 0, 0, 0], 40, 5)\nend\n"


def ticks(served: Robot, seconds: float) -> None:
    for _ in range(round(seconds * served.model.rate)):
        served.step()


def swinging(model: str) -> Robot:
    """A robot whose base turns at full 1.5 rad/s."""
    served = robot(model)
    served.program.upload(SWING)
    ticks(served, 0.3)
    assert served.plant.qd[0] == pytest.approx(1.5)
    return served


@pytest.mark.parametrize("model", ["UR10", "UR10e"])
@pytest.mark.parametrize(
    ("stop", "mode", "bits"),
    [
        (lambda s: s.safety.protective_stop("test"), SafetyMode.PROTECTIVE_STOP, 1 << 2 | 1 << 10),
        (lambda s: s.safety.emergency_stop(), SafetyMode.ROBOT_EMERGENCY_STOP, 1 << 6 | 1 << 7 | 1 << 10),
        (lambda s: s.safety.emergency_stop(system=True), SafetyMode.SYSTEM_EMERGENCY_STOP, 1 << 5 | 1 << 7 | 1 << 10),
        (lambda s: s.safety.fault(), SafetyMode.FAULT, 1 << 9 | 1 << 10),
        (lambda s: s.safety.fault(violation=True), SafetyMode.VIOLATION, 1 << 8 | 1 << 10),
    ],
)
def test_stops_brake_as_hard_as_the_model_says(
    model: str, stop: Callable[[Robot], None], mode: SafetyMode, bits: int
) -> None:
    served = swinging(model)
    stop(served)
    assert served.safety.mode is mode
    assert served.safety.status_bits == bits
    speeds = [served.plant.qd[0]]
    while abs(served.plant.qd[0]) > 0.0:
        served.step()
        speeds.append(served.plant.qd[0])
    deceleration = -np.diff(speeds) * served.model.rate
    assert np.max(deceleration) <= StopDecelerations().emergency * (1 + 1e-9)
    shortest = 1.5 / StopDecelerations().emergency
    assert (len(speeds) - 1) * served.model.period <= shortest + 2 * served.model.period
    at_rest = served.plant.q.copy()
    ticks(served, 0.5)
    np.testing.assert_array_equal(served.plant.q, at_rest)


@pytest.mark.parametrize("model", seldom("UR10", "UR10e"))
def test_after_a_protective_stop_play_resumes_the_old_motion(model: str) -> None:
    goal = Q_START + np.array([0.8, 0, 0, 0, 0, 0])
    moves = {
        "movej": f"movej({goal.tolist()}, 5, 1.5)",
        "servoj": f"servoj({goal.tolist()}, 0, 0, 0.5, 0.1, 300)",
        "speedj": "speedj([1.0, 0, 0, 0, 0, 0], 5, 0.8)",
    }
    for name, line in moves.items():
        served = robot(model)
        served.program.upload(f"def swing():\n  {line}\n  sleep(1)\nend\n")
        ticks(served, 0.35)
        served.safety.protective_stop("test")
        ticks(served, 6.0)
        stopped = served.plant.q.copy()
        assert not np.any(served.plant.qd), name
        assert stopped[0] < goal[0] - 0.05, name
        assert not served.program.resume(), name
        assert served.safety.unlock() == "", name
        ticks(served, 1.0)
        np.testing.assert_array_equal(served.plant.q, stopped, err_msg=name)
        assert served.program.resume(), name
        ticks(served, 0.4)
        assert served.plant.q[0] > stopped[0] + 0.05, name
        ticks(served, 3.0)
        if name != "speedj":
            np.testing.assert_allclose(served.plant.q, goal, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("end", ["stop", "upload"])
def test_a_program_stopped_while_paused_never_goes_on(end: str) -> None:
    served = swinging("UR10")
    served.safety.protective_stop("test")
    served.step()  # still braking
    speed = served.plant.qd[0]
    served.program.stop()
    ticks(served, 0.5 * speed / StopDecelerations().emergency)
    assert served.plant.qd[0] == pytest.approx(0.5 * speed, abs=0.15), "the end of the program must not soften the stop"
    ticks(served, 6.0)
    stopped = served.plant.q.copy()
    served.safety.unlock()
    if end == "upload":
        served.program.upload("def idle():\n  sleep(1)\nend\n")
    else:
        assert not served.program.resume()
    ticks(served, 0.5)
    np.testing.assert_array_equal(served.plant.q, stopped)


def test_the_watchdog_does_not_count_while_the_program_is_paused() -> None:
    served = robot("UR10")
    served.program.upload(
        "def swing():\n"
        '  rtde_set_watchdog("input_int_register_0", 10, "stop")\n'
        "  speedj([1.0, 0, 0, 0, 0, 0], 5, 5)\n"
        "end\n"
    )
    ticks(served, 0.05)
    served.safety.protective_stop("test")
    ticks(served, 6.0)
    served.safety.unlock()
    assert served.program.name == "swing"
    stopped = served.plant.q[0]
    assert served.program.resume()
    ticks(served, 0.5)
    assert served.program.name == ""
    assert served.plant.q[0] > stopped


def test_a_cb3_without_a_reset_input_resumes_when_the_safeguard_closes() -> None:
    served = swinging("UR10")
    served.safety.safeguard_resumes = True
    served.safety.safeguard_stop()
    ticks(served, 0.5)
    assert served.plant.qd[0] == 0.0
    served.safety.release_safeguard_stop()
    ticks(served, 0.3)
    assert served.plant.qd[0] > 0.0


def test_a_short_strike_is_not_a_push() -> None:
    served = robot("UR10e")
    served.plant.external_force = np.array([0.0, 0.0, 600.0, 0.0, 0.0, 0.0])
    ticks(served, 0.002)
    served.plant.external_force = np.zeros(6)
    ticks(served, 0.2)
    assert served.safety.mode is SafetyMode.NORMAL


def test_a_safeguard_stop_pauses_and_goes_on_only_when_played() -> None:
    served = swinging("UR10")
    served.safety.safeguard_stop()
    assert served.program.state is RuntimeState.PAUSED
    assert served.safety.status_bits == 1 << 4 | 1 << 10
    ticks(served, 0.3)
    assert served.plant.qd[0] == 0.0
    assert not served.program.resume()
    served.safety.release_safeguard_stop()
    ticks(served, 0.5)
    assert served.plant.qd[0] == 0.0
    assert served.program.resume()
    ticks(served, 0.3)
    assert served.plant.qd[0] > 0.0


def test_a_fault_needs_a_restart_of_the_safety_system() -> None:
    served = robot()
    served.safety.fault()
    assert not served.safety.power_on()
    served.safety.restart()
    assert served.safety.brake_release()
    ticks(served, 2.0)
    assert served.safety.forbidden() == ""


def test_a_new_program_takes_the_place_of_the_old_one() -> None:
    served = swinging("UR10")
    served.program.upload("def second():\n  while True:\n    sync()\n  end\nend\n")
    ticks(served, 0.05)
    assert served.program.name == "second"
    ticks(served, 1.0)
    assert served.plant.qd[0] == 0.0


def test_a_program_that_does_not_parse_is_not_run() -> None:
    served = robot()
    served.program.upload("def broken():\n  movej([\nend\n")
    ticks(served, 0.1)
    assert served.program.state is RuntimeState.STOPPED
    assert "script not started" in served.program.last_error


@examples(60)
@given(st.data())
def test_programs_are_cut_out_of_any_stream(data: st.DataObject) -> None:
    program = "def job():\n  if True:\n    sync()\n  end\nend\n"
    stream = f"# a comment\n{program}\nset_digital_out(1, True)\r\nsec aside():\n  sync()\nend\n{program}".encode()
    reader, found = ScriptReader(), []
    while stream:
        size = data.draw(st.integers(1, max(8, len(stream) // 2)))
        found += reader.feed(stream[:size])
        stream = stream[size:]
    assert found == [
        program,
        "def unnamed():\n  set_digital_out(1, True)\nend\n",
        "sec aside():\n  sync()\nend\n",
        program,
    ]

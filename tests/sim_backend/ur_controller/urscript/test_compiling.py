"""Long programs are compiled beside the ticks."""

from __future__ import annotations

import time

import numpy as np
import pytest

from toolee_robot.sim_backend.ur_controller.robot.plant import UR10, JointPlant
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.urscript.program import WAITING, RuntimeState

pytestmark = pytest.mark.sim

SHORT = "def first():\n  while True:\n    sync()\n  end\nend\n"


def long(name: str, last: str = "sync()") -> str:
    """Some 60 KB."""
    lines = "".join(
        f"  if x > {i}:\n    x = x + {i} * (y - 3)\n    movej([0, 0, x, 0, 0, {i}])\n  end\n" for i in range(900)
    )
    return f"def {name}():\n  x = 0\n  y = 3\n{lines}  while True:\n    {last}\n  end\nend\n"


def robot() -> Robot:
    return Robot(UR10, JointPlant(UR10, np.zeros(6)))


def ticks_until(served: Robot, name: str) -> int:
    """How many ticks pass until a program of this name plays."""
    deadline = time.monotonic() + 60.0
    count = 0
    while served.program.name != name or served.program.state is not RuntimeState.PLAYING:
        assert time.monotonic() < deadline, served.program.last_error
        served.step()
        count += 1
        time.sleep(UR10.period / 4)
    return count


def test_the_running_program_goes_on_meanwhile() -> None:
    served = robot()
    served.program.upload(SHORT)
    assert ticks_until(served, "first") <= 2
    served.program.upload(long("second"))
    served.step()
    assert (served.program.name, served.program.state) == ("first", RuntimeState.PLAYING)
    assert served.program.starting
    assert ticks_until(served, "second") > 5
    served.program.upload(SHORT)
    ticks_until(served, "first")
    served.program.upload(long("second"))
    assert ticks_until(served, "second") <= 2, "it has been compiled before"


def test_programs_start_in_the_order_in_which_they_came() -> None:
    served = robot()
    served.program.upload(long("third"))
    served.program.upload(SHORT)
    assert ticks_until(served, "first") > 5


def test_a_stop_ends_what_waits() -> None:
    served = robot()
    served.program.upload(long("fourth"))
    served.step()
    served.program.stop()
    assert not served.program.starting
    for _ in range(100):
        served.step()
        time.sleep(UR10.period)
    assert served.program.state is RuntimeState.STOPPED
    served.program.upload(SHORT)
    assert ticks_until(served, "first") <= 2


def test_what_does_not_parse_says_so_with_its_line() -> None:
    served = robot()
    served.program.upload(long("fifth", last="movej(["))
    deadline = time.monotonic() + 60.0
    while not served.program.last_error:
        assert time.monotonic() < deadline
        served.step()
        time.sleep(UR10.period)
    assert "script not started: line 36" in served.program.last_error
    assert not served.program.starting


def test_too_many_at_a_time_are_refused() -> None:
    served = robot()
    for i in range(WAITING + 1):
        served.program.upload(long(f"p{i}"))
    assert "others are waiting" in served.program.last_error
    served.program.stop()

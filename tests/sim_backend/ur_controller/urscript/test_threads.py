"""Threads of a script against the controller's ticks."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tests.sim_backend.ur_controller.urscript.script_robot import ScriptRobot
from toolee_robot.sim_backend.ur_controller.profile import StopDecelerations
from toolee_robot.sim_backend.ur_controller.robot.plant import UR10, UR10E, ControllerModel, JointPlant
from toolee_robot.sim_backend.ur_controller.robot.registers import EventKind
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.urscript.program import WAITING, RuntimeState, ScriptRuntime

both = pytest.mark.parametrize("model", [UR10, UR10E], ids=lambda m: m.name)


def test_sync_ends_a_threads_tick_and_main_goes_first() -> None:
    robot = ScriptRobot()
    robot.start(
        """def a():
 global n = 0
 thread count():
  while True:
   n = n + 1
   textmsg("thread ", n)
   sync()
  end
 end
 run count()
 while True:
  textmsg("main ", n)
  sync()
 end
end"""
    )
    robot.tick(3)
    assert robot.messages == ["main 0", "thread 1", "main 1", "thread 2", "main 2", "thread 3"]


@both
def test_sleep_takes_its_time_in_whole_ticks(model: ControllerModel) -> None:
    robot = ScriptRobot(model)
    runtime = robot.start("def a():\n sleep(0.1)\n textmsg(1)\nend")
    ticks = 0
    while runtime.running:
        robot.tick()
        ticks += 1
    assert ticks == -(-0.1 * model.rate // 1) + 1


def test_a_critical_section_holds_the_others_up_even_while_it_waits() -> None:
    robot = ScriptRobot()
    robot.start(
        """def a():
 thread other():
  while True:
   textmsg("other")
   sync()
  end
 end
 run other()
 sync()
 enter_critical
 sleep(0.01)
 textmsg("out")
 exit_critical
 sleep(0.004)
end"""
    )
    robot.tick(10)
    assert robot.messages == ["other", "out", "other", "other"]


def test_join_waits_kill_ends_and_zero_is_no_thread() -> None:
    robot = ScriptRobot()
    runtime = robot.run(
        """def a():
 thread short(text):
  sleep(0.02)
  textmsg(text)
 end
 thread endless():
  while True:
   sync()
  end
  textmsg("never")
 end
 h = 0
 kill h
 join h
 h = run short("done")
 join h
 textmsg("joined")
 e = run endless()
 sync()
 kill e
 kill e
 join e
 if e != 0:
  textmsg("a handle is not 0")
 end
end"""
    )
    assert runtime.error is None
    assert robot.messages == ["done", "joined", "a handle is not 0"]


def test_all_threads_end_with_main_and_halt_ends_main_from_anywhere() -> None:
    robot = ScriptRobot()
    body = (
        "def a():\n thread t():\n  sleep(0.01)\n  {}\n  while True:\n   textmsg(1)\n   sync()\n  end\n end\n run t()\n"
    )
    robot.run(body.format("sync()") + " sleep(0.02)\nend")
    printed = len(robot.messages)
    assert printed > 0
    robot.tick(20)
    assert len(robot.messages) == printed
    halted = ScriptRobot()
    halted.run(body.format("halt") + " sleep(100)\nend", seconds=1.0)
    assert halted.messages == []
    assert [event.kind for event in halted.events] == [EventKind.HALT]


def test_an_error_in_a_thread_ends_the_program() -> None:
    robot = ScriptRobot()
    runtime = robot.run("def a():\n thread t():\n  sync()\n  x = [1][1]\n end\n run t()\n sleep(100)\nend", seconds=1.0)
    assert runtime.error is not None
    assert runtime.error.line == 4


def test_a_killed_move_decelerates() -> None:
    robot = ScriptRobot(UR10)
    robot.start(
        """def a():
 thread t():
  movej([1.3, -1.4, 1.6, -1.8, -1.5, 0.2], a=5, v=1)
 end
 h = run t()
 sleep(0.5)
 kill h
 sleep(5)
end"""
    )
    robot.tick(round(0.5 * 125) + 1)
    assert robot.machine.moving
    robot.tick(round(125 / StopDecelerations().program) + 1)
    assert not robot.machine.moving
    assert robot.plant.q[0] < 1.0


def test_a_secondary_program_runs_beside_the_main_one_and_leaves_it_alone() -> None:
    robot = ScriptRobot()
    main = robot.start("def a():\n movej([0.5, -1.4, 1.6, -1.8, -1.5, 0.2])\nend")
    robot.tick(10)
    second = ScriptRuntime("sec b():\n set_digital_out(1, True)\n textmsg(get_digital_out(1))\nend", robot.machine)
    assert second.secondary
    second.step(0.002)
    robot.tick()
    assert not second.running
    assert robot.machine.digital_out[1]
    assert robot.messages == ["True"]
    robot.tick(1000)
    assert not main.running
    assert robot.plant.q[0] == pytest.approx(0.5)


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


@pytest.mark.nightly
@pytest.mark.sim
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


@pytest.mark.nightly
@pytest.mark.sim
def test_programs_start_in_the_order_in_which_they_came() -> None:
    served = robot()
    served.program.upload(long("third"))
    served.program.upload(SHORT)
    assert ticks_until(served, "first") > 5


@pytest.mark.sim
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


@pytest.mark.sim
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


@pytest.mark.sim
def test_too_many_at_a_time_are_refused() -> None:
    served = robot()
    for i in range(WAITING + 1):
        served.program.upload(long(f"p{i}"))
    assert "others are waiting" in served.program.last_error
    served.program.stop()

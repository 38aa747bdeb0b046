"""Motions of the stand-in, as an outside observer measures them at the joints and at the TCP."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from tests.sim_backend.ur_controller.urscript.script_robot import READY, ScriptRobot
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import StopDecelerations
from toolee_robot.sim_backend.ur_controller.robot import poses
from toolee_robot.sim_backend.ur_controller.robot.kinematics import forward
from toolee_robot.sim_backend.ur_controller.robot.plant import UR10, UR10E, ControllerModel, JointPlant
from toolee_robot.sim_backend.ur_controller.robot.registers import EventKind
from toolee_robot.sim_backend.ur_controller.robot.sensors import PayloadError

both = pytest.mark.parametrize("model", [UR10, UR10E], ids=lambda m: m.name)
offsets = st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(np.array)


def accelerations(robot: ScriptRobot) -> Array:
    return np.diff(robot.speeds(), axis=0) * robot.model.rate


def tcp_path(robot: ScriptRobot) -> Array:
    """(ticks, 3) [m]."""
    X = robot.machine.X_flange_tcp
    return np.array([(forward(robot.model, q) @ X)[:3, 3] for q in robot.trace])


@given(offsets, st.floats(0.3, 3.0), st.floats(0.5, 20.0), st.sampled_from([UR10, UR10E]))
@examples(25)
def test_movej_arrives_together_within_its_limits(offset: Array, v: float, a: float, model: ControllerModel) -> None:
    robot = ScriptRobot(model)
    goal = np.array(READY) + offset
    runtime = robot.run(f"movej({goal.tolist()}, a={a}, v={v})")
    assert runtime.error is None
    np.testing.assert_allclose(robot.plant.q, goal, atol=1e-9)
    speeds = np.abs(robot.speeds())
    assert speeds.max() <= v * (1 + 1e-6)
    assert np.all(speeds.max(axis=0) <= np.array(model.velocity) * (1 + 1e-6))
    assert np.abs(accelerations(robot)).max() <= a * (1 + 1e-6)
    way = np.array(robot.trace) - READY
    straight = np.outer(way @ offset / (float(offset @ offset) + 1e-30), offset)
    np.testing.assert_allclose(way, straight, atol=1e-9)


def test_movej_takes_the_time_it_is_given() -> None:
    robot = ScriptRobot(UR10)
    robot.run("movej([0.3, -1.4, 1.6, -1.3, -1.5, 0.2], t=2)")
    assert len(robot.trace) == pytest.approx(2.0 * 125, abs=4)


@both
def test_movel_is_straight_and_even(model: ControllerModel) -> None:
    robot = ScriptRobot(model)
    robot.run(
        """def a():
  set_tcp(p[0, 0, 0.1, 0, 0.2, 0])
  here = get_actual_tcp_pose()
  movel(pose_trans(here, p[0, 0.05, -0.1, 0, 0, 0.3]), a=1.0, v=0.2)
end"""
    )
    start = poses.matrix([0, 0, 0.1, 0, 0.2, 0])
    X0 = forward(model, READY) @ start
    goal = X0 @ poses.matrix([0, 0.05, -0.1, 0, 0, 0.3])
    np.testing.assert_allclose(robot.machine.tcp_pose(), goal, atol=1e-9)
    path = tcp_path(robot)
    way = path - path[0]
    direction = way[-1] / np.linalg.norm(way[-1])
    assert np.abs(way - np.outer(way @ direction, direction)).max() < 1e-9
    speed = np.diff(way @ direction) * model.rate
    assert speed.max() <= 0.2 + 1e-6  # the turn of 0.3 rad is longer than the way of 0.11 m, and sets the duration
    assert np.abs(np.diff(speed)).max() * model.rate <= 1.0 + 1e-6


def test_movec_is_round() -> None:
    robot = ScriptRobot(UR10E)
    runtime = robot.run(
        """def a():
  here = get_actual_tcp_pose()
  via = pose_add(here, p[0.05, 0, 0.05, 0, 0, 0])
  movec(via, pose_add(here, p[0.1, 0, 0, 0, 0, 0]), a=0.5, v=0.1)
end"""
    )
    assert runtime.error is None
    path = tcp_path(robot) - tcp_path(robot)[0]
    np.testing.assert_allclose(np.linalg.norm(path - [0.05, 0, 0], axis=1), 0.05, atol=1e-9)
    assert path[:, 2].max() == pytest.approx(0.05, abs=1e-4)
    np.testing.assert_allclose(path[-1], [0.1, 0, 0], atol=1e-9)


def test_a_blend_does_not_stop_and_does_not_stray() -> None:
    corner, end = "[0.3, -1.2, 1.6, -1.8, -1.5, 0.2]", "[0.3, -1.2, 1.2, -1.8, -1.5, 0.2]"
    sharp, blended = ScriptRobot(UR10E), ScriptRobot(UR10E)
    program = "def a():\n movej({}, a=2, v=0.5{})\n movej({}, a=2, v=0.5)\nend"
    sharp.run(program.format(corner, "", end))
    blended.run(program.format(corner, ", r=0.03", end))
    np.testing.assert_allclose(blended.plant.q, [0.3, -1.2, 1.2, -1.8, -1.5, 0.2], atol=1e-9)
    assert len(blended.trace) < len(sharp.trace) - 20
    middle = slice(20, -20)
    assert np.linalg.norm(sharp.speeds()[middle], axis=1).min() < 0.005
    assert np.linalg.norm(blended.speeds()[middle], axis=1).min() > 0.02
    tip = forward(UR10E, [0.3, -1.2, 1.6, -1.8, -1.5, 0.2])[:3, 3]
    assert np.linalg.norm(tcp_path(blended) - tip, axis=1).min() < 0.03


def test_a_line_through_a_singularity_is_a_protective_stop() -> None:
    robot = ScriptRobot(UR10, (0.0, -1.5, 1.5, -1.5, -1.5, 0.0))
    robot.start(
        """def a():
 here = get_actual_tcp_pose()
 movel(p[-here[0], -here[1], here[2], here[3], here[4], here[5]])
end"""
    )
    robot.tick(2500)
    assert [e for e in robot.events if e.kind is EventKind.PROTECTIVE_STOP]
    assert not robot.machine.moving
    assert np.all(np.abs(robot.speeds()) <= np.array(UR10.velocity) * (1 + 1e-6))


def test_servoc_reaches_its_pose_within_its_limits() -> None:
    robot = ScriptRobot(UR10E)
    runtime = robot.run(
        """def a():
 goal = pose_trans(get_actual_tcp_pose(), p[0.05, 0, -0.1, 0, 0.2, 0])
 servoc(goal, a=0.8, v=0.2)
end"""
    )
    assert runtime.error is None
    goal = forward(UR10E, READY) @ poses.matrix([0.05, 0, -0.1, 0, 0.2, 0])
    np.testing.assert_allclose(robot.machine.tcp_pose(), goal, atol=1e-5)
    speed = np.linalg.norm(np.diff(tcp_path(robot), axis=0), axis=1) * 500
    assert speed.max() == pytest.approx(0.2, rel=0.01)
    assert np.abs(np.diff(speed)).max() * 500 <= 0.8 * 1.1


def test_freedrive_goes_where_it_is_pushed_and_stops_when_it_is_let_go() -> None:
    robot = ScriptRobot(UR10E)
    robot.start("def a():\n freedrive_mode()\n sleep(1)\n end_freedrive_mode()\n sleep(1)\nend")
    start = robot.machine.tcp_pose()[:3, 3]
    robot.plant.external_force = np.array([0.0, 10.0, 0.0, 0.0, 0.0, 0.0])
    robot.tick(400)
    moved = robot.machine.tcp_pose()[:3, 3] - start
    assert moved[1] > 0.05
    assert np.abs(moved[[0, 2]]).max() < 0.01
    robot.tick(200)
    assert not robot.machine.moving


@both
def test_noise_and_offset_of_the_force_move_no_arm_in_freedrive_but_a_wrong_payload_does(
    model: ControllerModel,
) -> None:
    robot = ScriptRobot(model, name="harsh")
    robot.start("def a():\n teach_mode()\n sleep(10)\nend")
    ticks = round(model.rate)
    start = robot.machine.tcp_pose(target=True)[:3, 3]
    robot.tick(ticks)
    assert np.linalg.norm(robot.machine.wrench()[:3]) > 1.0, "the reading is off, and noisy"
    np.testing.assert_allclose(robot.machine.tcp_pose(target=True)[:3, 3], start, atol=1e-6)
    robot.machine.sensors.payload_error = PayloadError(1.0)
    robot.tick(ticks)
    assert robot.machine.tcp_pose(target=True)[2, 3] < start[2] - 0.02


# -- speed and stopping


@both
@pytest.mark.parametrize("ending", ["stop", "error", "kill"])
def test_an_arm_that_loses_its_program_decelerates(model: ControllerModel, ending: str) -> None:
    robot = ScriptRobot(model)
    action = {"stop": "sync()", "error": "x = 1 / 0", "kill": "kill t\n sleep(2)"}[ending]
    runtime = robot.start(
        f"""def a():
 thread move():
   while True:
     speedj([0, 0, 0, 0, 0, 1], a=20, t=0.02)
   end
 end
 t = run move()
 sleep(0.5)
 {action}
 while True:
   sync()
 end
end"""
    )
    robot.tick(round(0.5 * model.rate) - 2)
    assert robot.plant.qd[5] == pytest.approx(1.0, abs=1e-6)
    before = len(robot.trace)
    robot.tick(2)
    if ending == "stop":
        runtime.stop()
    robot.tick(round(model.rate))
    assert not robot.machine.moving
    speeds = robot.speeds()[before:, 5]
    fall = -np.diff(speeds) * model.rate
    assert fall.max() == pytest.approx(StopDecelerations().program, rel=1e-3)
    took = np.count_nonzero(speeds > 1e-6) / model.rate
    assert took == pytest.approx(1.0 / StopDecelerations().program, abs=4 * model.period)


MOTIONS = [
    "movej([1.3, -1.0, 1.2, -1.8, -1.0, 0.2], a=4, v=1.5)",
    "movel(pose_trans(get_actual_tcp_pose(), p[0.1, 0.1, -0.15, 0, 0, 0.5]), a=2, v=0.5)",
    "movec(pose_add(get_actual_tcp_pose(), p[0.05, 0, 0.05, 0, 0, 0]), pose_add(get_actual_tcp_pose(), "
    "p[0.1, 0, 0, 0, 0, 0]), a=1, v=0.3)",
    "speedl([0.1, -0.2, 0.1, 0, 0, 0.3], a=1, t=5)",
    "servoj([0.8, -1.4, 1.6, -1.8, -1.5, 0.2], t=0.8)",
    "servoc(pose_trans(get_actual_tcp_pose(), p[0.1, 0.1, -0.15, 0, 0, 0.5]), a=1, v=0.3)",
    "force_mode(p[0, 0, 0, 0, 0, 0], [1, 1, 1, 0, 0, 0], [50, 40, 30, 0, 0, 0], 2, [0.2, 0.2, 0.2, 1, 1, 1])\n sync()",
]


@given(st.sampled_from(MOTIONS), st.floats(0.0, 1.0), st.sampled_from([UR10, UR10E]), st.booleans())
@examples(40)
def test_every_motion_can_be_stopped_at_any_time(motion: str, when: float, model: ControllerModel, hard: bool) -> None:
    """The program's stop and the safety system's: in the direction of the moment, at the deceleration stated."""
    robot = ScriptRobot(model)
    runtime = robot.start(f"def a():\n {motion}\n sleep(10)\nend")
    robot.tick(round(when * model.rate))
    speed = robot.machine.qd_target
    before = len(robot.trace)
    if hard:
        robot.machine.stop(StopDecelerations().protective)
    runtime.stop()
    deceleration = StopDecelerations().protective if hard else StopDecelerations().program
    robot.tick(round((np.abs(speed).max() / deceleration + 0.02) * model.rate) + 1)
    assert not robot.machine.moving
    after = np.vstack([speed, robot.speeds()[before - 1 :]])
    assert np.abs(np.diff(after, axis=0)).max() * model.rate <= deceleration * (1 + 1e-6)
    along = after @ speed / (float(speed @ speed) + 1e-30)
    np.testing.assert_allclose(after, np.outer(along, speed), atol=1e-9)
    assert np.all(np.diff(along) <= 1e-9)


def test_speedj_without_a_time_returns_at_its_speed() -> None:
    robot = ScriptRobot(UR10E)
    robot.run("def a():\n speedj([0, 0, 0, 0, 0.6, 0], a=2)\n textmsg(get_target_joint_speeds()[4])\n stopj(3)\nend")
    assert robot.messages == ["0.6"]
    assert np.abs(accelerations(robot)).max() == pytest.approx(3.0, rel=1e-3)


def test_speedl_and_stopl_keep_to_their_line_and_accelerations() -> None:
    robot = ScriptRobot(UR10E)
    robot.run("def a():\n speedl([0.1, 0.2, -0.1, 0, 0, 0], a=0.5, t=1)\n stopl(0.8)\nend")
    path = tcp_path(robot)
    velocity = np.diff(path, axis=0) * 500
    direction = np.array([0.1, 0.2, -0.1]) / np.linalg.norm([0.1, 0.2, -0.1])
    speed = velocity @ direction
    assert speed.max() == pytest.approx(np.linalg.norm([0.1, 0.2, -0.1]), rel=1e-3)
    assert np.linalg.norm(velocity - np.outer(speed, direction), axis=1).max() < 0.01
    changes = np.diff(speed[1:-1]) * 500
    assert changes.max() == pytest.approx(0.5, rel=0.02)
    assert -changes.min() == pytest.approx(0.8, rel=0.05)  # joints slow down together: nearly, not exactly


@both
def test_slider_and_pause_slow_a_move_down_on_its_path(model: ControllerModel) -> None:
    full, half = ScriptRobot(model), ScriptRobot(model)
    half.machine.speed_fraction = 0.5
    move = "movej([0.3, -1.0, 1.6, -1.8, -1.5, 0.9], a=2, v=0.8)"
    full.run(move)
    half.start(move)
    half.tick(round(0.5 * model.rate))
    half.machine.paused = True
    half.tick(round(0.5 * model.rate))
    standing = half.plant.q
    half.tick(20)
    np.testing.assert_array_equal(half.plant.q, standing)
    half.machine.paused = False
    half.tick(round(3.0 * model.rate))
    np.testing.assert_allclose(half.plant.q, full.plant.q, atol=1e-9)
    assert np.abs(half.speeds()).max() <= 0.4 + 0.1  # the first eighth of a second is still on the way to half
    way = np.array(half.trace) - READY
    np.testing.assert_allclose(way[:, 5], way[:, 1] * (0.7 / 0.4), atol=1e-9)


def test_two_threads_cannot_drive_one_arm() -> None:
    robot = ScriptRobot(UR10)
    runtime = robot.run(
        """def a():
 thread t():
   movej([0, -1, 1, -1, -1, 0])
 end
 h = run t()
 sync()
 sync()
 movej([0.3, -1.4, 1.6, -1.8, -1.5, 0])
end"""
    )
    assert "already controlling" in str(runtime.error)
    assert not robot.machine.moving


@both
def test_force_mode_gives_way_only_where_it_may(model: ControllerModel) -> None:
    robot = ScriptRobot(model)
    robot.plant.external_force = np.array([30.0, 30.0, 0, 0, 0, 0])
    start = robot.machine.tcp_pose()
    limits = "[0.1, 0.1, 0.02, 0.1, 0.1, 0.1]"
    robot.start(
        f"""def a():
 force_mode(p[0, 0, 0, 0, 0, 0], [0, 1, 1, 0, 0, 0], [0, 0, -50, 0, 0, 0], 2, {limits})
 sleep(1)
 end_force_mode()
end"""
    )
    robot.tick(round(1.5 * model.rate))
    moved = robot.machine.tcp_pose()[:3, 3] - start[:3, 3]
    assert abs(moved[0]) < 1e-4
    assert 0.03 < moved[1] < 0.1
    assert -0.021 < moved[2] < -0.017  # as fast as its limit allows, towards the force it shall exert
    assert not robot.machine.moving


def test_the_plant_goes_no_faster_than_its_joints() -> None:
    plant = JointPlant(UR10, np.zeros(6))
    plant.command(np.ones(6), np.zeros(6))
    plant.step(0.008)
    np.testing.assert_allclose(plant.q, np.array(UR10.velocity) * 0.008, rtol=1e-6)
    np.testing.assert_allclose(plant.qd, UR10.velocity, rtol=1e-6)

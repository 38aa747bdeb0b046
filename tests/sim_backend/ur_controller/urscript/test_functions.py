"""URScript's functions, as scripts call them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from tests.examples import examples
from tests.sim_backend.ur_controller.urscript.script_robot import READY, ScriptRobot
from tests.strategies import transforms
from toolee_robot.frames import Array, inverse
from toolee_robot.sim_backend.ur_controller.robot import poses
from toolee_robot.sim_backend.ur_controller.robot.kinematics import forward
from toolee_robot.sim_backend.ur_controller.robot.plant import UR10, UR10E
from toolee_robot.sim_backend.ur_controller.robot.registers import EventKind
from toolee_robot.sim_backend.ur_controller.urscript.tokens import ScriptError


def written(robot: ScriptRobot, expression: str, count: int = 6) -> Array:
    """A list's numbers."""
    puts = "\n".join(f" write_output_float_register({i}, x[{i}])" for i in range(count))
    runtime = robot.run(f"def a():\n x = {expression}\n{puts}\nend")
    assert runtime.error is None, runtime.error
    return np.array(robot.registers.float_out[:count])


def pose(X: Array) -> str:
    return "p[" + ", ".join(f"{number:.17g}" for number in poses.vector(X)) + "]"


@given(transforms(), transforms())
@examples(40)
def test_pose_functions(X: Array, Y: Array) -> None:
    robot = ScriptRobot()

    def of(expression: str) -> Array:
        return poses.matrix(written(robot, expression))

    np.testing.assert_allclose(of(f"pose_trans({pose(X)}, {pose(Y)})"), X @ Y, atol=1e-8)
    np.testing.assert_allclose(of(f"pose_inv({pose(X)})"), inverse(X), atol=1e-8)
    back = of(f"pose_add({pose(X)}, pose_sub({pose(Y)}, {pose(X)}))")
    np.testing.assert_allclose(back, Y, atol=1e-8)
    assert robot.value(f"point_dist({pose(X)}, {pose(Y)})") == pytest.approx(np.linalg.norm(X[:3, 3] - Y[:3, 3]))


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("norm([3, 4])", 5),
        ("norm(-2)", 2),
        ("d2r(180)", np.pi),
        ("r2d(atan2(1, -1))", 135),
        ("log(2, 8)", 3),
        ("pow(2, 0.5)", 2**0.5),
        ("ceil(-1.5) + floor(2.7)", 1),
        ("length([1, [2, 3]])", 2),
    ],
)
def test_mathematics_and_lists(expression: str, value: float) -> None:
    assert ScriptRobot().value(expression) == pytest.approx(value)


def test_the_tcp_is_where_the_kinematics_say() -> None:
    robot = ScriptRobot(UR10)
    offset = [0.01, 0.02, 0.1, 0.3, -0.2, 0.1]
    robot.run(f"set_tcp(p{offset})")
    X = forward(UR10, READY) @ poses.matrix(offset)
    for name in ("get_actual_tcp_pose()", "get_target_tcp_pose()", "get_forward_kin()"):
        np.testing.assert_allclose(poses.matrix(written(robot, name)), X, atol=1e-9)
    np.testing.assert_allclose(written(robot, "get_inverse_kin(get_actual_tcp_pose())"), READY, atol=1e-9)
    flange = written(robot, "get_forward_kin(get_actual_joint_positions(), p[0, 0, 0, 0, 0, 0])")
    np.testing.assert_allclose(poses.matrix(flange), forward(UR10, READY), atol=1e-9)
    near = written(robot, f"get_inverse_kin({pose(X)}, [0.3, -1.4, 1.6, 4.4, -1.5, 0.2])")
    np.testing.assert_allclose(near, np.add(READY, [0, 0, 0, 2 * np.pi, 0, 0]), atol=1e-8)
    robot.run("write_output_boolean_register(3, get_inverse_kin_has_solution(p[2, 0, 0, 0, 0, 0]))")
    assert not robot.registers.bool_out[3]


def test_forces_at_the_tcp_and_zeroing() -> None:
    robot = ScriptRobot(UR10E)
    robot.plant.external_force = np.array([10.0, -5.0, 20.0, 0.5, 0.0, -0.3])
    robot.run("set_tcp(p[0, 0, 0.2, 0, 0, 0])")
    arm = forward(UR10E, READY)[:3, :3] @ [0, 0, 0.2]
    expected = [10, -5, 20, *([0.5, 0.0, -0.3] - np.cross(arm, [10, -5, 20]))]
    np.testing.assert_allclose(written(robot, "get_tcp_force()"), expected, atol=1e-9)
    robot.run("zero_ftsensor()")
    np.testing.assert_allclose(written(robot, "get_tcp_force()"), np.zeros(6), atol=1e-9)
    robot.plant.external_force[2] += 30.0
    assert robot.value("force()") == pytest.approx(30.0)


def test_tool_contact_counts_back_to_just_before_the_contact() -> None:
    robot = ScriptRobot(UR10E)
    robot.tick(20)
    assert robot.value("tool_contact(p[0, 0, -1, 0, 0, 0])") == 0
    robot.plant.external_force = np.array([0, 0, 25.0, 0, 0, 0])
    robot.tick(7)
    down, up = robot.value("tool_contact(p[0, 0, -1, 0, 0, 0])"), robot.value("tool_contact(p[0, 0, 1, 0, 0, 0])")
    assert up == 0
    assert 7 <= down <= 10  # the script's own ticks are in it
    assert robot.value("tool_contact()") > 0


def test_registers_channels_and_messages() -> None:
    robot = ScriptRobot()
    robot.registers.int_in[47], robot.registers.float_in[2], robot.registers.bool_in[64] = -7, 0.25, True
    robot.run(
        """def a():
 write_output_integer_register(12, read_input_integer_register(47) * 2)
 write_output_float_register(13, read_input_float_register(2))
 write_output_boolean_register(65, read_input_boolean_register(64))
 set_standard_digital_out(2, True)
 set_digital_out(9, True)
 popup("hello", title="greeting")
 textmsg("q: ", get_actual_joint_positions())
 protective_stop()
end"""
    )
    registers = robot.registers
    assert (registers.int_out[12], registers.float_out[13], registers.bool_out[65]) == (-14, 0.25, True)
    assert [i for i, on in enumerate(robot.machine.digital_out) if on] == [2, 9]
    assert robot.messages == ["q: [0.3, -1.4, 1.6, -1.8, -1.5, 0.2]"]
    assert [e.kind for e in robot.events] == [EventKind.POPUP, EventKind.TEXT, EventKind.PROTECTIVE_STOP]


def test_payload_gravity_and_their_bounds() -> None:
    robot = ScriptRobot(UR10E)
    robot.run("set_target_payload(3, [0, 0, 0.05], [0.1, 0.1, 0.1, 0, 0, 0])")
    assert (robot.machine.payload, robot.machine.payload_inertia[0]) == (3.0, 0.1)
    runtime = robot.run("set_payload(12.6)")
    assert "12.5 kg" in str(runtime.error)
    assert robot.machine.payload == 3.0


@pytest.mark.parametrize("action", ["stop", "pause", "ignore"])
def test_a_watchdog_that_is_not_fed(action: str) -> None:
    robot = ScriptRobot(UR10)
    runtime = robot.start(
        f'def a():\n rtde_set_watchdog("input_double_register_3", 5, "{action}")\n while True:\n  sync()\n end\nend'
    )
    for _ in range(10):
        robot.tick(20)
        robot.machine.fed("input_double_register_3")
    assert runtime.running
    assert not robot.events
    robot.tick(24)  # 0.2 s are 25 ticks
    assert not robot.events
    robot.tick(4)
    kinds = [event.kind for event in robot.events]
    assert runtime.running == (action != "stop")
    expected = {"stop": [EventKind.TEXT], "pause": [EventKind.TEXT, EventKind.PAUSE], "ignore": []}
    assert kinds == expected[action]


def test_a_controller_knows_only_its_own_functions() -> None:
    script = "tool_contact(p[0, 0, 1, 0, 0, 0])"
    assert ScriptRobot(UR10E).value(script) == 0
    with pytest.raises(ScriptError, match="no function tool_contact"):
        ScriptRobot(UR10).value(script)

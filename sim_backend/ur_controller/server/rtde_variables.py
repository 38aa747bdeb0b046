"""RTDE output variables: names, types, first versions, and how their values are read.

Names and types: Universal Robots, "Real-Time Data Exchange (RTDE) guide", controller outputs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from toolee_robot.sim_backend.ur_controller.profile import RATIOS_SINCE
from toolee_robot.sim_backend.ur_controller.robot.registers import REGISTERS
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.server.rtde_types import width

Value = int | float | bool | Iterable[float]
BIT_REGISTERS = 128
_JOINT_RUNNING = 253  # joint_mode of a powered joint
_JOINT_OFF = 239


@dataclass(frozen=True)
class Output:
    """An output variable.

    Attributes:
        type_name: RTDE's type.
        read: Reads its value.
        cb3: First version (major, minor) of a CB3 controller that has it; None for no such version.
        e_series: First version (major, minor) of an e-Series controller that has it; None for no such version.
    """

    type_name: str
    read: Callable[[Robot], Value]
    cb3: tuple[int, int] | None = (3, 0)
    e_series: tuple[int, int] | None = (5, 0)


def _bits(flags: Iterable[bool]) -> int:
    return sum(1 << i for i, flag in enumerate(flags) if flag)


def _no_torque(_: Robot) -> list[float]:
    """Zero: motor currents [A] are not modelled."""
    return [0.0] * 6


_VECTOR = "VECTOR6D"
OUTPUTS: dict[str, Output] = {
    "timestamp": Output("DOUBLE", lambda r: r.timestamp),
    "target_q": Output(_VECTOR, lambda r: r.machine.q_target),
    "target_qd": Output(_VECTOR, lambda r: r.machine.qd_target),
    "target_qdd": Output(_VECTOR, lambda r: r.machine.qdd_target),
    "target_current": Output(_VECTOR, _no_torque),
    "target_moment": Output(_VECTOR, lambda r: r.reading.target_moment),
    "actual_q": Output(_VECTOR, lambda r: r.reading.q),
    "actual_qd": Output(_VECTOR, lambda r: r.reading.qd),
    "actual_current": Output(_VECTOR, _no_torque),
    "joint_control_output": Output(_VECTOR, _no_torque),
    "actual_TCP_pose": Output(_VECTOR, lambda r: r.reading.tcp_pose),
    "actual_TCP_speed": Output(_VECTOR, lambda r: r.reading.tcp_speed),
    "actual_TCP_force": Output(_VECTOR, lambda r: r.reading.tcp_force),
    "target_TCP_pose": Output(_VECTOR, lambda r: r.reading.target_tcp_pose),
    "target_TCP_speed": Output(_VECTOR, lambda r: r.reading.target_tcp_speed),
    "actual_digital_input_bits": Output("UINT64", lambda r: _bits(r.machine.digital_in)),
    "joint_temperatures": Output(_VECTOR, lambda r: r.machine.temperatures),
    "actual_execution_time": Output("DOUBLE", lambda r: 1e3 * r.model.period / 4),
    "robot_mode": Output("INT32", lambda r: r.safety.robot_mode),
    "joint_mode": Output("VECTOR6INT32", lambda r: [_JOINT_RUNNING if r.safety.powered else _JOINT_OFF] * 6),
    "safety_mode": Output("INT32", lambda r: r.safety.mode),
    "safety_status": Output("INT32", lambda r: r.safety.mode, (3, 10), (5, 4)),
    "actual_tool_accelerometer": Output("VECTOR3D", lambda r: r.reading.tool_acceleration),
    "speed_scaling": Output("DOUBLE", lambda r: r.machine.speed_scaling),
    "target_speed_fraction": Output("DOUBLE", lambda r: r.machine.speed_fraction),
    "actual_momentum": Output("DOUBLE", lambda r: r.reading.momentum),
    "actual_main_voltage": Output("DOUBLE", lambda _: 48.0),
    "actual_robot_voltage": Output("DOUBLE", lambda r: 48.0 if r.safety.powered else 0.0),
    "actual_robot_current": Output("DOUBLE", lambda _: 0.0),
    "actual_joint_voltage": Output(_VECTOR, lambda r: [48.0 if r.safety.powered else 0.0] * 6),
    "actual_digital_output_bits": Output("UINT64", lambda r: _bits(r.machine.digital_out)),
    "runtime_state": Output("UINT32", lambda r: r.program.state),
    "elbow_position": Output("VECTOR3D", lambda r: r.reading.elbow, (3, 5)),
    "robot_status_bits": Output("UINT32", lambda r: r.status_bits),
    "safety_status_bits": Output("UINT32", lambda r: r.safety.status_bits),
    "standard_analog_input0": Output("DOUBLE", lambda r: r.machine.analog_in[0]),
    "standard_analog_input1": Output("DOUBLE", lambda r: r.machine.analog_in[1]),
    "standard_analog_output0": Output("DOUBLE", lambda r: r.machine.analog_out[0]),
    "standard_analog_output1": Output("DOUBLE", lambda r: r.machine.analog_out[1]),
    "tcp_offset": Output(_VECTOR, lambda r: r.machine.tcp, (3, 0), (5, 0)),
    "payload": Output("DOUBLE", lambda r: r.machine.payload, (3, 11), (5, 6)),
    "payload_cog": Output("VECTOR3D", lambda r: r.machine.payload_cog, (3, 11), (5, 6)),
    "payload_inertia": Output(_VECTOR, lambda r: r.machine.payload_inertia, (3, 15), (5, 11)),
    "ft_raw_wrench": Output(_VECTOR, lambda r: r.reading.raw_wrench, None, (5, 9)),
    # DOUBLE, 1 stops the arm: RTDE guide; the first versions that have them were not found: assumed.
    "joint_position_deviation_ratio": Output(
        "DOUBLE", lambda r: r.safety.detection.deviation_ratio, None, RATIOS_SINCE
    ),
    "collision_detection_ratio": Output("DOUBLE", lambda r: r.safety.detection.collision_ratio, None, RATIOS_SINCE),
    "actual_qdd": Output(_VECTOR, lambda r: r.machine.qdd_target, None, (5, 23)),
    "output_bit_registers0_to_31": Output("UINT32", lambda r: _bits(r.registers.bool_out[:32])),
    "output_bit_registers32_to_63": Output("UINT32", lambda r: _bits(r.registers.bool_out[32:64])),
}


def _integer(i: int) -> Output:
    return Output("INT32", lambda r: r.registers.int_out[i])


def _double(i: int) -> Output:
    return Output("DOUBLE", lambda r: r.registers.float_out[i])


def _boolean(i: int) -> Output:
    return Output("BOOL", lambda r: r.registers.bool_out[i], (3, 9), (5, 3))


OUTPUTS |= {f"output_int_register_{i}": _integer(i) for i in range(REGISTERS)}
OUTPUTS |= {f"output_double_register_{i}": _double(i) for i in range(REGISTERS)}
OUTPUTS |= {f"output_bit_register_{i}": _boolean(i) for i in range(64, BIT_REGISTERS)}


class Outputs:
    """Output variables of one controller at its last tick; each is computed at most once per tick.

    Args:
        robot: The robot.

    Attributes:
        missing: Names of hidden variables; a fault.
        not_a_number: Ticks for which each of these variables reads NaN; a fault.
        frozen_timestamp: Reported timestamp [s]; None for the true one. A fault.
    """

    def __init__(self, robot: Robot) -> None:
        self.missing: set[str] = set()
        self.not_a_number: dict[str, int] = {}
        self.frozen_timestamp: float | None = None
        self._robot = robot
        self._cache: dict[str, tuple[float, ...]] = {}
        self._tick = -1

    def type_of(self, name: str) -> str:
        """RTDE's type of a variable, or NOT_FOUND."""
        output = OUTPUTS.get(name)
        if output is None or name in self.missing:
            return "NOT_FOUND"
        version = self._robot.identity.version[:2]
        first = output.e_series if version[0] > 3 else output.cb3
        return output.type_name if first is not None and version >= first else "NOT_FOUND"

    def values(self, names: Iterable[str]) -> list[float]:
        """The values of these variables, one after the other."""
        if self._tick != self._robot.ticks:
            self._tick = self._robot.ticks
            self._cache.clear()
            self._count_down()
        cache, found = self._cache, list[float]()
        for name in names:
            numbers = cache.get(name)
            if numbers is None:
                numbers = cache[name] = self._read(name)
            found.extend(numbers)
        return found

    def _read(self, name: str) -> tuple[float, ...]:
        if name == "timestamp" and self.frozen_timestamp is not None:
            return (self.frozen_timestamp,)
        output = OUTPUTS[name]
        if name in self.not_a_number and output.type_name in ("DOUBLE", "VECTOR3D", "VECTOR6D"):
            return (float("nan"),) * width(output.type_name)
        value = output.read(self._robot)
        return (value,) if isinstance(value, int | float) else tuple(value)

    def _count_down(self) -> None:
        if self.not_a_number:
            self.not_a_number = {name: left - 1 for name, left in self.not_a_number.items() if left > 1}

"""RTDE's input and output variables."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from toolee_robot.sim_backend.ur_controller.profile import RATIOS_SINCE
from toolee_robot.sim_backend.ur_controller.robot.registers import REGISTERS
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.server.rtde_types import width

INPUTS: dict[str, str] = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    "external_force_torque": "VECTOR6D",
    "input_bit_registers0_to_31": "UINT32",
    "input_bit_registers32_to_63": "UINT32",
    **{f"input_bit_register_{i}": "BOOL" for i in range(64, 128)},
    **{f"input_int_register_{i}": "INT32" for i in range(REGISTERS)},
    **{f"input_double_register_{i}": "DOUBLE" for i in range(REGISTERS)},
}
# mask variable -> value variable, first digital output
_DIGITAL = {
    "standard_digital_output_mask": ("standard_digital_output", 0),
    "configurable_digital_output_mask": ("configurable_digital_output", 8),
    "tool_digital_output_mask": ("tool_digital_output", 16),
}
_LAST_DIGITAL = 18


class Inputs:
    """Input variables of one controller.

    Args:
        robot: The robot.

    Attributes:
        catching_up: Whether the next tick is overdue because the computer was late. Streamed packets are then taken one
            per tick, as they would have arrived; all at once, a servoed path would have a step. When the ticks are on
            time again, the newest packet counts, as in a real controller; otherwise every later packet would be late.
        owners: The owner of each claimed variable, any hashable object.
        commands: Packets so far that wrote float registers, in which ur_rtde's commands have their numbers: the
            set-points of `servoj`, and the arguments of calls such as `set_payload`. A kick of the watchdog has none.
    """

    def __init__(self, robot: Robot) -> None:
        self.catching_up = False
        self.owners: dict[str, object] = {}
        self.commands = 0
        self._robot = robot

    def claim(self, name: str, owner: object) -> str:
        """Claim a variable.

        Args:
            name: Name of the variable.
            owner: The new owner.

        Returns:
            RTDE's type of the variable; NOT_FOUND or IN_USE if it cannot be claimed.
        """
        if name not in INPUTS:
            return "NOT_FOUND"
        if self.owners.setdefault(name, owner) is not owner:
            return "IN_USE"
        return INPUTS[name]

    def release(self, owner: object) -> None:
        """Release all variables of `owner`."""
        self.owners = {name: other for name, other in self.owners.items() if other is not owner}

    def write(self, names: Sequence[str], numbers: Sequence[float]) -> None:
        """Write a data packet, which has its effect from the next tick on.

        Numbers that are not finite are written to the registers unchanged, as a real controller does.

        Args:
            names: Names of the variables.
            numbers: Their values, those of vectors one after the other.
        """
        robot, at = self._robot, 0
        registers, by_name = robot.registers, dict[str, float]()
        for name in names:
            if name.startswith("input_int_register_"):
                registers.int_in[int(name[19:])] = int(numbers[at])
            elif name.startswith("input_double_register_"):
                registers.float_in[int(name[22:])] = float(numbers[at])
            elif name == "external_force_torque":
                registers.external_force_torque = [float(number) for number in numbers[at : at + 6]]
                at += 5
            elif name.startswith("input_bit_registers"):
                first = 0 if name.endswith("_31") else 32
                registers.bool_in[first : first + 32] = [bool(int(numbers[at]) >> bit & 1) for bit in range(32)]
            elif name.startswith("input_bit_register_"):
                registers.bool_in[int(name[19:])] = bool(numbers[at])
            else:
                by_name[name] = numbers[at]
            at += 1
            robot.machine.fed(name)
        self.commands += any(name.startswith("input_double_register_") for name in names)
        if by_name:
            self._apply(by_name)

    def _apply(self, written: dict[str, float]) -> None:
        machine = self._robot.machine
        fraction = written.get("speed_slider_fraction", math.nan)
        if written.get("speed_slider_mask") and math.isfinite(fraction):
            machine.speed_fraction = min(1.0, max(0.0, fraction))
        for mask_name, (value_name, first) in _DIGITAL.items():
            mask, value = int(written.get(mask_name, 0)), int(written.get(value_name, 0))
            for bit in range(min(8, _LAST_DIGITAL - first)):
                if mask >> bit & 1:
                    machine.digital_out[first + bit] = bool(value >> bit & 1)
        mask = int(written.get("standard_analog_output_mask", 0))
        for channel in range(2):
            level = written.get(f"standard_analog_output_{channel}", math.nan)
            if mask >> channel & 1 and math.isfinite(level):
                machine.analog_out[channel] = min(1.0, max(0.0, level))


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

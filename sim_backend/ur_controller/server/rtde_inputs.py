"""RTDE input variables: names, types, effects of a write, and ownership."""

from __future__ import annotations

import math
from collections.abc import Sequence

from toolee_robot.sim_backend.ur_controller.robot.registers import REGISTERS
from toolee_robot.sim_backend.ur_controller.robot_system import Robot

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

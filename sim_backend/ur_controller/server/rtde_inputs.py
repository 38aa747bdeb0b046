"""What RTDE clients can write: names, types, what a write does, and who owns which variable."""

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
    """Input variables of one controller. owners: variable -> who has claimed it; any hashable object is an owner.

    catching_up: the next tick is overdue, since the computer was late. What a client streamed meanwhile is then taken
    one packet a tick, as it would have come: all at once, a servo's path would have a step. With the ticks on time
    again the newest counts, as in a real controller: what was still left would make every later packet late.
    """

    def __init__(self, robot: Robot) -> None:
        self.catching_up = False
        self.owners: dict[str, object] = {}
        self._robot = robot

    def claim(self, name: str, owner: object) -> str:
        """RTDE's type of the variable, which now belongs to `owner`; NOT_FOUND or IN_USE if it cannot."""
        if name not in INPUTS:
            return "NOT_FOUND"
        if self.owners.setdefault(name, owner) is not owner:
            return "IN_USE"
        return INPUTS[name]

    def release(self, owner: object) -> None:
        """Free all that `owner` has claimed."""
        self.owners = {name: other for name, other in self.owners.items() if other is not owner}

    def write(self, names: Sequence[str], numbers: Sequence[float]) -> None:
        """Take over a data packet: seen by the script and the outputs from the next tick on. Numbers that are not
        finite reach the registers as they are, since a controller does not check them either."""
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

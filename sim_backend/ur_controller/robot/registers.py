"""The controller's general purpose registers, shared by the script and the RTDE clients."""

from __future__ import annotations

REGISTERS = 48


class Registers:
    """The registers; RTDE clients write the inputs, the script writes the outputs.

    Attributes:
        bool_in: 128 boolean inputs.
        bool_out: 128 boolean outputs.
        int_in: 48 integer inputs.
        int_out: 48 integer outputs.
        float_in: 48 floating-point inputs.
        float_out: 48 floating-point outputs.
        external_force_torque: Wrench of an external sensor, six values [N, Nm].
    """

    def __init__(self) -> None:
        self.bool_in, self.bool_out = [False] * 128, [False] * 128
        self.int_in, self.int_out = [0] * REGISTERS, [0] * REGISTERS
        self.float_in, self.float_out = [0.0] * REGISTERS, [0.0] * REGISTERS
        self.external_force_torque = [0.0] * 6

"""The controller's general purpose registers, which the script and the RTDE clients share."""

from __future__ import annotations

REGISTERS = 48


class Registers:
    """Inputs are written by RTDE clients, outputs by the script; 128 booleans, 48 integers and 48 doubles each way."""

    def __init__(self) -> None:
        self.bool_in, self.bool_out = [False] * 128, [False] * 128
        self.int_in, self.int_out = [0] * REGISTERS, [0] * REGISTERS
        self.float_in, self.float_out = [0.0] * REGISTERS, [0.0] * REGISTERS
        self.external_force_torque = [0.0] * 6

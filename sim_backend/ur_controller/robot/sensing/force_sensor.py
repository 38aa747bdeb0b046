"""The wrench that the controller reports: measured, or given by a client, less the script's zero."""

from __future__ import annotations

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.robot.registers import Registers
from toolee_robot.sim_backend.ur_controller.robot.sensing.sensors import Sensors


class ForceSensor:
    """Wrench of the environment at the flange's origin.

    Args:
        sensors: The sensors of the arm.
        registers: General purpose registers.
        zeroed: Whether the controller can zero it.

    Attributes:
        external: Whether the wrench comes from RTDE's external_force_torque.
    """

    def __init__(self, sensors: Sensors, registers: Registers, zeroed: bool) -> None:
        self.external = False
        self._sensors, self._registers, self._zeroed = sensors, registers, zeroed
        self._bias = np.zeros(6)  # flange axes

    def wrench(self, R: Array) -> Array:
        """The wrench.

        Args:
            R: Orientation of the flange in the base, (3, 3).

        Returns:
            Force and torque, (6,) [N, Nm], base axes.
        """
        return self._felt(R) - _turned(R, self._bias)

    def push(self, R: Array) -> Array:
        """What moves the arm in freedrive: the client's wrench where there is one, else `Sensors.push`; as `wrench`."""
        return self._felt(R) if self.external else self._sensors.push

    def zero(self, R: Array) -> None:
        """Take the present wrench for zero, free of its noise, as a mean would; `R` as for `wrench`."""
        if self._zeroed:
            self._bias = _turned(R.T, self._felt(R) - self._sensors.fluctuation)

    def _felt(self, R: Array) -> Array:
        if self.external:
            return _turned(R, np.array(self._registers.external_force_torque))
        return self._sensors.wrench


def _turned(R: Array, wrench: Array) -> Array:
    return np.concatenate([R @ wrench[:3], R @ wrench[3:]])

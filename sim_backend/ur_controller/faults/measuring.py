"""Faults of following and measuring: lag, noise, an unknown payload, digital inputs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from toolee_robot.errors import UserError
from toolee_robot.sim_backend.ur_controller.faults.hooks import HookGroup, Three, hook
from toolee_robot.sim_backend.ur_controller.profile import EncoderNoise, ForceErrors, ServoLag, usual_lag
from toolee_robot.sim_backend.ur_controller.robot.sensors import PayloadError

if TYPE_CHECKING:
    from toolee_robot.sim_backend.ur_controller.controller import Controller

Small = Annotated[float, Field(ge=0.0, le=1e3, allow_inf_nan=False)]


class MeasuringFaults(HookGroup):
    """Hooks for faults of what the controller follows and measures.

    Args:
        controller: The controller.
    """

    def __init__(self, controller: Controller) -> None:
        self._robot = controller.robot
        self._stuck: set[int] = set()  # digital inputs

    def end(self) -> None:
        """End all faults of the group; inputs are low."""
        machine = self._robot.machine
        machine.servo_lag = machine.profile.servo
        machine.sensors.set_noise(machine.model, None, None)
        machine.sensors.payload_error = PayloadError()
        self._stuck.clear()
        machine.digital_in[:] = [False] * len(machine.digital_in)

    @hook
    def lag(self, seconds: Small) -> None:
        """Delay each `servoj` by so much more than the profile does; 0 ends it.

        Args:
            seconds: Additional dead time [s]; on an ideal controller beside the lag of the model's generation.
        """
        machine = self._robot.machine
        servo: ServoLag | None = machine.profile.servo
        if seconds > 0.0:
            usual = servo or usual_lag(machine.model.e_series)
            servo = replace(usual, dead_time=usual.dead_time + seconds)
        machine.servo_lag = servo

    @hook
    def noise(
        self, position: Small = 0.0, velocity: Small = 0.0, force: Small = 0.0, torque: Small = 0.0, offset: Small = 0.0
    ) -> None:
        """Set the noise of the sensors; all zero for the profile's own.

        Args:
            position: Standard deviation of the joint positions [rad].
            velocity: Standard deviation of the joint velocities [rad/s].
            force: Standard deviation of the forces, per axis [N].
            torque: Standard deviation of the torques, per axis [Nm].
            offset: Norm of the force's offset [N].
        """
        machine = self._robot.machine
        own = not any((position, velocity, force, torque, offset))
        errors = replace(machine.profile.force, noise=(force, torque), offset=(offset, machine.profile.force.offset[1]))
        encoders: EncoderNoise | None = None if own else EncoderNoise(position, velocity)
        wrench: ForceErrors | None = None if own else errors
        machine.sensors.set_noise(machine.model, encoders, wrench)

    @hook
    def payload_error(self, mass: Annotated[float, Field(ge=-50.0, le=50.0)], cog: Three) -> None:
        """Hang a mass on the flange of which the controller does not know; 0 ends it.

        Args:
            mass: Mass [kg]; negative where the arm carries less than the controller takes for granted.
            cog: Centre of gravity, flange frame, (3,) [m].
        """
        self._robot.machine.sensors.payload_error = PayloadError(mass, np.array(cog))

    @hook
    def digital_input(self, index: int, high: bool) -> None:
        """Set a digital input, as what is wired to it does; a stuck one stays as it is.

        Args:
            index: Its number, 0 to 17, as RTDE's actual_digital_input_bits counts them.
            high: Whether it is high.
        """
        self._check(index)
        if index not in self._stuck:
            self._robot.machine.digital_in[index] = high

    @hook
    def stuck_input(self, index: int, stuck: bool = True) -> None:
        """Let a digital input stay as it is, whatever is wired to it does, or end that.

        Args:
            index: Its number, 0 to 17.
            stuck: Whether it is stuck.
        """
        self._check(index)
        if stuck:
            self._stuck.add(index)
        else:
            self._stuck.discard(index)

    @hook
    def door(self, opened: bool, index: int) -> None:
        """Open or close a door that is wired to the safeguard and to a digital input, which is high while it is closed.

        A stuck input affects what programs read and not the safeguard, whose inputs are safety inputs of their own.

        Args:
            opened: Whether the door is open.
            index: Number of the digital input.
        """
        self.digital_input(index, not opened)
        if opened:
            self._robot.safety.safeguard_stop()
        else:
            self._robot.safety.release_safeguard_stop()

    def _check(self, index: int) -> None:
        inputs = len(self._robot.machine.digital_in)
        if not 0 <= index < inputs:
            raise UserError(f"digital inputs are 0 to {inputs - 1}, not {index}", code="user.digital_input")

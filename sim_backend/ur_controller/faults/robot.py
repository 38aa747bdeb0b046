"""Faults of the robot: program, safety system, arm, identity, following and measuring."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from toolee_robot.errors import UserError
from toolee_robot.sim_backend.ur_controller.faults.network import (
    Count,
    HookGroup,
    NetworkFaults,
    Seconds,
    Six,
    Three,
    hook,
)
from toolee_robot.sim_backend.ur_controller.profile import EncoderNoise, ForceErrors, ServoLag, usual_lag
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import UPRIGHT
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.sim_backend.ur_controller.robot.safety_system import UNLOCK_DELAY, RobotMode
from toolee_robot.sim_backend.ur_controller.robot.sensors import PayloadError
from toolee_robot.sim_backend.ur_controller.robot_system import Identity

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
            raise UserError(f"digital inputs are 0 to {inputs - 1}, not {index}")


class RobotFaults(HookGroup):
    """Hooks for faults of the robot.

    Args:
        controller: The controller.
        network: Network faults, for reboots.
    """

    def __init__(self, controller: Controller, network: NetworkFaults) -> None:
        self._controller, self._network, self._clock = controller, network, controller.clock
        self._robot = controller.robot
        self._force_until = np.inf
        self._boot_until: float | None = None
        self._power_after_boot = False

    def step(self) -> None:
        """End an external force or a reboot whose time is over."""
        now = self._clock.now()
        if now >= self._force_until:
            self._robot.plant.external_force = np.zeros(6)
            self._force_until = np.inf
        if self._boot_until is not None and now >= self._boot_until:
            self._boot_until = None
            self._robot.safety.robot_mode = RobotMode.RUNNING if self._power_after_boot else RobotMode.POWER_OFF
            self._network.up()

    def end(self) -> None:
        """End all faults of the robot and restore its initial state."""
        options, robot = self._controller.options, self._robot
        robot.program.stop()
        robot.program.rejections, robot.program.start_delay = 0, 0.0
        robot.plant.external_force = np.zeros(6)
        self._force_until, self._boot_until = np.inf, None
        robot.joint_offset = np.zeros(6)
        nominal = MODELS[options.model]
        robot.identity = Identity.of(nominal, robot.machine.profile)
        robot.calibrate(nominal)
        robot.machine.speed_fraction, robot.machine.speed_scaling = options.speed_slider, 1.0
        robot.machine.felt_gravity = UPRIGHT.copy()
        own = robot.machine.profile.safeguard_resumes
        robot.safety.safeguard_resumes = own if options.safeguard_resumes is None else options.safeguard_resumes
        robot.safety.remote = options.remote
        robot.safety.restore()

    # -- the program

    @hook
    def reject_script(self, count: Count = 1) -> None:
        """Discard the next scripts that are uploaded."""
        self._robot.program.rejections = count

    @hook
    def slow_start(self, seconds: Seconds) -> None:
        """Delay the start of scripts after their upload by a time [s]; 0 ends the fault."""
        self._robot.program.start_delay = seconds

    @hook
    def pause(self) -> None:
        """Pause the program as at the pendant."""
        self._robot.program.pause()

    @hook
    def play(self) -> dict[str, bool]:
        """Press Play at the pendant; answers whether a paused program was resumed."""
        return {"resumed": self._robot.program.resume()}

    # -- safety

    @hook
    def protective_stop(self, reason: str = "fault port") -> None:
        """Make a protective stop."""
        self._robot.safety.protective_stop(reason)

    @hook
    def unlock(self) -> None:
        """Release a protective stop as at the pendant, without the waiting time of 5 s."""
        self._robot.safety.age(UNLOCK_DELAY)
        self._robot.safety.unlock()

    @hook
    def emergency_stop(self, pressed: bool = True, system: bool = False) -> None:
        """Press the emergency stop, or release it; the arm is then off until powered on.

        Args:
            pressed: Whether to press or to release it.
            system: Whether it is the system's emergency stop instead of the robot's.
        """
        if pressed:
            self._robot.safety.emergency_stop(system)
        else:
            self._robot.safety.release_emergency_stop()

    @hook
    def safeguard_stop(self, active: bool = True) -> None:
        """Open the safeguard, or close it; a paused program stays paused, unless the controller resumes it."""
        if active:
            self._robot.safety.safeguard_stop()
        else:
            self._robot.safety.release_safeguard_stop()

    @hook
    def safety_fault(self, violation: bool = False) -> None:
        """Enter the safety mode FAULT or VIOLATION, which the dashboard's `restart safety` ends."""
        self._robot.safety.fault(violation)

    @hook
    def remote(self, remote: bool) -> None:
        """Switch an e-Series controller to remote or local control."""
        self._robot.safety.remote = remote

    # -- the arm

    @hook
    def force(self, wrench: Six, seconds: Seconds | None = None) -> None:
        """Apply a wrench to the flange.

        Args:
            wrench: Force [N] and torque [Nm], base axes, (6,).
            seconds: Duration [s]; None: until the next one.
        """
        self._robot.plant.external_force = np.array(wrench)
        self._force_until = np.inf if seconds is None else self._clock.now() + seconds

    @hook
    def joint_offset(self, offset: Six) -> None:
        """Add an offset (6,) [rad] to the measured joint positions: a tracking error."""
        self._robot.joint_offset = np.array(offset)

    @hook
    def payload(self, mass: Annotated[float, Field(ge=0.0, le=50.0)], cog: Three) -> None:
        """Set another payload as at the pendant.

        Args:
            mass: Mass [kg].
            cog: Centre of gravity, flange frame, (3,) [m].
        """
        machine = self._robot.machine
        machine.payload, machine.payload_cog = mass, np.array(cog)
        machine.plant.set_payload(mass, np.array(cog))

    @hook
    def tcp(self, pose: Six) -> None:
        """Set another TCP as at the pendant: position [m], rotation vector [rad]."""
        self._robot.machine.tcp = np.array(pose)

    @hook
    def mounting(self, up: Three) -> None:
        """Let the base stand otherwise than the installation says, which the tool's accelerometer feels.

        Args:
            up: Straight up, in the controller's base, (3,) [m/s^2]: 9.82 long on earth.
        """
        self._robot.machine.felt_gravity = np.array(up)

    @hook
    def speed_slider(self, fraction: Annotated[float, Field(ge=0.0, le=1.0)]) -> None:
        """Move the speed slider, 0 to 1."""
        self._robot.machine.speed_fraction = fraction

    @hook
    def speed_scaling(self, fraction: Annotated[float, Field(ge=0.0, le=1.0)]) -> None:
        """Slow motions down as the controller's own limiter does, to a fraction of the commanded speed."""
        self._robot.machine.speed_scaling = fraction

    # -- identity

    @hook
    def version(
        self, version: Annotated[list[Annotated[int, Field(ge=0, lt=2**31)]], Field(min_length=4, max_length=4)]
    ) -> None:
        """Report another software version; the behaviour stays."""
        major, minor, bugfix, build = version
        self._robot.identity.version = (major, minor, bugfix, build)

    @hook
    def model(self, name: str) -> None:
        """Report another model on the dashboard."""
        self._robot.identity.model = name

    @hook
    def serial(self, number: str) -> None:
        """Report another serial number on the dashboard."""
        self._robot.identity.serial = number

    @hook
    def kinematics(self, a: Six, d: Six) -> None:
        """Change the arm's DH parameters.

        They apply to the reported kinematics, with another checksum, and to the arm's motions.

        Args:
            a: Differences from the nominal a, (6,) [m].
            d: Differences from the nominal d, (6,) [m].
        """
        nominal = MODELS[self._controller.options.model]
        self._robot.calibrate(
            replace(
                nominal,
                a=tuple(x + dx for x, dx in zip(nominal.a, a, strict=True)),
                d=tuple(x + dx for x, dx in zip(nominal.d, d, strict=True)),
            )
        )

    @hook
    def reboot(self, seconds: Seconds = 1.0, powered: bool = False) -> None:
        """Restart the controller.

        Connections are reset, program and registers are lost.

        Args:
            seconds: Time for which the ports are closed [s].
            powered: Whether the arm is powered on afterwards.
        """
        self._network.down()
        self._robot.reboot()
        self._robot.safety.robot_mode = RobotMode.BOOTING
        self._boot_until, self._power_after_boot = self._clock.now() + seconds, powered

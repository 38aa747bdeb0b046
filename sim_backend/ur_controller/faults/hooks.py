"""The hooks of the fault port: faults of the network, of the robot and of what it measures, and what it is asked."""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field, ValidationError, validate_call

from toolee_robot.errors import TooleeError, UserError
from toolee_robot.sim_backend.ur_controller.profile import EncoderNoise, ForceErrors, ServoLag, usual_lag
from toolee_robot.sim_backend.ur_controller.robot.collision_detection import UPRIGHT
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.sim_backend.ur_controller.robot.safety_system import UNLOCK_DELAY, RobotMode, SafetyMode
from toolee_robot.sim_backend.ur_controller.robot.sensors import PayloadError
from toolee_robot.sim_backend.ur_controller.robot_system import Identity
from toolee_robot.sim_backend.ur_controller.server.port import Connection, LinkFaults
from toolee_robot.sim_backend.ur_controller.server.rtde import RtdeSession
from toolee_robot.sim_backend.ur_controller.server.rtde_variables import INPUTS, OUTPUTS

if TYPE_CHECKING:
    from toolee_robot.sim_backend.ur_controller.controller import Controller
    from toolee_robot.sim_backend.ur_controller.server.port import Port

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Small = Annotated[float, Field(ge=0.0, le=1e3, allow_inf_nan=False)]
Seconds = Annotated[float, Field(ge=0.0, le=3600.0)]
Count = Annotated[int, Field(ge=0)]
Three = Annotated[list[Number], Field(min_length=3, max_length=3)]
Six = Annotated[list[Number], Field(min_length=6, max_length=6)]
Method = Callable[..., dict[str, Any] | None]
TRACE_PAGE = 250  # rows in one answer: more would delay the tick
_HOOKS: dict[str, Method] = {}


def hook(method: Method) -> Method:
    """Decorator that makes a method of `Faults` a hook: its arguments are a request's keys, and are checked."""
    checked: Method = validate_call(config=ConfigDict(arbitrary_types_allowed=True))(method)
    _HOOKS[method.__name__] = checked
    return checked


class Faults:
    """All hooks of a controller.

    Ports are named "rtde", "dashboard", "primary", "secondary", "realtime", or "all".

    Args:
        controller: The controller.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller, self._clock, self._robot = controller, controller.clock, controller.robot
        self._reopen: dict[str, float] = {}  # port -> time [s]
        self._elsewhere = object()  # owner of the variables that `own` claims
        self._stuck: set[int] = set()  # digital inputs
        self._force_until, self._boot_until = np.inf, np.inf
        self._power_after_boot = False

    def do(self, request: object) -> dict[str, Any]:
        """Execute one request; never raises.

        Args:
            request: The decoded JSON object.

        Returns:
            The answer, a JSON object.
        """
        if not isinstance(request, dict) or not isinstance(name := request.get("fault"), str):
            return {"ok": False, "error": 'a request is {"fault": NAME, ...}'}
        if (method := _HOOKS.get(name)) is None:
            return {"ok": False, "error": f"no fault {name!r}: choose one of {', '.join(sorted(_HOOKS))}"}
        arguments = {str(key): value for key, value in request.items() if key != "fault"}
        try:
            inspect.signature(method).bind(self, **arguments)
            return {"ok": True, **(method(self, **arguments) or {})}
        except ValidationError as error:
            first = error.errors()[0]
            return {"ok": False, "error": f"{name}: {'.'.join(str(part) for part in first['loc'])}: {first['msg']}"}
        except (TypeError, TooleeError) as error:
            return {"ok": False, "error": f"{name}: {error}"}

    def step(self) -> None:
        """End the faults whose duration is over."""
        now = self._clock.now()
        for name in [name for name, due in self._reopen.items() if now >= due]:
            del self._reopen[name]
            self._controller.ports[name].listen()
        if now >= self._force_until:
            self._robot.plant.external_force = np.zeros(6)
            self._force_until = np.inf
        if now >= self._boot_until:
            self._boot_until = np.inf
            self._robot.safety.robot_mode = RobotMode.RUNNING if self._power_after_boot else RobotMode.POWER_OFF
            self._listen()

    @hook
    def reset(self) -> None:
        """End all faults and restore the robot's initial state: running, no program, normal safety mode.

        Inputs are low. Joints, registers and connections stay as they are; those that are half open are reset.
        """
        self._reset_robot()
        controller, machine = self._controller, self._robot.machine
        machine.servo_lag = machine.profile.servo
        machine.sensors.set_noise(machine.model, None, None)
        machine.sensors.payload_error = PayloadError()
        self._stuck.clear()
        machine.digital_in[:] = [False] * len(machine.digital_in)
        controller.outputs.missing.clear()
        controller.outputs.not_a_number.clear()
        controller.outputs.frozen_timestamp = None
        controller.inputs.release(self._elsewhere)
        controller.rtde_faults.drop_after = None
        controller.frozen_until = 0.0
        self._reopen.clear()
        for port in controller.ports.values():
            port.faults.__dict__.update(LinkFaults().__dict__)
        self._listen()
        for connection in self._connections("all"):
            if connection.half_open:
                connection.close(reset=True)

    def _reset_robot(self) -> None:
        options, robot = self._controller.options, self._robot
        robot.program.stop()
        robot.program.rejections, robot.program.start_delay = 0, 0.0
        robot.plant.external_force = np.zeros(6)
        self._force_until, self._boot_until = np.inf, np.inf
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

    def _listen(self) -> None:
        for port in self._controller.ports.values():
            port.listen()

    def _ports(self, name: str) -> list[Port]:
        ports = self._controller.ports
        if name == "all":
            return list(ports.values())
        if name not in ports:
            raise UserError(f"no port {name!r}: choose one of all, {', '.join(ports)}")
        return [ports[name]]

    def _connections(self, name: str) -> list[Connection]:
        return [connection for port in self._ports(name) for connection, _ in port.clients]

    # -- the network

    @hook
    def drop(self, port: str = "all", reset: bool = False) -> None:
        """Close connections.

        Args:
            port: Name of the port, or "all".
            reset: Whether to close them with RST instead of FIN.
        """
        for found in self._ports(port):
            found.drop(reset)

    @hook
    def refuse(self, port: str = "all", seconds: Seconds | None = None) -> None:
        """Refuse new connections; open ones stay.

        Args:
            port: Name of the port, or "all".
            seconds: Duration [s]; None: until `accept`.
        """
        for found in self._ports(port):
            found.refuse()
            self._reopen.pop(found.name, None)
            if seconds is not None:
                self._reopen[found.name] = self._clock.now() + seconds

    @hook
    def accept(self, port: str = "all") -> None:
        """Accept new connections again."""
        for found in self._ports(port):
            self._reopen.pop(found.name, None)
            found.listen()

    @hook
    def stall(self, seconds: Seconds, port: str = "all") -> None:
        """Block the network; afterwards everything arrives in one burst.

        Args:
            seconds: Duration [s].
            port: Name of the port, or "all".
        """
        for found in self._ports(port):
            found.faults.stalled_until = time.monotonic() + self._clock.to_wall_time(seconds)

    @hook
    def freeze(self, seconds: Seconds) -> None:
        """Stop the controller's loop for a time [s]: no ticks, no answers, no motion."""
        self._controller.frozen_until = self._clock.now() + seconds

    @hook
    def delay(self, seconds: Seconds, port: str = "all") -> None:
        """Delay everything that is sent.

        Args:
            seconds: The delay [s]; 0 ends the fault.
            port: Name of the port, or "all".
        """
        for found in self._ports(port):
            found.faults.delay = self._clock.to_wall_time(seconds)

    @hook
    def half_open(self, port: str = "all") -> None:
        """Make the open connections dead without closing them: nothing is read or sent."""
        for connection in self._connections(port):
            connection.half_open = True

    @hook
    def truncate(self, bytes: Count, port: str = "rtde") -> None:
        """Truncate what is sent next.

        Args:
            bytes: Number of bytes that remain.
            port: Name of the port, or "all".
        """
        for found in self._ports(port):
            found.faults.truncate = bytes

    @hook
    def coalesce(self, sends: Annotated[int, Field(ge=1, le=1000)], port: str = "rtde") -> None:
        """Combine several sends into one.

        Args:
            sends: How many; 1 ends the fault.
            port: Name of the port, or "all".
        """
        for found in self._ports(port):
            found.faults.coalesce = sends

    # -- the RTDE server

    @hook
    def skip(self, packets: Count) -> None:
        """Omit the next data packets to each client."""
        for _, session in self._controller.ports["rtde"].clients:
            if isinstance(session, RtdeSession):
                session.skip(packets)

    @hook
    def handshake_drop(self, packets: Annotated[int, Field(ge=1)], reset: bool = False) -> None:
        """Drop the next client in its handshake.

        Args:
            packets: Number of packets that it may send before.
            reset: Whether to close the connection with RST instead of FIN.
        """
        self._controller.rtde_faults.drop_after, self._controller.rtde_faults.reset = packets, reset

    @hook
    def own(self, variables: list[str]) -> None:
        """Claim input variables, so that clients that request them get IN_USE.

        Raises:
            UserError: There is no such input variable.
        """
        for name in variables:
            if name not in INPUTS:
                raise UserError(f"no input variable {name!r}")
            self._controller.inputs.owners[name] = self._elsewhere

    @hook
    def missing(self, variables: list[str]) -> None:
        """Hide output variables, so that clients that request them get NOT_FOUND."""
        self._controller.outputs.missing.update(_known(variables))

    @hook
    def nan(self, variables: list[str], ticks: Count = 1) -> None:
        """Report NaN.

        Args:
            variables: Output variables of doubles.
            ticks: Number of ticks.
        """
        self._controller.outputs.not_a_number.update(dict.fromkeys(_known(variables), ticks + 1))

    @hook
    def freeze_timestamp(self, frozen: bool = True) -> None:
        """Freeze the timestamp of the data, which continue to be sent."""
        self._controller.outputs.frozen_timestamp = self._controller.robot.timestamp if frozen else None

    # -- what the controller follows and measures

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

    # -- the robot

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
        self._robot.machine.set_payload(mass, cog)

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
        for port in self._controller.ports.values():
            port.refuse()
            port.drop(reset=True)
        self._reopen.clear()
        self._robot.reboot()
        self._robot.safety.robot_mode = RobotMode.BOOTING
        self._boot_until, self._power_after_boot = self._clock.now() + seconds, powered

    # -- questions

    @hook
    def state(self) -> dict[str, Any]:
        """Return the true state of the robot: joints, modes, program, settings, tick statistics, clients."""
        return _state(self._controller)

    @hook
    def registers(self) -> dict[str, Any]:
        """Return all general purpose registers."""
        registers = self._controller.robot.registers
        names = ("int_in", "float_in", "bool_in", "int_out", "float_out", "bool_out")
        return {name: list(getattr(registers, name)) for name in names}

    @hook
    def trace(self, after: int = -1) -> dict[str, Any]:
        """Return the ticks after number `after`, the oldest first, at most TRACE_PAGE; continue after the last one."""
        trace = self._controller.trace
        first = trace[0].tick if trace else 0
        start = max(0, after + 1 - first)
        rows = [trace[i] for i in range(start, min(len(trace), start + TRACE_PAGE))]
        return {
            "columns": ["tick", "stamp", "safety", "program", "q", "qd", "q_target", "commands"],
            "rows": [
                [r.tick, r.stamp, r.safety, r.program, r.q.tolist(), r.qd.tolist(), r.q_target.tolist(), r.commands]
                for r in rows
            ],
        }

    @hook
    def reset_statistics(self) -> None:
        """Reset the statistics of late and slipped ticks."""
        self._controller.schedule.reset()


def _known(variables: list[str]) -> list[str]:
    for name in variables:
        if name not in OUTPUTS:
            raise UserError(f"no output variable {name!r}")
    return variables


def _state(controller: Controller) -> dict[str, Any]:
    """The answer of the `state` hook."""
    robot = controller.robot
    machine, safety, program, statistics = robot.machine, robot.safety, robot.program, controller.schedule.statistics
    return {
        "model": robot.model.name,
        "profile": machine.profile.name,
        "timestamp": robot.timestamp,
        "stamp": controller.clock.now(),
        "tick": robot.ticks,
        "q": robot.plant.q.tolist(),
        "qd": robot.plant.qd.tolist(),
        "q_target": machine.q_target.tolist(),
        "qd_target": machine.qd_target.tolist(),
        "tcp_pose": robot.reading.tcp_pose,
        "tcp_force": robot.reading.tcp_force.tolist(),
        "moving": machine.moving,
        "robot_mode": RobotMode(safety.robot_mode).name,
        "safety_mode": SafetyMode(safety.mode).name,
        "safety_reason": safety.reason,
        "deviation_ratio": safety.detection.deviation_ratio,
        "collision_ratio": safety.detection.collision_ratio,
        "remote": safety.remote,
        "program_state": program.state.name,
        "program_name": program.name,
        "program_error": program.last_error,
        "uploads": program.uploads,
        "payload": machine.payload,
        "payload_cog": list(machine.payload_cog),
        "tcp": list(machine.tcp),
        "speed_slider": machine.speed_fraction,
        "popup": robot.popup,
        "messages": [str(said) for _, said in list(robot.messages)[-10:]],
        "clients": {name: len(port.clients) for name, port in controller.ports.items()},
        "ticks": {
            "done": statistics.ticks,
            "late": statistics.late,
            "slipped": statistics.slipped,
            "worst_late": statistics.worst_late,
            "mean_work": statistics.busy / max(1, statistics.ticks),
        },
    }

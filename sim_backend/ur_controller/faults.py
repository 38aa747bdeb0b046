"""The fault port: one JSON object per line in, one per line out. Every hook, and what tests want to know.

{"fault": "drop", "port": "rtde", "reset": true} -> {"ok": true}; a mistake -> {"ok": false, "error": "..."}.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field, ValidationError, validate_call

from toolee_robot.errors import TooleeError, UserError
from toolee_robot.sim_backend.ur_controller.describe import describe
from toolee_robot.sim_backend.ur_controller.link import Connection, LinkFaults
from toolee_robot.sim_backend.ur_controller.model import MODELS
from toolee_robot.sim_backend.ur_controller.robot import Identity
from toolee_robot.sim_backend.ur_controller.rtde import RtdeSession
from toolee_robot.sim_backend.ur_controller.rtde_inputs import INPUTS
from toolee_robot.sim_backend.ur_controller.rtde_variables import OUTPUTS
from toolee_robot.sim_backend.ur_controller.safety import UNLOCK_DELAY, RobotMode

if TYPE_CHECKING:
    from toolee_robot.sim_backend.ur_controller.controller import Controller
    from toolee_robot.sim_backend.ur_controller.port import Port

TRACE_PAGE = 250  # rows in one answer: more would hold up the tick

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Seconds = Annotated[float, Field(ge=0.0, le=3600.0)]
Count = Annotated[int, Field(ge=0)]
Three = Annotated[list[Number], Field(min_length=3, max_length=3)]
Six = Annotated[list[Number], Field(min_length=6, max_length=6)]
Hook = Callable[..., dict[str, Any] | None]
_HOOKS: dict[str, Hook] = {}


def _hook(method: Hook) -> Hook:
    checked: Hook = validate_call(config=ConfigDict(arbitrary_types_allowed=True))(method)
    _HOOKS[method.__name__] = checked
    return checked


class Faults:
    """What can be done to a controller from outside. Each hook is a method; its arguments are the request's keys.

    Ports are named "rtde", "dashboard", "primary", "secondary", "realtime", or "all".
    """

    def __init__(self, controller: Controller) -> None:
        self._controller, self._clock = controller, controller.clock
        self._robot = controller.robot
        self._elsewhere = object()  # owner of the registers that are "in use"
        self._reopen: dict[str, float] = {}  # port -> time [s]
        self._force_until = np.inf
        self._boot_until: float | None = None
        self._power_after_boot = False

    def do(self, request: object) -> dict[str, Any]:
        """Carry out one request; never raises."""
        if not isinstance(request, dict) or not isinstance(name := request.get("fault"), str):
            return {"ok": False, "error": 'a request is {"fault": NAME, ...}'}
        if (hook := _HOOKS.get(name)) is None:
            return {"ok": False, "error": f"no fault {name!r}: choose one of {', '.join(sorted(_HOOKS))}"}
        arguments = {str(key): value for key, value in request.items() if key != "fault"}
        try:
            inspect.signature(hook).bind(self, **arguments)
            return {"ok": True, **(hook(self, **arguments) or {})}
        except ValidationError as error:
            first = error.errors()[0]
            return {"ok": False, "error": f"{name}: {'.'.join(str(part) for part in first['loc'])}: {first['msg']}"}
        except (TypeError, TooleeError) as error:
            return {"ok": False, "error": f"{name}: {error}"}

    def step(self) -> None:
        """What is over by now: a refused port opens again, a force goes away, a reboot is done."""
        now = self._clock.now()
        for name in [name for name, due in self._reopen.items() if now >= due]:
            del self._reopen[name]
            self._controller.ports[name].listen()
        if now >= self._force_until:
            self._robot.plant.external_force = np.zeros(6)
            self._force_until = np.inf
        if self._boot_until is not None and now >= self._boot_until:
            self._boot_until = None
            self._robot.safety.robot_mode = RobotMode.RUNNING if self._power_after_boot else RobotMode.POWER_OFF
            for port in self._controller.ports.values():
                port.listen()

    # -- the network

    @_hook
    def drop(self, port: str = "all", reset: bool = False) -> None:
        """Close the connections, with FIN or, if reset, RST."""
        for found in self._ports(port):
            found.drop(reset)

    @_hook
    def refuse(self, port: str = "all", seconds: Seconds | None = None) -> None:
        """Refuse new connections, for so long or until `accept`; open ones stay."""
        for found in self._ports(port):
            found.refuse()
            self._reopen.pop(found.name, None)
            if seconds is not None:
                self._reopen[found.name] = self._clock.now() + seconds

    @_hook
    def accept(self, port: str = "all") -> None:
        """Accept new connections again."""
        for found in self._ports(port):
            self._reopen.pop(found.name, None)
            found.listen()

    @_hook
    def stall(self, seconds: Seconds, port: str = "all") -> None:
        """The network is stuck: nothing goes in or out; afterwards everything arrives in one burst."""
        for found in self._ports(port):
            found.faults.stalled_until = time.monotonic() + self._clock.wall(seconds)

    @_hook
    def freeze(self, seconds: Seconds) -> None:
        """The controller's loop stands still: no ticks, no answers, no motion."""
        self._controller.frozen_until = self._clock.now() + seconds

    @_hook
    def delay(self, seconds: Seconds, port: str = "all") -> None:
        """Everything sent arrives so much later; 0 ends it."""
        for found in self._ports(port):
            found.faults.delay = self._clock.wall(seconds)

    @_hook
    def half_open(self, port: str = "all") -> None:
        """The present connections go dead without being closed: nothing is read or sent any more."""
        for connection in self._connections(port):
            connection.half_open = True

    @_hook
    def truncate(self, bytes: Count, port: str = "rtde") -> None:
        """The next send on the port loses everything after its first so many bytes."""
        for found in self._ports(port):
            found.faults.truncate = bytes

    @_hook
    def coalesce(self, sends: Annotated[int, Field(ge=1, le=1000)], port: str = "rtde") -> None:
        """So many sends leave as one; 1 ends it."""
        for found in self._ports(port):
            found.faults.coalesce = sends

    # -- RTDE

    @_hook
    def skip(self, packets: Count) -> None:
        """The next so many data packets are not sent, to any client."""
        for _, session in self._controller.ports["rtde"].clients:
            if isinstance(session, RtdeSession):
                session.skip(packets)

    @_hook
    def handshake_drop(self, packets: Annotated[int, Field(ge=1)], reset: bool = False) -> None:
        """The next client is dropped when it has sent so many packets."""
        self._controller.rtde_faults.drop_after, self._controller.rtde_faults.reset = packets, reset

    @_hook
    def own(self, variables: list[str]) -> None:
        """These input variables belong to someone else; clients that ask for them get IN_USE."""
        for name in variables:
            if name not in INPUTS:
                raise UserError(f"no input variable {name!r}")
            self._controller.inputs.owners[name] = self._elsewhere

    @_hook
    def missing(self, variables: list[str]) -> None:
        """Clients that ask for these output variables get NOT_FOUND."""
        self._controller.outputs.missing.update(self._known(variables))

    @_hook
    def nan(self, variables: list[str], ticks: Count = 1) -> None:
        """These output variables (of doubles) read NaN for so many ticks."""
        self._controller.outputs.not_a_number.update(dict.fromkeys(self._known(variables), ticks + 1))

    @_hook
    def freeze_timestamp(self, frozen: bool = True) -> None:
        """Data goes on, its timestamp does not."""
        self._controller.outputs.frozen_timestamp = self._robot.timestamp if frozen else None

    # -- the program

    @_hook
    def reject_script(self, count: Count = 1) -> None:
        """The next so many scripts are thrown away."""
        self._robot.program.rejections = count

    @_hook
    def slow_start(self, seconds: Seconds) -> None:
        """Scripts start so long after their upload; 0 ends it."""
        self._robot.program.start_delay = seconds

    # -- safety

    @_hook
    def protective_stop(self, reason: str = "fault port") -> None:
        self._robot.safety.protective_stop(reason)

    @_hook
    def unlock(self) -> None:
        """A person releases a protective stop at the pendant; the wait of 5 s is taken as over."""
        self._robot.safety.age(UNLOCK_DELAY)
        self._robot.safety.unlock()

    @_hook
    def emergency_stop(self, pressed: bool = True, system: bool = False) -> None:
        """Press the button, or pull it out (the arm is off then: power on and release the brakes)."""
        if pressed:
            self._robot.safety.emergency_stop(system)
        else:
            self._robot.safety.release_emergency_stop()

    @_hook
    def safeguard_stop(self, active: bool = True) -> None:
        """Break the light curtain, or close it (a paused program stays paused)."""
        if active:
            self._robot.safety.safeguard_stop()
        else:
            self._robot.safety.release_safeguard_stop()

    @_hook
    def safety_fault(self, violation: bool = False) -> None:
        """FAULT or VIOLATION, which `restart safety` ends."""
        self._robot.safety.fault(violation)

    @_hook
    def remote(self, remote: bool) -> None:
        """e-Series: remote or local control."""
        self._robot.safety.remote = remote

    # -- the arm

    @_hook
    def force(self, wrench: Six, seconds: Seconds | None = None) -> None:
        """An extra wrench on the flange [N, Nm], base axes, for so long or until the next one."""
        self._robot.plant.external_force = np.array(wrench)
        self._force_until = np.inf if seconds is None else self._clock.now() + seconds

    @_hook
    def joint_offset(self, offset: Six) -> None:
        """Added to the measured joints [rad]: a tracking error."""
        self._robot.joint_offset = np.array(offset)

    @_hook
    def payload(self, mass: Annotated[float, Field(ge=0.0, le=50.0)], cog: Three) -> None:
        """Someone sets another payload [kg] and centre of gravity [m] at the pendant."""
        machine = self._robot.machine
        machine.payload, machine.payload_cog = mass, np.array(cog)
        machine.plant.set_payload(mass, np.array(cog))

    @_hook
    def tcp(self, pose: Six) -> None:
        """Someone sets another TCP at the pendant: position [m], rotation vector [rad]."""
        self._robot.machine.tcp = np.array(pose)

    @_hook
    def speed_slider(self, fraction: Annotated[float, Field(ge=0.0, le=1.0)]) -> None:
        self._robot.machine.speed_fraction = fraction

    # -- who it says it is

    @_hook
    def version(
        self, version: Annotated[list[Annotated[int, Field(ge=0, lt=2**31)]], Field(min_length=4, max_length=4)]
    ) -> None:
        """The controller reports this software version; its behaviour stays."""
        major, minor, bugfix, build = version
        self._robot.identity.version = (major, minor, bugfix, build)

    @_hook
    def model(self, name: str) -> None:
        """The dashboard reports this model."""
        self._robot.identity.model = name

    @_hook
    def serial(self, number: str) -> None:
        """The dashboard reports this serial number."""
        self._robot.identity.serial = number

    @_hook
    def kinematics(self, a: Six, d: Six) -> None:
        """This arm's DH parameters differ from the nominal ones by so much [m]: in what it reports, with another
        checksum, and in its own kinematics."""
        nominal = MODELS[self._controller.options.model]
        self._robot.calibrate(
            replace(
                nominal,
                a=tuple(x + dx for x, dx in zip(nominal.a, a, strict=True)),
                d=tuple(x + dx for x, dx in zip(nominal.d, d, strict=True)),
            )
        )

    @_hook
    def reboot(self, seconds: Seconds = 1.0, powered: bool = False) -> None:
        """The controller restarts: connections are reset, nobody listens for so long, the program and the registers
        are lost, and the arm is off afterwards unless `powered`."""
        for port in self._controller.ports.values():
            port.refuse()
            port.drop(reset=True)
        self._reopen.clear()
        self._robot.reboot()
        self._robot.safety.robot_mode = RobotMode.BOOTING
        self._boot_until, self._power_after_boot = self._clock.now() + seconds, powered

    # -- what tests want to know

    @_hook
    def state(self) -> dict[str, Any]:
        """The truth about the robot: joints, modes, program, settings, tick statistics, clients."""
        return describe(self._controller)

    @_hook
    def registers(self) -> dict[str, Any]:
        """All general purpose registers."""
        registers = self._robot.registers
        names = ("int_in", "float_in", "bool_in", "int_out", "float_out", "bool_out")
        return {name: list(getattr(registers, name)) for name in names}

    @_hook
    def trace(self, after: int = -1) -> dict[str, Any]:
        """The ticks after number `after`, oldest first, at most TRACE_PAGE of them: ask again with the last one's."""
        trace = self._controller.trace
        first = trace[0].tick if trace else 0
        start = max(0, after + 1 - first)
        rows = [trace[i] for i in range(start, min(len(trace), start + TRACE_PAGE))]
        return {
            "columns": ["tick", "stamp", "safety", "program", "q", "qd", "q_target"],
            "rows": [
                [r.tick, r.stamp, r.safety, r.program, r.q.tolist(), r.qd.tolist(), r.q_target.tolist()] for r in rows
            ],
        }

    @_hook
    def reset_statistics(self) -> None:
        """Count late and slipped ticks from now on."""
        self._controller.schedule.reset()

    @_hook
    def reset(self) -> None:
        """All faults off, the robot as it was started: running, no program, normal safety mode. The joints, the
        registers and the connections stay as they are."""
        controller, robot = self._controller, self._robot
        robot.program.stop()
        robot.program.rejections, robot.program.start_delay = 0, 0.0
        robot.plant.external_force = np.zeros(6)
        self._force_until, self._boot_until = np.inf, None
        robot.joint_offset = np.zeros(6)
        nominal = MODELS[controller.options.model]
        robot.identity = Identity.of(nominal)
        robot.calibrate(nominal)
        robot.machine.speed_fraction = controller.options.speed_slider
        robot.safety.remote = controller.options.remote
        robot.safety.restore()
        controller.outputs.missing.clear()
        controller.outputs.not_a_number.clear()
        controller.outputs.frozen_timestamp = None
        controller.inputs.release(self._elsewhere)
        controller.rtde_faults.drop_after = None
        controller.frozen_until = 0.0
        self._reopen.clear()
        for port in controller.ports.values():
            port.faults.__dict__.update(LinkFaults().__dict__)
            port.listen()
        for connection in self._connections("all"):
            if connection.half_open:
                connection.close(reset=True)

    def _ports(self, name: str) -> list[Port]:
        ports = self._controller.ports
        if name == "all":
            return list(ports.values())
        if name not in ports:
            raise UserError(f"no port {name!r}: choose one of all, {', '.join(ports)}")
        return [ports[name]]

    def _connections(self, name: str) -> list[Connection]:
        return [connection for port in self._ports(name) for connection, _ in port.clients]

    @staticmethod
    def _known(variables: list[str]) -> list[str]:
        for name in variables:
            if name not in OUTPUTS:
                raise UserError(f"no output variable {name!r}")
        return variables

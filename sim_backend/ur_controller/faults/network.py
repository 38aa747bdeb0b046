"""Hooks of the fault port, and those for faults of ports, connections and RTDE."""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import ConfigDict, Field, ValidationError, validate_call

from toolee_robot.errors import TooleeError, UserError
from toolee_robot.sim_backend.ur_controller.server.port import Connection, LinkFaults
from toolee_robot.sim_backend.ur_controller.server.rtde import RtdeSession
from toolee_robot.sim_backend.ur_controller.server.rtde_variables import INPUTS, OUTPUTS

if TYPE_CHECKING:
    from toolee_robot.sim_backend.ur_controller.controller import Controller
    from toolee_robot.sim_backend.ur_controller.server.port import Port

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Seconds = Annotated[float, Field(ge=0.0, le=3600.0)]
Count = Annotated[int, Field(ge=0)]
Three = Annotated[list[Number], Field(min_length=3, max_length=3)]
Six = Annotated[list[Number], Field(min_length=6, max_length=6)]
Method = Callable[..., dict[str, Any] | None]
Hook = Callable[[dict[str, Any]], dict[str, Any]]
"""Converts arguments to an answer; never raises."""


def hook(method: Method) -> Method:
    """Decorator that makes a method of a `HookGroup` a hook."""
    checked: Method = validate_call(config=ConfigDict(arbitrary_types_allowed=True))(method)
    checked.is_hook = True  # type: ignore[attr-defined]
    return checked


class HookGroup:
    """A group of related hooks."""

    def hooks(self) -> dict[str, Hook]:
        """The group's hooks, by name."""
        methods = vars(type(self))
        return {name: partial(_call, self, f) for name, f in methods.items() if getattr(f, "is_hook", False)}

    def step(self) -> None:
        """End the faults whose duration is over; called once per tick."""

    def end(self) -> None:
        """End all faults of the group."""


def _call(group: HookGroup, method: Method, arguments: dict[str, Any]) -> dict[str, Any]:
    name = method.__name__
    try:
        inspect.signature(method).bind(group, **arguments)
        return {"ok": True, **(method(group, **arguments) or {})}
    except ValidationError as error:
        first = error.errors()[0]
        return {"ok": False, "error": f"{name}: {'.'.join(str(part) for part in first['loc'])}: {first['msg']}"}
    except (TypeError, TooleeError) as error:
        return {"ok": False, "error": f"{name}: {error}"}


class NetworkFaults(HookGroup):
    """Hooks for faults of ports and connections.

    Args:
        controller: The controller.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller, self._clock = controller, controller.clock
        self._reopen: dict[str, float] = {}  # port -> time [s]

    def step(self) -> None:
        """Open the ports whose refusal is over."""
        now = self._clock.now()
        for name in [name for name, due in self._reopen.items() if now >= due]:
            del self._reopen[name]
            self._controller.ports[name].listen()

    def down(self) -> None:
        """Close all ports and reset every connection."""
        for port in self._controller.ports.values():
            port.refuse()
            port.drop(reset=True)
        self._reopen.clear()

    def up(self) -> None:
        """Open all ports."""
        for port in self._controller.ports.values():
            port.listen()

    def end(self) -> None:
        """End all network faults and reset half-open connections."""
        self._controller.frozen_until = 0.0
        self._reopen.clear()
        for port in self._controller.ports.values():
            port.faults.__dict__.update(LinkFaults().__dict__)
        self.up()
        for connection in self._connections("all"):
            if connection.half_open:
                connection.close(reset=True)

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

    def _ports(self, name: str) -> list[Port]:
        ports = self._controller.ports
        if name == "all":
            return list(ports.values())
        if name not in ports:
            raise UserError(f"no port {name!r}: choose one of all, {', '.join(ports)}")
        return [ports[name]]

    def _connections(self, name: str) -> list[Connection]:
        return [connection for port in self._ports(name) for connection, _ in port.clients]


class RtdeFaultHooks(HookGroup):
    """Hooks for faults of the RTDE server.

    Args:
        controller: The controller.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._elsewhere = object()  # owner of the variables that `own` claims

    def end(self) -> None:
        """End all RTDE faults."""
        controller = self._controller
        controller.outputs.missing.clear()
        controller.outputs.not_a_number.clear()
        controller.outputs.frozen_timestamp = None
        controller.inputs.release(self._elsewhere)
        controller.rtde_faults.drop_after = None

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


def _known(variables: list[str]) -> list[str]:
    for name in variables:
        if name not in OUTPUTS:
            raise UserError(f"no output variable {name!r}")
    return variables

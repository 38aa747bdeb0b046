"""The dashboard server, port 29999: a client's session, one line in, one line out (UR, "Dashboard server").

Answers have the wording of a real controller, since clients compare their beginnings.
"""

from __future__ import annotations

from collections.abc import Callable

from toolee_robot.sim_backend.ur_controller.robot.safety_system import RobotMode
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.server.port import Sink
from toolee_robot.sim_backend.ur_controller.urscript.program import RuntimeState

GREETING = "Connected: Universal Robots Dashboard Server"
MAX_LINE = 4096  # [bytes]; a client that sends more without an end of line is dropped
_ROLES = ("locked", "programmer", "operator", "none", "restricted")


class DashboardSession:
    """A client's session on the dashboard server.

    Args:
        sink: The client's connection.
        robot: The robot.
    """

    def __init__(self, sink: Sink, robot: Robot) -> None:
        self._sink, self._robot = sink, robot
        self._buffer = bytearray()
        self._ended = False
        self._role = "programmer"
        self._say(GREETING)

    def feed(self, data: bytes) -> None:
        """Take received bytes and answer each complete line."""
        self._buffer += data
        while not self._ended and (end := self._buffer.find(b"\n")) >= 0:
            line = self._buffer[:end].decode("utf-8", "replace").strip()
            del self._buffer[: end + 1]
            if line:
                self._say(self._answer(line))
                if self._ended:
                    self._sink.close()
        if len(self._buffer) > MAX_LINE:
            self._ended = True
            self._sink.close()

    def tick(self) -> None:
        """Nothing to do."""

    def close(self) -> None:
        """Nothing to release."""

    def _say(self, line: str) -> None:
        self._sink.send(line.encode() + b"\n")

    def _answer(self, line: str) -> str:
        words = line.lower().split()
        for count in range(min(4, len(words)), 0, -1):
            command = " ".join(words[:count])
            if (handler := _COMMANDS.get(command)) is not None:
                argument = " ".join(line.split()[count:])
                if self._locked(command):
                    return f"Failed to execute: {line}"
                return handler(self, argument)
        return f'could not understand: "{line}"'

    def _locked(self, command: str) -> bool:
        """Whether the command is refused: an e-Series controller in local control only answers queries."""
        return self._robot.model.e_series and not self._robot.safety.remote and command in _ORDERS

    # -- program

    def _stop(self, _: str) -> str:
        self._robot.program.stop()
        return "Stopped"

    # -- screen

    def _popup(self, argument: str) -> str:
        self._robot.popup = argument
        return "showing popup"

    def _close_popup(self, _: str) -> str:
        self._robot.popup = ""
        return "closing popup"

    def _log(self, argument: str) -> str:
        self._robot.say(argument)
        return "Added log message"

    def _set_role(self, argument: str) -> str:
        if argument not in _ROLES:
            return f"Failed setting user role: {argument}"
        self._role = argument
        return f"Setting user role: {argument}"

    # -- power and safety

    def _power_off(self, _: str) -> str:
        self._robot.safety.power_off()
        return "Powering off"

    def _brake_release(self, _: str) -> str:
        return "Brake releasing" if self._robot.safety.brake_release() else "Failed to execute: brake release"

    def _restart(self, _: str) -> str:
        self._robot.safety.restart()
        return "Restarting safety"

    # -- identity

    def _version(self, _: str) -> str:
        version = ".".join(str(number) for number in self._robot.identity.version)
        return f"URSoftware {version}" if self._robot.model.e_series else version

    def _quit(self, _: str) -> str:
        self._ended = True
        return "Disconnected"

    def _shutdown(self, _: str) -> str:
        self._robot.safety.power_off()
        self._ended = True
        return "Shutting down"


_COMMANDS: dict[str, Callable[[DashboardSession, str], str]] = {
    "load": lambda _, argument: f"File not found: {argument}",
    "load installation": lambda _, argument: f"File not found: {argument}",
    "play": lambda s, _: "Starting program" if s._robot.program.resume() else "Failed to execute: play",
    "stop": DashboardSession._stop,
    "pause": lambda s, _: "Pausing program" if s._robot.program.pause() else "Failed to execute: pause",
    "running": lambda s, _: f"Program running: {str(s._robot.program.state is RuntimeState.PLAYING).lower()}",
    "programstate": lambda s, _: f"{s._robot.program.state.name} {s._robot.program.name}".strip(),
    "get loaded program": lambda *_: "No program loaded",
    "isprogramsaved": lambda *_: "true",
    "popup": DashboardSession._popup,
    "close popup": DashboardSession._close_popup,
    "close safety popup": lambda *_: "closing safety popup",
    "addtolog": DashboardSession._log,
    "setuserrole": DashboardSession._set_role,
    "getuserrole": lambda s, _: s._role.upper(),
    "power on": lambda s, _: "Powering on" if s._robot.safety.power_on() else "Failed to execute: power on",
    "power off": DashboardSession._power_off,
    "brake release": DashboardSession._brake_release,
    "unlock protective stop": lambda s, _: s._robot.safety.unlock() or "Protective stop releasing",
    "restart safety": DashboardSession._restart,
    "robotmode": lambda s, _: f"Robotmode: {RobotMode(s._robot.safety.robot_mode).name}",
    "safetymode": lambda s, _: f"Safetymode: {s._robot.safety.mode.name}",
    "safetystatus": lambda s, _: f"Safetystatus: {s._robot.safety.mode.name}",
    "polyscopeversion": DashboardSession._version,
    "version": DashboardSession._version,
    "get robot model": lambda s, _: s._robot.identity.model,
    "get serial number": lambda s, _: s._robot.identity.serial,
    "is in remote control": lambda s, _: str(s._robot.safety.remote).lower(),
    "quit": DashboardSession._quit,
    "shutdown": DashboardSession._shutdown,
}
_ORDERS = {
    "load", "load installation", "play", "stop", "pause", "power on", "power off", "brake release",
    "unlock protective stop", "restart safety", "shutdown",
}  # fmt: skip

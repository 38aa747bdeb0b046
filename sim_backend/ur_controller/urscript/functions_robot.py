"""The URScript functions that need a robot: every public method is a function of that name."""

from __future__ import annotations

from collections.abc import Generator
from math import ceil, isfinite
from typing import Any

from toolee_robot.sim_backend.ur_controller.robot.machine import Machine
from toolee_robot.sim_backend.ur_controller.robot.registers import Action, Event, EventKind
from toolee_robot.sim_backend.ur_controller.urscript.functions_library import fitting, numbers, text
from toolee_robot.sim_backend.ur_controller.urscript.functions_motion import MotionFunctions
from toolee_robot.sim_backend.ur_controller.urscript.functions_state import StateFunctions

STANDARD = 8
"""Number of standard channels, the first in the machine's lists."""


class IoFunctions:
    """Functions for time, messages and channels.

    Args:
        machine: The robot.
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    # -- time and messages

    def sync(self) -> Generator[None, None, None]:
        """Wait for the next tick."""
        yield

    def sleep(self, t: float) -> Generator[None, None, None]:
        numbers(t, 0)
        if not isfinite(t):
            raise ValueError(f"sleep({t})")
        for _ in range(max(1, ceil(t * self._machine.model.rate - 1e-6))):
            yield

    def get_steptime(self) -> float:
        return self._machine.model.period

    def textmsg(self, s1: Any, s2: Any = "") -> None:
        self._event(EventKind.TEXT, text(s1) + text(s2))

    def popup(
        self, s: Any, title: str = "Popup", warning: bool = False, error: bool = False, blocking: bool = False
    ) -> None:
        """Show a popup; if blocking, the program pauses until it is resumed."""
        del warning, error
        self._event(EventKind.POPUP, f"{title}: {text(s)}")
        if blocking:
            self._event(EventKind.PAUSE, "popup")

    def protective_stop(self) -> None:
        self._event(EventKind.PROTECTIVE_STOP, "asked for by the program")

    def _event(self, kind: EventKind, message: str) -> None:
        self._machine.events.append(Event(kind, message))

    # -- RTDE

    def rtde_set_watchdog(self, variable_name: str, min_frequency: float, action: str = "pause") -> None:
        """Require a minimum frequency of writes to a variable [Hz], else ignore, pause or stop."""
        numbers(min_frequency, 0)
        if not min_frequency > 0:
            raise ValueError(f"a watchdog of {min_frequency} Hz")
        self._machine.watchdogs.set(str(variable_name), float(min_frequency), Action(action))

    def read_input_boolean_register(self, address: int) -> bool:
        return _at(self._machine.registers.bool_in, address)

    def read_input_integer_register(self, address: int) -> int:
        return _at(self._machine.registers.int_in, address)

    def read_input_float_register(self, address: int) -> float:
        return _at(self._machine.registers.float_in, address)

    def write_output_boolean_register(self, address: int, value: bool) -> None:
        _put(self._machine.registers.bool_out, address, _boolean(value))

    def write_output_integer_register(self, address: int, value: int) -> None:
        numbers(value, 0)
        _put(self._machine.registers.int_out, address, fitting(int(value)))

    def write_output_float_register(self, address: int, value: float) -> None:
        numbers(value, 0)
        _put(self._machine.registers.float_out, address, float(value))

    # -- channels

    def get_standard_digital_in(self, n: int) -> bool:
        return _at(self._machine.digital_in[:STANDARD], n)

    def get_digital_in(self, n: int) -> bool:
        return _at(self._machine.digital_in, n)

    def get_standard_digital_out(self, n: int) -> bool:
        return _at(self._machine.digital_out[:STANDARD], n)

    def get_digital_out(self, n: int) -> bool:
        return _at(self._machine.digital_out, n)

    def set_standard_digital_out(self, n: int, b: bool) -> None:
        _at(self._machine.digital_out[:STANDARD], n)
        self.set_digital_out(n, b)

    def set_digital_out(self, n: int, b: bool) -> None:
        _put(self._machine.digital_out, n, _boolean(b))


def _boolean(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"expected a boolean, not {text(value)}")
    return value


def _at(values: list[Any], address: Any) -> Any:
    if type(address) is not int or not 0 <= address < len(values):
        raise IndexError(f"there is no channel {text(address)}: 0 to {len(values) - 1}")
    return values[address]


def _put(values: list[Any], address: Any, value: Any) -> None:
    _at(values, address)
    values[address] = value


E_SERIES_ONLY = frozenset(
    {
        *("end_freedrive_mode", "force_mode_set_gain_scaling", "freedrive_mode", "ft_rtde_input_enable"),
        *("get_actual_joint_positions_history", "get_freedrive_status", "get_steptime", "get_target_payload"),
        *("get_target_payload_cog", "get_target_payload_inertia", "get_target_waypoint", "set_target_payload"),
        "tool_contact",
    }
)


class RobotFunctions(MotionFunctions, StateFunctions, IoFunctions):
    """The functions of one robot.

    Args:
        machine: The robot.
    """


def function_names(e_series: bool) -> list[str]:
    """Names of the functions of a CB3 or an e-Series controller."""
    names = [name for name in dir(RobotFunctions) if not name.startswith("_")]
    return [name for name in names if e_series or name not in E_SERIES_ONLY]

"""Queries of the controller's true state through the fault port."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from toolee_robot.sim_backend.ur_controller.faults.hooks import HookGroup, hook
from toolee_robot.sim_backend.ur_controller.faults.state_report import describe

if TYPE_CHECKING:
    from toolee_robot.sim_backend.ur_controller.controller import Controller

TRACE_PAGE = 250  # rows in one answer: more would delay the tick


class Queries(HookGroup):
    """Hooks that return the controller's state.

    Args:
        controller: The controller.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    @hook
    def state(self) -> dict[str, Any]:
        """Return the true state of the robot: joints, modes, program, settings, tick statistics, clients."""
        return describe(self._controller)

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

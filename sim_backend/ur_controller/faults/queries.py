"""What tests want to know of the controller, through the fault port."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from toolee_robot.sim_backend.ur_controller.faults.hooks import HookGroup, hook
from toolee_robot.sim_backend.ur_controller.faults.state_report import describe

if TYPE_CHECKING:
    from toolee_robot.sim_backend.ur_controller.controller import Controller

TRACE_PAGE = 250  # rows in one answer: more would hold up the tick


class Questions(HookGroup):
    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    @hook
    def state(self) -> dict[str, Any]:
        """The truth about the robot: joints, modes, program, settings, tick statistics, clients."""
        return describe(self._controller)

    @hook
    def registers(self) -> dict[str, Any]:
        """All general purpose registers."""
        registers = self._controller.robot.registers
        names = ("int_in", "float_in", "bool_in", "int_out", "float_out", "bool_out")
        return {name: list(getattr(registers, name)) for name in names}

    @hook
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

    @hook
    def reset_statistics(self) -> None:
        """Count late and slipped ticks from now on."""
        self._controller.schedule.reset()

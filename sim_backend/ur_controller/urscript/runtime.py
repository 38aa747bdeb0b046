"""One running program: its threads, stepped once a controller tick."""

from __future__ import annotations

from toolee_robot.sim_backend.ur_controller.machine import Machine
from toolee_robot.sim_backend.ur_controller.urscript.errors import ScriptError


class ScriptRuntime:
    """A program on a controller.

    source: text of one program (`def name(): ... end`, or `sec`) as it came over port 30001..30003; it starts with
    the next `step`. Raises ScriptError when it does not parse (a controller then shows the message and runs nothing).
    """

    def __init__(self, source: str, machine: Machine) -> None:
        self._machine = machine
        self.name = ""
        self.error: ScriptError | None = None
        self.running = True

    def step(self, dt: float) -> None:
        """Run every thread until it blocks or syncs; dt [s]: since the last step.

        On a script error the program ends: `running` falls, `error` is set and the arm decelerates.
        """

    def stop(self) -> None:
        """End the program (stop button, dashboard, fault): threads end and the arm decelerates."""

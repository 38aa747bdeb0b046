"""A machine on ideal joints that runs scripts tick by tick, without any network."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import ProfileName, profile
from toolee_robot.sim_backend.ur_controller.robot.machine import Machine
from toolee_robot.sim_backend.ur_controller.robot.plant import UR10E, ControllerModel, JointPlant
from toolee_robot.sim_backend.ur_controller.robot.registers import Event, EventKind, Registers
from toolee_robot.sim_backend.ur_controller.urscript.program import ScriptRuntime

READY = (0.3, -1.4, 1.6, -1.8, -1.5, 0.2)
"""A posture far from every singularity [rad]."""


class ScriptRobot:
    def __init__(self, model: ControllerModel = UR10E, q: Sequence[float] = READY, name: ProfileName = "ideal") -> None:
        self.model, self.registers = model, Registers()
        self.plant = JointPlant(model, np.array(q))
        self.machine = Machine(model, self.plant, self.registers, profile(name, model.e_series))
        self.runtime: ScriptRuntime | None = None
        self.events: list[Event] = []
        self.trace: list[Array] = [self.plant.q]
        """Measured joints, one row a tick."""

    def start(self, source: str) -> ScriptRuntime:
        self.runtime = ScriptRuntime(source, self.machine)
        return self.runtime

    def tick(self, ticks: int = 1) -> None:
        for _ in range(ticks):
            if self.runtime is not None:
                self.runtime.step(self.model.period)
            self.machine.step(self.model.period)
            self.events.extend(self.machine.events)
            self.machine.events.clear()
            self.trace.append(self.plant.q)

    def run(self, source: str, seconds: float = 20.0) -> ScriptRuntime:
        """Until the program has ended and the arm stands still."""
        runtime = self.start(source)
        for _ in range(round(seconds * self.model.rate)):
            if not runtime.running and not self.machine.moving:
                return runtime
            self.tick()
        raise AssertionError(f"the program did not end within {seconds} s")

    def value(self, expression: str) -> float:
        """Of an expression of numbers."""
        runtime = self.run(f"write_output_float_register(0, {expression})")
        if runtime.error is not None:
            raise runtime.error
        return self.registers.float_out[0]

    @property
    def messages(self) -> list[str]:
        return [event.text for event in self.events if event.kind is EventKind.TEXT]

    def speeds(self) -> Array:
        """(ticks, 6) [rad/s], differences of the measured joints."""
        return np.diff(np.array(self.trace), axis=0) * self.model.rate

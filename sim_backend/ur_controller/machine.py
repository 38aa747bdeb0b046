"""The robot behind the script: motion, tool settings, I/O. One object for the controller's life.

A tick of the controller is: latch the RTDE inputs; `ScriptRuntime.step(dt)`; `Machine.step(dt)`; safety; publish.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from toolee_robot.sim_backend.ur_controller.model import ControllerModel
from toolee_robot.sim_backend.ur_controller.plant import Plant
from toolee_robot.sim_backend.ur_controller.registers import Registers


class EventKind(StrEnum):
    """What the script asks of the rest of the controller."""

    TEXT = "text"
    POPUP = "popup"
    PROTECTIVE_STOP = "protective_stop"
    HALT = "halt"
    PAUSE = "pause"
    STOP = "stop"


@dataclass(frozen=True)
class Event:
    kind: EventKind
    text: str = ""


class Machine:
    """events: oldest first; the controller takes them out once a tick.

    q_target, qd_target, qdd_target (6,): the set-point. tcp: (6,) pose of the TCP in the flange, position [m] and
    rotation vector [rad]. payload [kg], payload_cog (3,) [m], gravity (3,) [m/s^2] (upwards). speed_fraction: the speed
    slider, 0..1. moving: a motion is under way or the arm has not come to rest.
    """

    def __init__(self, model: ControllerModel, plant: Plant, registers: Registers) -> None:
        self.model, self.plant, self.registers = model, plant, registers
        self.events: deque[Event] = deque()
        self.q_target, self.qd_target, self.qdd_target = plant.q.copy(), np.zeros(6), np.zeros(6)
        self.tcp = np.zeros(6)
        self.payload, self.payload_cog, self.payload_inertia = 0.0, np.zeros(3), np.zeros(6)
        self.gravity = np.array([0.0, 0.0, 9.82])
        self.speed_fraction = 1.0
        self.paused = False
        self.digital_in, self.digital_out = [False] * 18, [False] * 18
        self.analog_in, self.analog_out = [0.0] * 4, [0.0] * 4
        self.temperatures = [30.0] * 6

    @property
    def moving(self) -> bool:
        return bool(np.any(np.abs(self.qd_target) > 1e-9))

    def step(self, dt: float) -> None:
        """Advance the motion by one tick [s], command the plant and step it."""

    def stop(self, deceleration: float | None = None) -> None:
        """Every joint comes to rest with this [rad/s^2]; default: the model's stop_deceleration."""

    def fed(self, variable: str) -> None:
        """An RTDE client has written this input variable (its name in RTDE): feeds the script's watchdogs."""

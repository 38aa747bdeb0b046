"""A simulated station whose hand is driven by its real driver, over a wire, with an emulated hand at the other end."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from typing import Any, Self

from toolee_robot.config import StationConfig
from toolee_robot.hal import Station
from toolee_robot.sim_backend.devices.driven_hand import DrivenHand
from toolee_robot.sim_backend.ground_truth.judge import Judge
from toolee_robot.sim_backend.hand_wire import HandEmulator
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.stations.hand import emulated_hand, open_hand
from toolee_robot.tools import Tool

SWITCH_INTERVAL = 0.0005
"""Time after which a thread of this process must let another one run [s]: the simulation lets the driver's, and the
emulated hand's, keep to the wire's times."""


class _RealTime:
    """Lets the simulation run no faster than the host's time, nor make up for time in which it stood.

    The driver's clock is the station's, so that a hand is not late because the simulation stood still.
    """

    def __init__(self) -> None:
        self._due = time.monotonic()

    def __call__(self, step: float) -> None:
        now = time.monotonic()
        self._due = max(self._due, now - step) + step
        time.sleep(max(0.0, self._due - now))


class _EmulatedTouch:
    """What the simulated fingers touch, felt by an emulated hand in this process."""

    def __init__(self, emulator: HandEmulator[Any]) -> None:
        self._emulator = emulator

    def met(self, finger: str) -> None:
        self._emulator.met(finger)

    def lost(self) -> None:
        self._emulator.hold(None)


class DrivenHandStation:
    """A simulated station with the hand's own driver; use it in its `with` block.

    Args:
        config: Configuration of the station; the hand has a driver.
        seed: Seed of tool, grasp and scene.
        options: Options of the simulation.
        port: Port of a hand, an emulated one; None: one is emulated here, and feels what the simulated hand touches.

    Attributes:
        simulation: The simulated station behind it; set inside the block.
    """

    simulation: SimStation

    def __init__(self, config: StationConfig, seed: int, options: SimOptions, port: str | None) -> None:
        self._config, self._seed, self._options, self._port = config, seed, options, port
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        """Build the simulation and the hand, and enter the driver.

        Raises:
            UserError: The seed or an option is unusable, or the hand has no driver.
            NoAnswerError: Nobody answers on the port.
        """
        with ExitStack() as stack:
            stack.callback(sys.setswitchinterval, sys.getswitchinterval())
            sys.setswitchinterval(SWITCH_INTERVAL)
            port, touch = self._port, None
            if port is None:
                emulator = stack.enter_context(emulated_hand(self._config.hand))
                port, touch = emulator.port, _EmulatedTouch(emulator)
            self.simulation = stack.enter_context(SimStation.build(self._config, self._seed, self._options))
            world, station = self.simulation.world, self.simulation.station
            world.before_step.append(_RealTime())
            driver = stack.enter_context(open_hand(replace(self._config.hand, port=port), station.clock))
            self._station = replace(station, hand=DrivenHand(world, self._options.friction, driver, touch))
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def station(self) -> Station:
        """The devices of the station."""
        return self._station

    @property
    def tool(self) -> Tool:
        """The tool that is handed over."""
        return self.simulation.tool

    @property
    def judge(self) -> Judge:
        """Ground truth, for the evaluation after the job."""
        return self.simulation.judge

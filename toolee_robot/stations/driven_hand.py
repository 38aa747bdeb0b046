"""A simulated station whose hand is driven by its real driver, over a wire, with an emulated hand at the other end."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import replace
from typing import Any, Self

from toolee_robot.errors import DeviceError
from toolee_robot.hal import Clock, Hand, Station
from toolee_robot.sim_backend.devices.driven_hand import DrivenHand
from toolee_robot.sim_backend.ground_truth.judge import Judge
from toolee_robot.sim_backend.hand_wire import HandEmulator
from toolee_robot.sim_backend.hands import emulated_hand
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.station import StationConfig
from toolee_robot.stations.hand import open_hand
from toolee_robot.tools import Tool

SWITCH_INTERVAL = 0.0005
"""Time after which a thread of this process must let another one run [s]: the simulation lets the driver's, and the
emulated hand's, keep to the wire's times."""
LOOK_PERIOD, AHEAD = 0.01, 0.04
"""How often the simulation looks for the hand's newest reading, and by how far it may be ahead of it [s, its own]."""
WAIT = 2.0
"""How long it waits for the next one [s of the host's time]."""


class HandPace:
    """Lets the simulation run no faster than the host's time, and no further ahead of the hand than it has to.

    The driver's clock is the station's, so that a hand is not late because the simulation stood still. On a busy
    machine the simulation could also leave behind the threads of driver and emulated hand, which no real arm does: it
    waits for their next reading, unless that does not come. Call it before every step of the simulation.

    Args:
        clock: The station's clock.

    Attributes:
        hand: The driver, entered; None while there is none.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock, self._due = clock, time.monotonic()
        self._looked, self._given_up = -math.inf, -math.inf
        self.hand: Hand | None = None

    def __call__(self, step: float) -> None:
        now = time.monotonic()
        self._due = max(self._due, now - step) + step
        time.sleep(max(0.0, self._due - now))
        if self.hand is not None and self._clock.now() - self._looked >= LOOK_PERIOD:
            self._looked = self._clock.now()
            self._wait_for(self.hand)

    def _wait_for(self, hand: Hand) -> None:
        end = time.monotonic() + WAIT
        with suppress(DeviceError):  # which whoever asks for a state is told
            while (stamp := hand.state(math.inf).joints.stamp) > self._given_up:
                if self._clock.now() - stamp <= AHEAD:
                    return
                if time.monotonic() > end:
                    self._given_up = stamp  # it is silent: the time goes on, until it has said something again
                    return
                time.sleep(0.002)


class _EmulatedTouch:
    """What the simulated fingers touch, felt by an emulated hand in this process."""

    def __init__(self, emulator: HandEmulator[Any]) -> None:
        self._emulator = emulator

    def met(self, finger: str) -> None:
        self._emulator.met(finger)

    def lost(self) -> None:
        self._emulator.hold(None)

    def following(self, clock: Callable[[], float]) -> AbstractContextManager[None]:
        return self._emulator.time.following(clock, AHEAD)


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
            real_time = HandPace(station.clock)
            world.before_step.append(real_time)
            driver = stack.enter_context(open_hand(replace(self._config.hand, port=port), station.clock))
            real_time.hand = driver
            stack.callback(setattr, real_time, "hand", None)
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

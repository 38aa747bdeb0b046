"""A hand's own driver, on an emulated hand, in the place of the simulated hand's judgement.

The hammer is held in the simulation by the simulated hand; whether it is held, and what is wrong with the hand, is what
the driver says, which speaks to an emulated hand over its wire.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import replace
from typing import Any, Self

from tests.rigs.job_rig import ClosedHand
from tests.rigs.wired_hands import HANDS as WIRED_HANDS
from tests.rigs.wired_hands import WiredHand
from toolee_robot.devices.hands import open_hand
from toolee_robot.errors import DeviceError
from toolee_robot.hal import Clock, Hand, HandState
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.devices.hand import TICK, SimHand
from toolee_robot.sim_backend.hands import emulated_hand
from toolee_robot.sim_backend.hands.kit import HandEmulator
from toolee_robot.stations.rehearsal.emulated_lab import SWITCH_INTERVAL

HANDS = tuple(hand for hand in WIRED_HANDS.values() if hand.slip)
"""The hands that the fault table has, on each of their wires."""
LOOK_PERIOD, AHEAD = 0.01, 0.04
"""How often the simulation looks for the hand's newest reading, and by how far it may be ahead of it [s, its own]."""
WAIT = 2.0
"""How long it waits for the next one [s of the host's time]."""


class HandPace:
    """Lets the simulation run no faster than the host's time, and no further ahead of the hand than it has to."""

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


class DriverHand(ClosedHand):
    """The simulated hand, closed around the hammer, with a driver's judgement; use it in its `with` block."""

    def __init__(self, simulation: SimStation, simulated: SimHand, kind: WiredHand) -> None:
        super().__init__(simulated)
        self.kind, self._simulation = kind, simulation
        self.emulator: HandEmulator[Any] = emulated_hand(kind.config)
        clock = simulation.station.clock
        self._driver = open_hand(replace(kind.config, port=self.emulator.port), clock)
        self._pace = HandPace(clock)
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        self._stack.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._stack.enter_context(self.emulator)
        self._pace.hand = self._stack.enter_context(self._driver)
        before_step = self._simulation.world.before_step
        before_step.append(self._pace)
        self._stack.callback(before_step.remove, self._pace)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def told(self) -> tuple[Any, ...]:
        """What the emulated hand was told last."""
        told: tuple[Any, ...] = self.emulator.tell(lambda emulated: emulated.told)
        return told

    def state(self, max_age: float = 0.1) -> HandState:
        state, judged = self._hand.state(max_age), self._driver.state(max_age)
        return replace(
            state, holding=judged.holding, fault=judged.fault, temperature=judged.temperature,
            contact_forces=judged.contact_forces,
        )  # fmt: skip

    def open(self, timeout: float = 8.0) -> None:
        self.opened += 1
        self._meanwhile(lambda: self._driver.open(timeout))
        self.emulator.hold(None)
        self.closed = False

    def close(self, timeout: float = 8.0) -> None:
        self.emulator.hold(self.kind.handle)
        self._meanwhile(lambda: self._driver.close(timeout))
        self.closed = True

    def stop(self) -> None:
        self._driver.stop()

    def _meanwhile(self, motion: Callable[[], None]) -> None:
        """Let the station's time pass while the driver moves its hand."""
        with ThreadPoolExecutor(1) as pool:
            moving = pool.submit(motion)
            while not moving.done():
                self._simulation.world.advance(TICK)
            moving.result()

"""A hand's own driver, on an emulated hand, in the place of the simulated hand's judgement.

The hammer is held in the simulation by the simulated hand; whether it is held, and what is wrong with the hand, is what
the driver says, which speaks to an emulated hand over a pseudo-terminal, or over TCP.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any, Self

from toolee_robot.config import HandConfig
from toolee_robot.faults.rigs.job_rig import ClosedHand
from toolee_robot.hal import HandState
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.devices.hand import TICK, SimHand
from toolee_robot.sim_backend.hand_wire import HandEmulator
from toolee_robot.stations.driven_hand import SWITCH_INTERVAL, HandPace
from toolee_robot.stations.hand import emulated_hand, open_hand
from toolee_robot.types import HandMounting

MOUNTING = HandMounting(position=(0.0, 0.0, 0.08), fingers=(0.0, 0.0, 1.0), thumb=(1.0, 0.0, 0.0))
"""Any: the arm of these rows carries the simulated hand."""


@dataclass(frozen=True)
class HandKind:
    """A kind of hand.

    Attributes:
        model: Its name in a station file.
        label: Name of the rows' column.
        handle: Angle at which its fingers meet a handle, in the hand's own unit.
        slip: Way by which a slipping handle gives way, in that unit.
        margin: Largest distance of a finger that still holds from `handle`, in that unit.
        port: Its port in a station file, as far as that tells its wire; None for a serial line.
    """

    model: str
    label: str
    handle: float
    slip: float
    margin: float
    port: str | None = None


HANDS = (
    HandKind("inspire_rh56", "Inspire RH56", 400.0, 60.0, 110.0),
    HandKind("ability_hand", "Ability Hand", 55.0, 6.0, 15.0),
    HandKind("inspire_rh56", "Inspire Modbus-TCP", 400.0, 60.0, 110.0, "tcp://127.0.0.1:6000"),
)
"""The hands that have a driver here and an emulator, on each of their wires."""


class DriverHand(ClosedHand):
    """The simulated hand, closed around the hammer, with a driver's judgement; use it in its `with` block.

    Args:
        simulation: The simulated station.
        simulated: Its hand.
        kind: Which hand.

    Attributes:
        kind: Which hand.
        emulator: The emulated hand.
    """

    def __init__(self, simulation: SimStation, simulated: SimHand, kind: HandKind) -> None:
        super().__init__(simulated)
        self.kind, self._simulation = kind, simulation
        config = HandConfig(kind.model, mounting=MOUNTING, port=kind.port)
        self.emulator: HandEmulator[Any] = emulated_hand(config)
        clock = simulation.station.clock
        self._driver = open_hand(replace(config, port=self.emulator.port), clock)
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

"""The simulated hand as the fingers of a real driver, whose hand is emulated."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Protocol

import numpy as np

from toolee_robot.hal import Hand, HandState
from toolee_robot.sim_backend.devices.hand import CONTACT_FORCE, LEAD, TICK, SimHand
from toolee_robot.sim_backend.world import SimWorld

READ = 0.5
"""Largest age of the driver's reading that the simulated fingers follow [s]."""


class Touch(Protocol):
    """How the emulated hand feels what the simulated one touches."""

    def met(self, finger: str) -> None:
        """A finger has met something where it is now."""

    def lost(self) -> None:
        """There is nothing in the hand any more."""

    def following(self, clock: Callable[[], float]) -> AbstractContextManager[None]:
        """Context in which the emulated hand's motors are no further than the simulation, by its clock [s].

        Or they would have shut before slower simulated fingers meet the handle.
        """


class DrivenHand(SimHand):
    """A `hal.Hand` that is a driver's, and whose fingers are the simulated ones.

    The driver moves its own hand, an emulated one, in the host's time. Meanwhile the simulation has to run, no faster
    than that, and the simulated fingers follow. What the driver says counts: whether it holds something, its faults,
    its forces.

    Args:
        world: The simulated world.
        friction: Coefficient of friction between hand and handle.
        driver: The driver, entered, on the station's clock.
        touch: Tells the emulated hand what its fingers touch; None for one that has something in it by itself. After
            it has closed, the simulated fingers then close further by themselves, until they touch the handle.
    """

    def __init__(self, world: SimWorld, friction: float, driver: Hand, touch: Touch | None) -> None:
        super().__init__(world, friction)
        self._driver, self._touch = driver, touch
        self._held = False

    def state(self, max_age: float = 0.1) -> HandState:
        """The driver's state.

        Args:
            max_age: Largest accepted age [s].

        Returns:
            The state.

        Raises:
            StaleDataError: The driver's hand has been silent for longer than `max_age`.
            DeviceError: The hand is closed, or does not answer.
        """
        self._check_open()
        self._tell_loss()
        return replace(self._driver.state(max_age), assisted=self.gripped)

    def open(self, timeout: float = 8.0) -> None:
        """Release the tool and spread the fingers.

        Args:
            timeout: Time for the motion [s].

        Raises:
            DeviceError: What the driver raises, or the hand is closed.
        """
        self._check_open()
        if self._world.grip is not None:
            self._world.grip.release()
        self._held = False
        self._follow(lambda: self._driver.open(timeout))
        if self._touch is not None:
            self._touch.lost()

    def close(self, timeout: float = 8.0) -> None:
        """Close until the driver's hand holds something or is shut; then the assisted grip begins, if it does.

        Args:
            timeout: Time for the motion [s].

        Raises:
            DeviceError: What the driver raises, or the hand is closed.
        """
        self._check_open()
        self._follow(lambda: self._driver.close(timeout))
        if self._touch is None and self._driver.state(READ).holding:
            super().close(timeout)
        self._hold()
        self._held = self.gripped
        if not self._held and self._touch is not None:
            self._touch.lost()
            self._world.advance(READ)  # until the driver feels it

    def stop(self) -> None:
        """Stop the fingers; a grip is kept."""
        self._driver.stop()
        super().stop()

    def _tell_loss(self) -> None:
        if self._held and not self.gripped and self._touch is not None:
            self._held = False
            self._touch.lost()

    def _follow(self, motion: Callable[[], None]) -> None:
        """Let the simulated fingers follow the driver's hand while it moves."""
        together = nullcontext() if self._touch is None else self._touch.following(lambda: self._world.time)
        with together, ThreadPoolExecutor(1) as pool:
            moving = pool.submit(motion)
            while not moving.done():
                goal = self._driver.state(READ).joints.q
                if not self.gripped:
                    q = self._world.robot.hand_state()[0]
                    self._target = q + np.clip(goal - q, -LEAD, LEAD)
                    self._world.robot.command_hand(self._target)
                self._world.advance(TICK)
                if self._touch is not None:
                    forces, _ = self._contact_forces()
                    for finger, force in forces.items():
                        if force > CONTACT_FORCE:
                            self._touch.met(finger)
            moving.result()

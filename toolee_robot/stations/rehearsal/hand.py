"""The emulated hand of a rehearsal: its motors move the simulated fingers, and feel what these touch."""

from __future__ import annotations

import threading
from collections import deque
from contextlib import suppress
from typing import Any, Self

import numpy as np

from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.robots import PALM
from toolee_robot.sim_backend.devices.hand import Touched
from toolee_robot.sim_backend.hands.kit import HandEmulator
from toolee_robot.sim_backend.remote import Caller

PERIOD = 0.02
"""Time between two steps of the fingers on the wall clock [s]."""
STANDS = 0.005
"""Way of every joint in STANDS_FOR steps up to which the hand stands [rad]."""
STANDS_FOR = 8
OPENS = 0.08
"""Mean way of the joints towards the open hand, from where they gripped, after which the hand has let go [rad]."""
GRIP_TIME = 1.0
"""Time for the assisted grip to begin [s]."""


class FingerCoupling:
    """Couples an emulated hand with the simulated fingers, in a thread of its own while in its `with` block.

    The driver at the other end of the emulated hand's wire knows nothing of it.

    Args:
        world: Sends requests to the world.
        emulator: The emulated hand.
        q_open: Positions of the joints of the open hand [rad].
        opposing: The finger that opposes the others, without which there is no grip.
    """

    def __init__(self, world: Caller, emulator: HandEmulator[Any], q_open: Array, opposing: str) -> None:
        self._world, self._emulator, self._q_open, self._opposing = world, emulator, q_open, opposing
        self._over = threading.Event()
        self._recent: deque[Array] = deque(maxlen=STANDS_FOR)
        self._met: set[str] = set()
        self._gripped_at: float | None = None
        self._refused = False
        self._thread = threading.Thread(target=self._run, name="emulated fingers", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        with suppress(DeviceError):  # the world has ended, which every other device says
            self._couple()

    def _couple(self) -> None:
        while not self._over.wait(PERIOD):
            q = self._emulator.joints(np.array(self._emulator.angles))
            self._recent.append(q)
            touched: Touched = self._world.call("fingers.follow", q)
            if self._gripped_at is None:
                self._feel(touched, q)
            elif not touched.gripped:  # dropped, or torn out of the hand
                self._lose()
            elif self._closed(q) < self._gripped_at - OPENS:
                self._world.call("fingers.let_go")
                self._lose()

    def _feel(self, touched: Touched, q: Array) -> None:
        for finger in touched.fingers:
            self._emulator.met(finger)
            self._met.add(finger)
        if not self._stands:
            self._refused = False
        elif not self._refused and self._opposed:
            if self._world.call("fingers.grip", lasting=GRIP_TIME):
                self._gripped_at = self._closed(q)
            else:
                self._refused = True
                self._lose()

    @property
    def _opposed(self) -> bool:
        """Whether thumb and fingers have met something: fingers that wait for the thumb stand as well."""
        return self._opposing in self._met and bool(self._met - {self._opposing, PALM})

    @property
    def _stands(self) -> bool:
        return len(self._recent) == STANDS_FOR and bool(np.ptp(self._recent, axis=0).max() < STANDS)

    def _closed(self, q: Array) -> float:
        return float(np.mean(np.abs(q - self._q_open)))

    def _lose(self) -> None:
        self._gripped_at = None
        self._met.clear()
        self._emulator.hold(None)

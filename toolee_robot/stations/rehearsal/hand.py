"""The emulated hand of a rehearsal: its motors move the simulated fingers, and feel what these touch."""

from __future__ import annotations

import threading
from typing import Self

import numpy as np

from toolee_robot.robots.hands.inspire import joints_of_counts
from toolee_robot.sim_backend.devices.coupled_fingers import Touched
from toolee_robot.sim_backend.inspire_hand import Hand, HandEmulator
from toolee_robot.sim_backend.inspire_hand.hand import NAMES
from toolee_robot.sim_backend.remote.station import Caller

PERIOD = 0.02
"""Time between two steps of the fingers on the wall clock [s]."""
OPENS = 60.0
"""Mean way of the motors from where they gripped, after which the hand has let go [counts]."""
GRIP_TIME = 1.0
"""Time for the assisted grip to begin [s]."""
_MOTORS = {"thumb": "thumb_bend"}


class FingerCoupling:
    """Couples an emulated hand with the simulated fingers, in a thread of its own while in its `with` block.

    The driver at the other end of the emulated hand's wire knows nothing of it.

    Args:
        world: Sends requests to the world.
        emulator: The emulated hand.
    """

    def __init__(self, world: Caller, emulator: HandEmulator) -> None:
        self._world, self._emulator = world, emulator
        self._over = threading.Event()
        self._gripped_at: np.ndarray | None = None
        self._refused = False
        self._thread = threading.Thread(target=self._run, name="emulated fingers", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._over.wait(PERIOD):
            angles = np.array(self._emulator.angles)
            touched: Touched = self._world.call("fingers.follow", joints_of_counts(angles))
            if self._gripped_at is None:
                self._feel(touched, angles)
            elif not touched.gripped:  # dropped, or torn out of the hand
                self._lose()
            elif np.mean(angles - self._gripped_at) > OPENS:
                self._world.call("fingers.let_go")
                self._lose()

    def _feel(self, touched: Touched, angles: np.ndarray) -> None:
        met = [name for finger in touched.fingers if (name := _MOTORS.get(finger, finger)) in NAMES]
        stands = False

        def feel(hand: Hand) -> None:
            nonlocal stands
            hand.run()
            for name in met:
                motor = hand.motors[NAMES.index(name)]
                if motor.met_at is None:
                    motor.met_at = motor.position
            stands = all(motor.stands for motor in hand.motors)

        self._emulator.tell(feel)
        if not stands:
            self._refused = False
        elif not self._refused and "thumb_bend" in met and len(met) > 1:
            if self._world.call("fingers.grip", lasting=GRIP_TIME):
                self._gripped_at = angles
            else:
                self._refused = True
                self._lose()

    def _lose(self) -> None:
        self._gripped_at = None
        self._emulator.tell(lambda hand: hand.hold(None))

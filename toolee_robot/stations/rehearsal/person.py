"""The rehearsed cell: the emulated hand's fingers, and the person."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any, Protocol, Self

import numpy as np

from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, Person
from toolee_robot.robots import PALM
from toolee_robot.sim_backend.devices.hand import Touched
from toolee_robot.sim_backend.hands.kit import HandEmulator
from toolee_robot.sim_backend.remote import Caller
from toolee_robot.station import PersonConfig

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


HOLD = 0.25
"""Time for which a person holds or releases the switch for a confirmation [s]."""


class Wiring(Protocol):
    """What is wired to the robot."""

    def fault(self, name: str, /, **arguments: object) -> object:
        """Act as `digital_input` does, or `door`, which is on the safeguard as well."""


class RehearsedPerson:
    """A `hal.Person` that acts at once; its answers are those of the driver of the inputs.

    The door is on the robot's safeguard input, too, as it has to be: the robot is stopped while it is open, and made
    ready when it is closed.

    Args:
        driver: The driver, which reads the inputs.
        config: Numbers of the inputs.
        wiring: What door and switch are wired to.
        world: Sends requests to the world.
        clock: The station's clock.
        clamps: Whether the person fixes the tool in a mount, and takes it out of it.
    """

    def __init__(
        self, driver: Person, config: PersonConfig, wiring: Wiring, world: Caller, clock: Clock, *, clamps: bool
    ) -> None:
        self._driver, self._config, self._wiring = driver, config, wiring
        self._world, self._clock, self._clamps = world, clock, clamps
        self.zone_occupied: Callable[[], bool] = driver.zone_occupied
        self.hold_to_run_held: Callable[[], bool] = driver.hold_to_run_held
        self.readings_certain: Callable[[], bool] = driver.readings_certain
        self._door(closed=True)
        self._switch(held=False)

    def request_handover(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""

        def act() -> None:
            self._switch(held=False)
            self._door(closed=False)
            if self._world.call("person.request_handover", prompt, timeout, lasting=timeout):
                if self._clamps:
                    self._world.call("hand.close", timeout, lasting=timeout)
                self._press()

        return self._while(act, lambda: self._driver.request_handover(prompt, timeout))

    def release(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""

        def act() -> None:
            self._switch(held=False)
            if self._world.call("person.release", prompt, timeout, lasting=timeout):
                self._door(closed=True)
                self._clock.sleep(HOLD)
                self._press()

        return self._while(act, lambda: self._driver.release(prompt, timeout))

    def take_tool(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""

        def act() -> None:
            self._door(closed=False)
            if self._world.call("person.take_tool", prompt, timeout, lasting=timeout):
                if self._clamps:
                    self._world.call("hand.open", timeout, lasting=timeout)
                self._press()

        return self._while(act, lambda: self._driver.take_tool(prompt, timeout))

    def confirm_swing(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._while(self._press, lambda: self._driver.confirm_swing(prompt, timeout))

    def confirm_inspection(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""
        return self._while(self._press, lambda: self._driver.confirm_inspection(prompt, timeout))

    def hold_switch(self, prompt: str, timeout: float) -> bool:
        """See `hal.Person`."""

        def act() -> None:
            self._switch(held=False)
            self._clock.sleep(HOLD)
            self._switch(held=True)

        return self._while(act, lambda: self._driver.hold_switch(prompt, timeout))

    def _while(self, act: Callable[[], None], ask: Callable[[], bool]) -> bool:
        with ThreadPoolExecutor(1) as pool:
            acting = pool.submit(act)
            answer = ask()
            acting.result()
        return answer

    def _press(self) -> None:
        for held in (False, True, False):
            self._switch(held=held)
            self._clock.sleep(HOLD)

    def _door(self, *, closed: bool) -> None:
        self._wiring.fault("door", opened=not closed, index=self._config.door_closed_input)
        if self._config.door_open_input is not None:
            self._input(self._config.door_open_input, not closed)

    def _switch(self, *, held: bool) -> None:
        self._input(self._config.hold_to_run_input, held)
        if self._config.hold_to_run_released_input is not None:
            self._input(self._config.hold_to_run_released_input, not held)

    def _input(self, index: int, high: bool) -> None:
        self._wiring.fault("digital_input", index=index, high=high)

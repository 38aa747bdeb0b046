"""The rehearsed person: does in the simulated world what a prompt asks for, and answers by door and switch.

What the job believes comes from the lab's own driver of the inputs, over the robot's digital inputs.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

from toolee_robot.hal import Clock, Person
from toolee_robot.sim_backend.remote import Caller
from toolee_robot.station import PersonConfig

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

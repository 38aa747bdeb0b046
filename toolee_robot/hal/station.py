"""The person at the station, and the station: the devices that a task uses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from toolee_robot.hal.arm import Arm
from toolee_robot.hal.device import Clock, Hand, RgbdCamera

CLEAR_TIME = 0.5
"""Time for which the zone must be seen empty without interruption before a person counts as out of reach [s]."""
CLEAR_PERIOD = 0.02
"""Polling period of `wait_until_clear` [s]."""


@runtime_checkable
class Person(Protocol):
    """The person at the station, who hands over the tool and confirms what software must not decide.

    Every question waits up to `timeout` [s] for its answer; no answer counts as a refusal. `zone_occupied` and
    `hold_to_run_held` answer at once, from any thread, and are polled throughout a motion and a question; their
    sources are a guarded door, a light barrier, a scanner, an hold-to-run switch or a key that is held down.
    `tests/contract/test_person_contract.py` checks an implementation.
    """

    def request_handover(self, prompt: str, timeout: float) -> bool:
        """Ask for the tool.

        Args:
            prompt: Instruction for the person.
            timeout: Time to answer [s].

        Returns:
            Whether the person confirmed that the tool lies in the open hand.
        """

    def release(self, prompt: str, timeout: float) -> bool:
        """Ask the person to release the tool and step back, and wait until they have done so.

        A person takes time to step back: the zone is asked again and again, not once.

        Args:
            prompt: Instruction for the person.
            timeout: Time to step back and to be seen outside [s].

        Returns:
            Whether the person confirmed that they are out of reach, and the zone was then seen empty without
            interruption for CLEAR_TIME.
        """

    def take_tool(self, prompt: str, timeout: float) -> bool:
        """Ask the person to hold the tool that the hand still grips.

        Args:
            prompt: Instruction for the person.
            timeout: Time to answer [s].

        Returns:
            Whether the person confirmed that the hand may open.
        """

    def confirm_swing(self, prompt: str, timeout: float) -> bool:
        """Ask whether fast strikes may begin.

        Args:
            prompt: Question for the person.
            timeout: Time to answer [s].

        Returns:
            Whether the person confirmed it.
        """

    def confirm_inspection(self, prompt: str, timeout: float) -> bool:
        """Ask the person to look at robot, hand and tool, and to confirm what the prompt states.

        Args:
            prompt: What to look at, and what a confirmation permits.
            timeout: Time to answer [s].

        Returns:
            Whether the person confirmed it.
        """

    def hold_switch(self, prompt: str, timeout: float) -> bool:
        """Ask the person to take the hold-to-run switch anew: to release it, and to hold it from then on.

        Asked before every motion near a person, so that a switch that is stuck or tied down moves nothing.

        Args:
            prompt: Instruction for the person.
            timeout: Time to do so [s].

        Returns:
            Whether the switch was seen released, and then held.
        """

    def zone_occupied(self) -> bool:
        """Whether a person is or may be within the arm's reach.

        A station that cannot determine it must return True: then nothing fast moves.
        """

    def hold_to_run_held(self) -> bool:
        """Whether the person holds the hold-to-run switch, which lets the arm move slowly while they are near."""

    def readings_certain(self) -> bool:
        """Whether both readings are known, and not assumed for want of data or of time to settle.

        An assumed reading is the safe one, occupied or not held, and proves nothing about the input.
        """


def wait_until_clear(zone_occupied: Callable[[], bool], clock: Clock, timeout: float) -> bool:
    """Wait until the zone has been empty without interruption for CLEAR_TIME.

    Args:
        zone_occupied: As `Person.zone_occupied`.
        clock: Clock of the station.
        timeout: Longest wait [s].

    Returns:
        Whether it was.
    """
    end = clock.now() + timeout
    clear_since: float | None = None
    while (now := clock.now()) <= end:
        if zone_occupied():
            clear_since = None
        else:
            clear_since = now if clear_since is None else clear_since
            if now - clear_since >= CLEAR_TIME - 1e-9:
                return True
        clock.sleep(CLEAR_PERIOD)
    return False


@dataclass(frozen=True)
class Station:
    """The devices that a task uses.

    Attributes:
        arm: The arm.
        hand: The hand on the arm's flange.
        camera: The fixed RGB-D camera.
        person: The person at the station.
        clock: Clock of every stamp in the station.
        robot_serial: Serial number that the robot reports; empty if it reports none.
        camera_serial: Serial number that the camera reports; empty if it reports none.
    """

    arm: Arm
    hand: Hand
    camera: RgbdCamera
    person: Person
    clock: Clock
    robot_serial: str = ""
    camera_serial: str = ""

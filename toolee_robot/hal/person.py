"""Protocol of the person at the station."""

from __future__ import annotations

from typing import Protocol, runtime_checkable


@runtime_checkable
class Person(Protocol):
    """The person at the station, who hands over the tool and confirms what software must not decide.

    Every question waits at most `timeout` [s]; no answer counts as a refusal. `zone_occupied` and
    `enabling_switch_held` answer at once, from any thread, and are polled throughout a motion; their sources are a
    light barrier, a scanner, an enabling switch or a key that is held down.
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
        """Ask the person to release the tool and step back.

        Args:
            prompt: Instruction for the person.
            timeout: Time to answer [s].

        Returns:
            Whether the person confirmed that they are out of reach.
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

    def zone_occupied(self) -> bool:
        """Whether a person is or may be within the arm's reach.

        A station that cannot determine it must return True: then nothing fast moves.
        """

    def enabling_switch_held(self) -> bool:
        """Whether the person holds the enabling switch, which lets the arm move slowly while they are near."""

"""`toolee hand clear-faults`: for a hand that keeps a stall until a person has looked."""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.cli.hand.options import HandMotionOptions


@dataclass(frozen=True, kw_only=True)
class ClearFaults(HandMotionOptions):
    """Clear the hand's faults, such as a stall, once a person has looked for the cause and has confirmed it.

    Example: toolee hand clear-faults --station lab.yaml

    Of this project's hands only the Inspire RH56 keeps such faults. Exit code 1: a fault is left, such as heat. The arm
    is not moved, and no finger is given a target; one that comes free may go on to its last one.
    """

    def run(self) -> int:
        from toolee_robot.cli.hand.session import clear_faults, refuse_without_clearing, run_motion

        return run_motion(
            self,
            "Look why the hand has a fault, and take away what blocks it. A finger that comes free may move: your "
            "fingers out of the hand. Clear the faults?",
            "The hand has no fault.",
            clear_faults,
            refuse_without_clearing,
        )

"""`toolee hand close`: to try a hand that was just mounted."""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.cli.hand.options import HandMotionOptions


@dataclass(frozen=True, kw_only=True)
class Close(HandMotionOptions):
    """Close the hand until it holds something or is shut, once a person has confirmed it. The arm is not moved.

    Example: toolee hand close --station lab.yaml --port hand.port

    Ctrl-C stops the fingers, which keep what they hold. An Ability Hand may let go when the command ends.
    """

    def run(self) -> int:
        from toolee_robot.cli.hand.session import run_motion

        return run_motion(
            self,
            "The fingers close until they hold something or are shut. Your fingers out of the hand. Close?",
            "The hand is closed.",
            lambda hand: hand.close(),
        )

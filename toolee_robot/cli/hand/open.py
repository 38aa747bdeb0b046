"""`toolee hand open`: for instance to take the tool out after a job."""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.cli.hand.options import HandMotionOptions


@dataclass(frozen=True, kw_only=True)
class Open(HandMotionOptions):
    """Open the hand, once a person has taken hold of the tool and has confirmed it. The arm is not moved.

    Example: toolee hand open --station lab.yaml

    What the hand holds falls. Ctrl-C stops the fingers where they are.
    """

    def run(self) -> int:
        from toolee_robot.cli.hand.session import run_motion

        return run_motion(
            self,
            "What the hand holds falls when it opens. Take hold of the tool, your fingers out of the hand's way. Open?",
            "The hand is open.",
            lambda hand: hand.open(),
        )

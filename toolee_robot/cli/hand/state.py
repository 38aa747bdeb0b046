"""`toolee hand state`: what the hand tells of itself."""

from __future__ import annotations

from dataclasses import dataclass

from rich.console import Console

from toolee_robot.cli.hand.options import HandOptions

EXIT_FAULT = 1


@dataclass(frozen=True, kw_only=True)
class State(HandOptions):
    """Show the hand's joints, forces, hold, temperature and fault. Nothing is moved.

    Example: toolee hand state --station lab.yaml

    Exit code 1: the hand has a fault, or does not answer. Angles in --json are in radians.
    """

    def run(self) -> int:
        from toolee_robot.cli.hand.session import MAX_AGE, connected, tell

        console = Console(stderr=self.json, highlight=False)
        with connected(self.hand(), console) as hand:
            state = hand.state(MAX_AGE)
            tell(self, hand, state, console)
        return EXIT_FAULT if state.fault else 0

"""A person at the stand-in's station, who does what the matrix needs them to do."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class StandInPerson:
    """A `hal.Person`. is_inside: within the arm's reach. holds_switch: lets the arm move slowly. confirms: says yes."""

    is_inside: bool = False
    holds_switch: bool = True
    confirms: bool = True

    def request_handover(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        return self.confirms

    def release(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        return self.confirms

    def take_tool(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        return self.confirms

    def confirm_swing(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        return self.confirms

    def inside(self) -> bool:
        return self.is_inside

    def attending(self) -> bool:
        return self.holds_switch

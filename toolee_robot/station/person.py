"""The inputs by which the station knows where people are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from toolee_robot.station.values import STRICT
from toolee_robot.types.units import Number

InputNumber = Annotated[int, Number(0, 17)]
"""Number of a digital input in the robot's input bits: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""


@dataclass(frozen=True)
class PersonConfig:
    """Digital inputs of the guarded door and the hold-to-run switch. No field has a default: a lab states its wiring.

    Both are wired so that a broken wire reads as an open door and a released switch. These inputs inform the program;
    they protect nobody: the door also acts on the robot's safeguard input.
    """

    __pydantic_config__ = STRICT
    door_closed_input: InputNumber
    """Input that is high while the door is closed, and nobody can be inside."""
    door_open_input: InputNumber | None
    """Input of the door's second contact, high while the door is open; null where the door has a single contact."""
    hold_to_run_input: InputNumber
    """Input that is high while the application's own hold-to-run switch is pressed; not the 3-position enabling switch
    of an e-Series robot, which acts in manual mode only."""
    hold_to_run_released_input: InputNumber | None
    """Input of the switch's second contact, high while the switch is released; null where it has a single contact."""

    def __post_init__(self) -> None:
        used = [
            number
            for number in (
                self.door_closed_input,
                self.door_open_input,
                self.hold_to_run_input,
                self.hold_to_run_released_input,
            )
            if number is not None
        ]
        if len(set(used)) < len(used):
            raise ValueError(f"inputs {used} name one input twice: every contact needs an input of its own")

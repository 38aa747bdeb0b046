"""Where a strike should meet the nail, and whether it did, told by the joints: a servo lags, so no clock can tell."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from toolee_robot.config import SupervisorConfig
from toolee_robot.control.kinematics import ArmKinematics
from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport


class Meeting(StrEnum):
    """How a strike met what it was meant for."""

    EXPECTED = "expected"
    EARLY = "early"
    LATE = "late"
    NONE = "none"


@dataclass(frozen=True)
class ExpectedContact:
    """q: joints (6,) [rad] at which tool and work should meet; direction: unit vector (3,) in `base` along which the
    tool comes; time: of the meeting on the trajectory [s]."""

    q: Array
    direction: Array
    time: float


@dataclass(frozen=True)
class ContactVerdict:
    """before: how far before the expected place the tool was stopped [m], negative beyond it; NaN without contact."""

    meeting: Meeting
    before: float

    def __str__(self) -> str:
        if self.meeting is Meeting.NONE:
            return "the strike met nothing"
        where = f"{abs(self.before) * 1e3:.0f} mm {'before' if self.before > 0 else 'beyond'} the nail"
        return f"the tool hit something {where}"


def judge_contact(
    report: MotionReport, expected: ExpectedContact, arm: ArmKinematics, config: SupervisorConfig
) -> ContactVerdict:
    """Compare the measured joints at the contact with the expected ones, along the strike's direction."""
    if report.contact is None:
        return ContactVerdict(Meeting.NONE, float("nan"))
    place, met = arm.fk(np.stack([expected.q, report.contact.q]))[:, :3, 3]
    before = float(expected.direction @ (place - met))
    if before > config.early_contact:
        return ContactVerdict(Meeting.EARLY, before)
    return ContactVerdict(Meeting.LATE if before < -config.late_contact else Meeting.EXPECTED, before)

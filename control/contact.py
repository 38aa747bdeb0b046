"""Expected and actual contact of a strike, compared by joint positions, since a servo's lag makes times unreliable."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from toolee_robot.control.kinematics import ArmKinematics
from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport
from toolee_robot.station import SupervisorConfig


class Meeting(StrEnum):
    """How a strike met its target."""

    EXPECTED = "expected"
    EARLY = "early"
    LATE = "late"
    NONE = "none"


@dataclass(frozen=True)
class ExpectedContact:
    """Where and when tool and work should meet.

    Attributes:
        q: Joint positions at the contact, (6,) [rad].
        direction: Direction of the tool's motion, a unit vector in `base`, (3,).
        time: Time of the contact on the trajectory [s].
    """

    q: Array
    direction: Array
    time: float


@dataclass(frozen=True)
class ContactVerdict:
    """Comparison of an actual contact with the expected one.

    Attributes:
        meeting: How the strike met its target.
        before: Distance before the expected contact at which the tool was stopped [m]; negative beyond it, NaN without
            contact.
    """

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
    """Compare the measured joint positions at the contact with the expected ones, along the strike's direction.

    Args:
        report: The executed strike.
        expected: The expected contact.
        arm: Kinematics of the arm.
        config: Bounds of an early and a late contact.

    Returns:
        How the contact came, and how far before the expected one [m]; NaN without a contact.
    """
    if report.contact is None:
        return ContactVerdict(Meeting.NONE, float("nan"))
    place, met = arm.fk(np.stack([expected.q, report.contact.q]))[:, :3, 3]
    before = float(expected.direction @ (place - met))
    if before > config.early_contact:
        return ContactVerdict(Meeting.EARLY, before)
    return ContactVerdict(Meeting.LATE if before < -config.late_contact else Meeting.EXPECTED, before)

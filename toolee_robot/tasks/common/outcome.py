"""How a hammering job can end, and the record of one."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from toolee_robot.control.contact import Meeting
from toolee_robot.types import InHandEstimate


class Outcome(StrEnum):
    """Every ending has a name. Only FLUSH is success; all of them leave the arm at a standstill.

    INTERRUPTED is named by whoever runs the task: the interrupt passes through it, once the arm has been stopped.
    """

    FLUSH = "flush"
    BENT = "bent"
    STUCK = "stuck"
    OUT_OF_STRIKES = "out_of_strikes"
    NOT_READY = "not_ready"
    NO_HANDOVER = "no_handover"
    NO_GRIP = "no_grip"
    TOOL_LOST = "tool_lost"
    TOOL_SLIPPED = "tool_slipped"
    POSE_UNKNOWN = "pose_unknown"
    NO_PLAN = "no_plan"
    NAIL_MISSED = "nail_missed"
    PERSON_NEAR = "person_near"
    DEVICE_FAULT = "device_fault"
    INTERRUPTED = "interrupted"


class JobEnded(Exception):
    """The job is over, for a reason that has a name."""

    def __init__(self, outcome: Outcome, reason: str) -> None:
        super().__init__(reason)
        self.outcome = outcome


class Stage(StrEnum):
    """The stages of the job, in the order in which they first come."""

    HANDOVER = "handover"
    GRIP = "grip"
    VIEW = "view"
    PERCEIVE = "perceive"
    PLAN = "plan"
    TOUCH = "touch"
    STRIKE = "strike"
    PARK = "park"


@dataclass(frozen=True)
class Strike:
    """One strike as the robot knows it: stamp [s], planned face speed [m/s], peak sensed force [N], how it met the
    nail, and the protrusion [m] of the head over the wood that the touch after it measured; None where it could not."""

    number: int
    stamp: float
    speed: float
    peak_force: float
    meeting: Meeting
    protrusion: float | None


@dataclass(frozen=True)
class HammerResult:
    """The whole job. protrusion [m] is what the robot measured last; stage_seconds are wall-clock."""

    outcome: Outcome
    reason: str
    strikes: tuple[Strike, ...]
    protrusion: float | None
    estimates: tuple[tuple[float, InHandEstimate], ...] = ()
    stage_seconds: dict[str, float] = field(default_factory=dict)

    @property
    def success(self) -> bool:
        return self.outcome is Outcome.FLUSH

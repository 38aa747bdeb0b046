"""Outcomes of a hammering job, the record of one, and stops with the tool in the hand: how many, and what then."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum

from toolee_robot.control.arm_dynamics import StrikeLoad
from toolee_robot.control.contact import Meeting
from toolee_robot.control.tool_weight import ToolWeight
from toolee_robot.errors import DeviceError
from toolee_robot.types import InHandEstimate


class Outcome(StrEnum):
    """How a job ended. Only FLUSH and TIGHTENED are success; every outcome leaves the arm at a standstill.

    INTERRUPTED is set by the caller of the task: the task stops the arm and lets the KeyboardInterrupt pass.
    """

    FLUSH = "flush"
    BENT = "bent"
    STUCK = "stuck"
    OUT_OF_STRIKES = "out_of_strikes"
    TIGHTENED = "tightened"
    ALREADY_TIGHT = "already_tight"
    SLIPPED_OFF = "slipped_off"
    NOT_TIGHT = "not_tight"
    OUT_OF_REACH = "out_of_reach"
    NOT_READY = "not_ready"
    NO_HANDOVER = "no_handover"
    NO_GRIP = "no_grip"
    TOOL_LOST = "tool_lost"
    TOOL_SLIPPED = "tool_slipped"
    WEIGHT_UNKNOWN = "weight_unknown"
    POSE_UNKNOWN = "pose_unknown"
    NO_PLAN = "no_plan"
    NAIL_MISSED = "nail_missed"
    OVERLOAD = "overload"
    PERSON_NEAR = "person_near"
    DEVICE_FAULT = "device_fault"
    INTERRUPTED = "interrupted"


class JobEnded(Exception):
    """Raised inside a task to end the job.

    Args:
        outcome: How the job ends.
        reason: Why, for the person at the station.

    Attributes:
        outcome: How the job ends.
    """

    def __init__(self, outcome: Outcome, reason: str) -> None:
        super().__init__(reason)
        self.outcome = outcome


class Stage(StrEnum):
    """Stages of the job, in the order of their first occurrence."""

    HANDOVER = "handover"
    GRIP = "grip"
    WEIGH = "weigh"
    VIEW = "view"
    PERCEIVE = "perceive"
    PLAN = "plan"
    TOUCH = "touch"
    STRIKE = "strike"
    TURN = "turn"
    PARK = "park"


@dataclass(frozen=True)
class Strike:
    """One strike as the robot measured it.

    Attributes:
        number: Number of the strike on its nail, from 1.
        stamp: Time of the contact, or of the end of the motion without one, on the station's clock [s].
        speed: Planned speed of the face at the contact [m/s].
        deepest: Largest distance of the face beyond the expected contact, by the commands that were sent [m].
        peak_force: Largest sensed force at the flange [N].
        meeting: How the strike met the nail.
        load: What the strike asked of the arm.
        protrusion: Height of the nail's head over the wood that the touch after the strike measured [m]; None where it
            was not measured, or could not be.
    """

    number: int
    stamp: float
    speed: float
    deepest: float
    peak_force: float
    meeting: Meeting
    load: StrikeLoad
    protrusion: float | None


@dataclass(frozen=True)
class NailResult:
    """What became of one nail.

    Attributes:
        name: Its name.
        outcome: How its driving ended; None where it was not begun.
        reason: Why it ended so, for a person; empty where it was not begun.
        strikes: The strikes on it, in order.
        protrusion: Height of its head over the wood as measured last [m]; None where it was not.
        seconds: Time that it took from the first look's end on [s], station clock.
    """

    name: str
    outcome: Outcome | None
    reason: str
    strikes: tuple[Strike, ...] = ()
    protrusion: float | None = None
    seconds: float = 0.0


@dataclass(frozen=True)
class TaskResult:
    """What every task returns.

    Attributes:
        outcome: How the job ended.
        reason: Why it ended so, for a person.
        stage: The stage in which it ended, before the tool was parked; None where it ended before the first one.
        estimates: Fused poses of the end effector in the hand, each with its time on the station's clock [s].
        stage_seconds: Wall-clock time spent in each stage [s], by the stage's name.
        robot_seconds: Time that the job took on the station's clock [s].
        stops: Number of times that the arm was stopped with the tool in the hand.
        fault: Error of a device, or of a person in the way, that ended it; None where none did.
    """

    outcome: Outcome
    reason: str
    _: KW_ONLY
    stage: Stage | None = None
    estimates: tuple[tuple[float, InHandEstimate], ...] = ()
    stage_seconds: dict[str, float] = field(default_factory=dict)
    robot_seconds: float = 0.0
    stops: int = 0
    fault: DeviceError | None = None


@dataclass(frozen=True)
class HammerResult(TaskResult):
    """Result of a hammering job.

    With several nails its outcome is FLUSH where every one is flush, else what stopped the job, or how the first that
    is not flush ended.

    Attributes:
        strikes: The strikes in order, on all nails.
        protrusion: Height of the head of the nail struck last over the wood as measured last [m]; None before the first
            strike.
        nail_seconds: Part of `robot_seconds` in which nails were driven: with one, all after the first look at the tool
            [s].
        nails: What became of each nail that was to be driven.
        weight: What the arm has weighed of the tool; None where it was told.
    """

    strikes: tuple[Strike, ...]
    protrusion: float | None
    nail_seconds: float = 0.0
    nails: tuple[NailResult, ...] = ()
    weight: ToolWeight | None = None

    @property
    def success(self) -> bool:
        """Whether every nail that was to be driven is flush."""
        return self.outcome is Outcome.FLUSH


MAX_STOPS = 3
"""Number of stops with the tool in the hand that end a session."""
_STANDS = "the arm stands still"
PUT_AWAY = f"{_STANDS}. Put it away by hand"
"""What to do about an arm that stands without a tool."""
RESUME = (
    f"{_STANDS} with the tool in the hand. Check robot, hand and tool, and make the robot ready. Then resume the "
    "job, or hold the tool and have the hand opened, or put it away by hand"
)
"""What to do about a stop that can be cleared."""
TAKE_OUT = (
    f"{_STANDS} with the tool in the hand. Hold the tool, then have the hand opened (`give_back` of the task, or "
    "the hand's own software). Nothing opens it by itself"
)
"""What to do about a stop that cannot be cleared, or that ends the session."""


def cause(reason: str) -> str:
    """What ended a job, without what a person is to do about the arm.

    Args:
        reason: Why it ended, as a result tells it.

    Returns:
        The cause.
    """
    return reason.partition(f"; {_STANDS}")[0]


class Stops:
    """Counts the stops of a session.

    Attributes:
        count: Number of stops with the tool in the hand so far.
    """

    def __init__(self) -> None:
        self.count = 0

    @property
    def last(self) -> bool:
        """Whether the session has ended because of its stops."""
        return self.count >= MAX_STOPS

    def add(self, reason: str) -> str:
        """Count a stop with the tool in the hand.

        Args:
            reason: Why the arm was stopped.

        Returns:
            The reason, and what a person can do.
        """
        self.count += 1
        if self.last:
            return f"{reason}; stop {self.count} of {MAX_STOPS} ends the session. Find the cause; {TAKE_OUT}"
        return f"{reason}; {RESUME}"

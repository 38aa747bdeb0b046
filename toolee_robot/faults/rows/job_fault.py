"""A fault of the job: where it comes, what it does, and what the job must do then."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from toolee_robot.control.contact import Meeting
from toolee_robot.faults.record import Phase
from toolee_robot.faults.rigs.job_rig import Bench, Log
from toolee_robot.faults.rigs.scripted_perception import ScriptedPerception
from toolee_robot.tasks.common.outcome import Outcome, Stage

IN_STRIKE = "in mid-swing"


@dataclass
class Scene:
    """What a fault may touch. undo: what has to be put back that the bench's `reset` does not know of. happened: when
    the fault came [s], if that is not when it was injected."""

    bench: Bench
    log: Log
    perception: ScriptedPerception
    undo: list[Callable[[], None]] = field(default_factory=list)
    happened: float | None = None


@dataclass(frozen=True)
class Braking:
    """A strike that must end before its end. cycles: of the arm, that noticing the fault may take; None where what
    notices it runs in real time, which the simulation's is not. arm_off: whether the joints themselves cannot be on the
    path, whatever they are told."""

    cycles: float | None
    arm_off: bool = False


@dataclass(frozen=True)
class JobFault:
    """number, fault, phase, expected: as in `FaultRow`. inject: does it. when: the stage at whose beginning, or the
    motion after whose end; IN_STRIKE: in mid-swing, `before` [s] before the face meets the nail; None: before the job.

    What must come of it. outcome and message, which the reason must contain. swings: how many strikes are swung, with
    that which the fault disturbs. last: of the motions; None: no motion at all. keeps: the hand still holds the tool.
    braking: of the strike in which it comes, None where that goes on to its end. job_latches, arm_latches: which of
    them refuse to move until a reset; person: who must make the robot ready before that. looks_again: another look was
    tried. meetings: of the strikes. Then, sees: whether the job looks at all; max_strikes: as many as it may make."""

    number: int
    fault: str
    phase: Phase
    expected: str
    inject: Callable[[Scene], object]
    when: Stage | str | None
    outcome: Outcome
    message: str
    swings: int
    last: str | None
    keeps: bool = True
    braking: Braking | None = None
    job_latches: bool = False
    arm_latches: bool = False
    person: bool = False
    looks_again: bool = False
    meetings: tuple[Meeting, ...] | None = None
    sees: bool = False
    max_strikes: int = 1
    before: float = 0.06

"""Record of a fault of the job: its injection, and the required reaction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from tests.faults.record import Phase
from tests.rigs.job_rig import Bench, Log
from tests.rigs.panel import Panel
from tests.rigs.scripted_perception import ScriptedPerception
from toolee_robot.control.contact import Meeting
from toolee_robot.tasks.common.outcome import Outcome, Stage

IN_STRIKE = "in mid-swing"
"""Value of `JobFault.when` for a fault during the strike."""


@dataclass
class Scene:
    """What the injection of a fault may change.

    Attributes:
        bench: The station.
        log: Observer of the job.
        perception: Perception of the job.
        undo: Actions that revert what the bench's `reset` does not.
        happened: Time of the fault, if it is not that of its injection [s].
        panel: Wiring of door and switch, where the station knows its person by digital inputs.
    """

    bench: Bench
    log: Log
    perception: ScriptedPerception
    undo: list[Callable[[], None]] = field(default_factory=list)
    happened: float | None = None
    panel: Panel | None = None


@dataclass(frozen=True)
class Braking:
    """A strike that must be stopped before its end.

    Attributes:
        cycles: Largest number of the arm's cycles until the fault is detected; None where the detection runs in real
            time rather than in simulated time.
        arm_off: Whether the fault itself keeps the joints off the path.
    """

    cycles: float | None
    arm_off: bool = False


@dataclass(frozen=True)
class JobFault:
    """A fault of the job and the required reaction.

    Attributes:
        inject: Injects the fault.
        when: Stage at whose start, or motion after whose end the fault is injected; IN_STRIKE for the strike, None for
            before the job.
        outcome: Required outcome of the job.
        message: Text that the outcome's reason must contain.
        swings: Required number of strikes, including the disturbed one.
        last: Name of the required last motion; None for no motion at all.
        keeps: Whether the hand must still hold the tool.
        braking: Required stop of the disturbed strike; None where it continues to its end.
        job_latches: Whether the job's supervisor must latch.
        arm_latches: Whether the arm must latch.
        person: Whether a person must make the robot ready before a reset.
        looks_again: Whether the job must look again.
        meetings: Required meetings of the strikes; None for any.
        sees: Whether the job looks at the tool at all.
        max_strikes: Largest number of strikes of the job.
        before: Time before the contact at which a fault of the strike is injected [s].
        prepare: Prepares the station before the job; None for nothing.
        resumes: Whether the job must go on after a person's reset, and strike once more.
        code: Required code of the device's error that ends it; empty for any, or none.
    """

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
    prepare: Callable[[Scene], object] | None = None
    resumes: bool = False
    code: str = ""

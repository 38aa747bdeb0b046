"""Record of a fault of the job: its injection, and the required reaction."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field

from tests.faults.record import Phase
from tests.rigs.job_rig import Bench, Log
from tests.rigs.panel import ALL, DOOR_CLOSED, ONE_CONTACT, SWITCH_HELD, TWO_CONTACTS, Operator, Panel
from tests.rigs.people import ScriptedPerception
from toolee_robot.control.contact import Meeting
from toolee_robot.devices.person import DigitalInputPerson
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import PersonConfig
from toolee_robot.tasks.common.outcome import Outcome, Stage

IN_STRIKE = "in mid-swing"
"""Value of `JobFault.when` for a fault during the strike."""


@dataclass
class Scene:
    """What the injection of a fault may change."""

    bench: Bench
    log: Log
    perception: ScriptedPerception
    undo: list[Callable[[], None]] = field(default_factory=list)
    happened: float | None = None
    panel: Panel | None = None


@dataclass(frozen=True)
class Braking:
    """A strike that must be stopped before its end."""

    cycles: float | None
    arm_off: bool = False


@dataclass(frozen=True)
class JobFault:
    """A fault of the job and the required reaction."""

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


REST, SWING = Phase.REST, Phase.SWING
RUN_UP = "to the run-up"
FAULT, LOST, NEAR, DONE = Outcome.DEVICE_FAULT, Outcome.TOOL_LOST, Outcome.PERSON_NEAR, Outcome.OUT_OF_STRIKES
NO_ANSWER = "asks the person; without an answer nothing moves"
RESUMED = "latches; goes on after a person's reset, with a new look"


def _blink(s: Scene) -> None:
    s.bench.hand.blinks = 1


def _drop_unanswered(s: Scene) -> None:
    s.bench.people.inspects = False
    s.bench.drop()


def _at_inputs(config: PersonConfig, high: int = 0, low: int = 0) -> Callable[[Scene], None]:
    """Let the station know its person by digital inputs, some of them stuck."""

    def wire(s: Scene) -> None:
        panel = Panel()
        panel.high, panel.low = high, low
        person = DigitalInputPerson(config, panel.read, HostClock(), Operator(panel).tell)
        # The inputs are read by a thread, in real time, which a simulation that never waits would starve.
        stack = ExitStack()
        s.bench.person = stack.enter_context(person)
        stack.enter_context(s.bench.in_real_time())
        s.undo.append(stack.close)
        s.panel = panel

    return wire


def _unplug(s: Scene) -> None:
    assert s.panel is not None
    s.panel.low = ALL


def _open_with_a_stuck_contact(s: Scene) -> None:
    assert s.panel is not None
    s.panel.high = DOOR_CLOSED
    s.panel.closed = False


GRIP_DOUBTS = (
    JobFault(21, "one bad reading of the grip", REST, "asks the hand again, goes on", _blink, RUN_UP, DONE,
             "after 1 strikes", 1, "home"),
    JobFault(21, "one bad reading of the grip", SWING, "brakes on the path, asks the hand again, looks again, goes on",
             _blink, IN_STRIKE, DONE, "after 1 strikes", 2, "home", braking=Braking(None), looks_again=True, sees=True,
             before=0.15),
    JobFault(21, "tool dropped, nobody answers", REST, NO_ANSWER, _drop_unanswered, RUN_UP, LOST, "nobody allowed",
             0, RUN_UP, keeps=False),
    JobFault(21, "tool dropped, nobody answers", SWING, "brakes on the path, " + NO_ANSWER, _drop_unanswered, IN_STRIKE,
             LOST, "nobody allowed", 1, "strike", braking=Braking(None), keeps=False, before=0.15),
)  # fmt: skip
INPUTS = (
    JobFault(27, "door contact stuck closed", REST, "no fast motion", _at_inputs(ONE_CONTACT, high=DOOR_CLOSED), None,
             NEAR, "nobody was seen within reach", 0, "to the handover"),
    JobFault(27, "door contact stuck closed", SWING, "brakes as the door opens, latches", _open_with_a_stuck_contact,
             IN_STRIKE, NEAR, "within the arm's reach", 1, "strike", braking=Braking(None), job_latches=True,
             before=0.3, prepare=_at_inputs(TWO_CONTACTS)),
    JobFault(27, "hold-to-run switch stuck", REST, "no motion", _at_inputs(ONE_CONTACT, high=SWITCH_HELD), None, NEAR,
             "not pressed anew", 0, None),
    JobFault(27, "door and switch unplugged", REST, "no motion", _at_inputs(ONE_CONTACT, low=ALL), None, NEAR,
             "not pressed anew", 0, None),
    JobFault(27, "door and switch unplugged", SWING, "brakes on the path, latches", _unplug, IN_STRIKE, NEAR,
             "within the arm's reach", 1, "strike", braking=Braking(None), job_latches=True, before=0.3,
             prepare=_at_inputs(ONE_CONTACT)),
)  # fmt: skip
RESUMES = (
    JobFault(12, "protective stop, then a reset", REST, RESUMED, lambda s: s.bench.arm.protective_stop(), RUN_UP, FAULT,
             "protective stop", 0, RUN_UP, arm_latches=True, person=True, sees=True, resumes=True),
    JobFault(12, "protective stop, then a reset", SWING, RESUMED, lambda s: s.bench.arm.protective_stop(), IN_STRIKE,
             FAULT, "protective", 1, "strike", braking=Braking(1), job_latches=True, arm_latches=True, person=True,
             sees=True, resumes=True),
    JobFault(27, "a person comes and goes, then a reset", SWING, RESUMED, lambda s: s.bench.people.step_in(), IN_STRIKE,
             NEAR, "within the arm's reach", 1, "strike", braking=Braking(None), job_latches=True, before=0.3,
             sees=True, resumes=True),
)  # fmt: skip

"""Faults of each hand on each of its wires, through its own driver and its emulator, under the job.

The fault happens to the emulated hand or to its line; the job must answer it with the arm at rest and the grip kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from tests.faults.record import FaultRow, Measurement, Phase
from tests.faults.rows.job import job_row
from tests.faults.rows.job_fault import IN_STRIKE, Braking, JobFault, Scene
from tests.rigs.hand_rig import HANDS, DriverHand
from tests.rigs.job_rig import CONFIG, Bench
from tests.rigs.wired_hands import WiredHand
from toolee_robot.errors import DeviceError
from toolee_robot.robots.hands.inspire import INSPIRE
from toolee_robot.robots.hands.shadow import SHADOW
from toolee_robot.sim_backend.hands.kit import EmulatedHand, HandEmulator, LineFault, happen
from toolee_robot.tasks.common.outcome import Outcome, Stage

REST, SWING = Phase.REST, Phase.SWING
RUN_UP = "to the run-up"
FAULT, LOST, WENT_ON = Outcome.DEVICE_FAULT, Outcome.TOOL_LOST, Outcome.OUT_OF_STRIKES
NO_START = "no start, arm stands"
NO_GRIP = "no grip, arm stands"
NO_STRIKE = "no strike, arm stands, grip kept"
BRAKES = "brakes on the path, arm stands, grip kept"
RETREATS = "brakes on the path, aborts, asks the person, then retreats"
GOES_ON = "asks again, the job goes on"
IGNORES = "passes it over, the job goes on"
READS_BACK = "reads them back, the job goes on"
BEFORE = 0.3
"""Time before the contact at which a fault of the strike happens [s]."""
SEEN_TIME, UNHEARD_TIME = 0.5, 1.0
"""Time from a fault at rest until the job goes on, and from one that shows by commands without effect [s]."""

Event = Callable[[HandEmulator[Any], WiredHand], object]


def _is_any(_: WiredHand) -> bool:
    return True


def _is_inspire(kind: WiredHand) -> bool:
    return kind.config.model == INSPIRE


def _is_serial(kind: WiredHand) -> bool:
    return kind.config.port is None and kind.config.model != SHADOW


def _is_told_apart(kind: WiredHand) -> bool:
    """Whether commands are not the questions: an Ability Hand that takes none is a silent one, which is row 15."""
    return kind.unheard is not None


@dataclass(frozen=True)
class HandFault:
    """A fault of a hand or of its line, and the required reaction."""

    number: int
    fault: str
    event: Event
    when: Stage | str | None
    outcome: Outcome
    message: str
    expected: str
    keeps: bool = True
    concerns: Callable[[WiredHand], bool] = _is_any
    unheard: bool = False
    seen: float = SEEN_TIME

    @property
    def phase(self) -> Phase:
        """When it happens."""
        return SWING if self.when == IN_STRIKE else REST


def _mute(e: HandEmulator[Any], _: WiredHand) -> None:
    e.faults.muted = True


def _rates(**rates: float) -> Event:
    """Let this share of all replies be damaged."""

    def noise(e: HandEmulator[Any], _: WiredHand) -> None:
        e.faults.rates = {LineFault(name): rate for name, rate in rates.items()}

    return noise


def _tell(line: str) -> Event:
    return lambda e, _: happen(e, line)


def _jam(e: HandEmulator[Any], kind: WiredHand) -> None:
    happen(e, kind.jams)


def _heat(e: HandEmulator[Any], kind: WiredHand) -> None:
    happen(e, kind.heats)


def _slip(e: HandEmulator[Any], kind: WiredHand) -> None:
    e.slip(kind.slip)


def _unheard(e: HandEmulator[Any], kind: WiredHand) -> None:
    assert kind.unheard is not None
    happen(e, kind.unheard.event)


def _unheard_and_slips(e: HandEmulator[Any], kind: WiredHand) -> None:
    assert kind.unheard is not None
    _unheard(e, kind)
    e.slip(kind.unheard.gives)


NOISE = _rates(corrupt=0.04, short=0.04, garbage=0.08, doubled=0.08)

FAULTS = (
    HandFault(15, "hand silent", _mute, None, FAULT, "hand", NO_START),
    HandFault(15, "hand silent", _mute, Stage.GRIP, FAULT, "hand", NO_GRIP),
    HandFault(15, "hand silent", _mute, RUN_UP, FAULT, "newest state", NO_STRIKE),
    HandFault(15, "hand silent", _mute, IN_STRIKE, FAULT, "newest state", BRAKES),
    HandFault(16, "noise, damaged, short and doubled replies", NOISE, None, WENT_ON, "after 1 strikes", GOES_ON),
    HandFault(16, "damaged replies only", _rates(corrupt=1.0), RUN_UP, FAULT, "newest state", NO_STRIKE),
    HandFault(16, "damaged replies only", _rates(corrupt=1.0), IN_STRIKE, FAULT, "newest state", BRAKES),
    HandFault(16, "replies too late", _rates(late=0.04), None, WENT_ON, "after 1 strikes", GOES_ON),
    HandFault(17, "another's reply before every one", _rates(foreign=1.0), None, WENT_ON, "after 1 strikes", GOES_ON),
    HandFault(17, "echo of every request", _tell("echo"), None, WENT_ON, "after 1 strikes", IGNORES,
              concerns=_is_serial),
    HandFault(18, "finger stalled", _jam, Stage.GRIP, FAULT, "middle", NO_GRIP),
    HandFault(18, "hand too hot", _heat, RUN_UP, FAULT, "too hot", NO_STRIKE),
    HandFault(18, "hand too hot", _heat, IN_STRIKE, FAULT, "too hot", BRAKES),
    HandFault(18, "over current", _tell("error middle 4"), RUN_UP, FAULT, "middle: over current", NO_STRIKE,
              concerns=_is_inspire),
    HandFault(18, "over current", _tell("error middle 4"), IN_STRIKE, FAULT, "middle: over current", BRAKES,
              concerns=_is_inspire),
    HandFault(18, "the hand's own communication fails", _tell("error middle 16"), RUN_UP, FAULT,
              "internal communication", NO_STRIKE, concerns=_is_inspire),
    HandFault(19, "writes not acknowledged", _unheard, Stage.GRIP, FAULT, "", NO_GRIP, concerns=_is_told_apart,
              unheard=True),
    HandFault(19, "writes carried out, not acknowledged", _tell("unacknowledged"), Stage.GRIP, WENT_ON,
              "after 1 strikes", READS_BACK, concerns=_is_inspire),
    HandFault(19, "writes not acknowledged as the tool gives way", _unheard_and_slips, RUN_UP, FAULT, "", NO_STRIKE,
              concerns=_is_told_apart, unheard=True, seen=UNHEARD_TIME),
    HandFault(20, "hand unplugged", _tell("unplug"), None, FAULT, "is gone", NO_START, keeps=False),
    HandFault(20, "hand unplugged", _tell("unplug"), RUN_UP, FAULT, "is gone", NO_STRIKE),
    HandFault(20, "hand unplugged", _tell("unplug"), IN_STRIKE, FAULT, "is gone", BRAKES),
    HandFault(21, "tool slips in the hand", _slip, RUN_UP, FAULT, "slipped", NO_STRIKE),
    HandFault(21, "tool slips in the hand", _slip, IN_STRIKE, FAULT, "slipped", BRAKES),
    HandFault(21, "tool lost", _tell("drop"), RUN_UP, LOST, "lost the tool", "aborts, asks the person, then retreats",
              keeps=False),
    HandFault(21, "tool lost", _tell("drop"), IN_STRIKE, LOST, "lost the tool", RETREATS, keeps=False),
)  # fmt: skip
"""The faults."""
ROWS = tuple((kind, fault) for kind in HANDS for fault in FAULTS if fault.concerns(kind))
"""Each hand, and each fault that it can have."""


def hand_rows(bench: Bench) -> Iterator[Measurement]:
    """Yield each fault of each hand, in a job of its own."""
    for kind, fault in ROWS:
        run = partial(hand_row, fault, kind, bench)
        yield Measurement(fault.number, fault.fault, fault.phase, _on(kind), fault.expected, run)


def hand_row(fault: HandFault, kind: WiredHand, bench: Bench) -> FaultRow:
    """Measure one fault of one hand."""
    bench.reset()
    with DriverHand(bench.sim, bench.sim_hand, kind) as hand:
        told: list[tuple[Any, ...]] = []
        row = job_row(_job_fault(fault, hand, told), bench, hand)
        wrong = [row.why] if row.why else []
        if hand.opened > 1:  # once for the handover
            wrong.append("the hand was told to open")
        if fault.keeps and hand.closed and not _holds(hand):
            wrong.append("the emulated hand let go")
        if fault.unheard and told != [hand.told]:
            wrong.append("the emulated hand took a command")
        if fault.unheard and not _answers(hand):
            wrong.append("the hand has fallen silent")
    return replace(row, on=_on(kind), handled=not wrong, why="; ".join(wrong))


def _holds(hand: DriverHand) -> bool:
    """Whether the emulated fingers are still where the handle is, slipped or not; unplugged, they are out of reach."""
    if not hand.emulator.plugged:
        return True

    def is_near(emulated: EmulatedHand[Any]) -> bool:
        emulated.run()
        motor = emulated.motors[0]
        return motor.met_at is not None and abs(motor.position - motor.met_at) < hand.kind.margin

    return hand.emulator.tell(is_near)


def _answers(hand: DriverHand) -> bool:
    try:
        hand.state()
    except DeviceError:
        return False
    return True


def _job_fault(fault: HandFault, hand: DriverHand, told: list[tuple[Any, ...]]) -> JobFault:
    """The fault of the job; what the hand was told until then is put into `told`."""
    unheard = hand.kind.unheard if fault.unheard else None

    def inject(scene: Scene) -> None:
        fault.event(hand.emulator, hand.kind)
        told.append(hand.told)
        if fault.when == RUN_UP:
            scene.bench.sim.world.advance(fault.seen)

    last: str | None = _LAST[fault.when]
    if fault.outcome is WENT_ON:
        last = "home"
    elif fault.outcome is LOST:
        last = "retreat"
    in_strike = fault.when == IN_STRIKE
    return JobFault(
        fault.number, fault.fault, fault.phase, fault.expected, inject, fault.when, fault.outcome,
        fault.message if unheard is None else unheard.says, int(in_strike or fault.outcome is WENT_ON), last,
        braking=Braking(None) if in_strike else None, before=BEFORE,
        code=unheard.code if unheard is not None and fault.when is Stage.GRIP else "",
    )  # fmt: skip


_LAST: dict[Stage | str | None, str | None] = {
    None: None, Stage.GRIP: "to the handover", RUN_UP: RUN_UP, IN_STRIKE: "strike",
}  # fmt: skip
"""When a fault happens -> the last motion."""


def _on(kind: WiredHand) -> str:
    return f"{kind.label}, simulated {CONFIG.arm.model}"

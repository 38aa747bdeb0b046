"""Faults of the hold-to-run switch on the robot's digital inputs, in front of the real driver.

A slow motion goes on only while the switch is held for certain, and begins only once it was released and taken anew. A
strike does not ask for the switch: one that fails in mid-swing must keep the arm from everything after it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from tests.faults.record import FaultRow, Measurement, Phase
from tests.faults.rows.arm import AT_REST
from tests.faults.rows.bad_commands import good
from tests.faults.rows.inputs import SEEN_TIME, WATCH, set_inputs, swing, wire
from tests.faults.rows.released_stops import travel
from tests.rigs.driver_rig import Rig
from tests.rigs.panel import TWO_CONTACTS
from tests.rigs.time_bounds import PATIENT
from toolee_robot.control.arm_dynamics import bound_stop
from toolee_robot.control.limits import Mode, slowed_to
from toolee_robot.devices.person import PERIOD
from toolee_robot.errors import PersonNearError, TooleeError
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard, HandState, MotionReport, MotionWatch, Person, Station
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.types import JointState, Trajectory

BRAKES = "brakes on the path; no further motion"
GOES_ON = "the swing goes on; no further motion"
REFUSED = "no motion, neither slow nor fast"
ANSWER_TIME = 1.5  # [s] for which the person is asked; who can operate the switch needs 0.5 s
STILL_TIME = 0.3  # [s] until the servo's tail is over
AWAY, LITTLE = 0.6, 0.1  # of the swing's way, backwards: slow motions of some 2 s and 0.4 s
NOT_TAKEN, NOT_CONFIRMED = "person_near.switch_not_taken", "person_near.swing_not_confirmed"


@dataclass(frozen=True)
class SwitchFault:
    """A fault of the hold-to-run switch.

    Attributes:
        inject: Brings it about.
    """

    fault: str
    inject: Callable[[Rig], object]


class _OpenHand:
    """A hand that holds nothing, of which only the joints matter."""

    def __init__(self, q: Array) -> None:
        self._q = q

    def state(self, max_age: float = 0.1) -> HandState:  # noqa: ARG002
        return HandState(JointState(self._q, np.zeros_like(self._q), 0.0), {}, False)


def _hold_fast(rig: Rig) -> None:
    """Let both contacts stay as they are, whatever is done to the switch."""
    for index in (TWO_CONTACTS.hold_to_run_input, TWO_CONTACTS.hold_to_run_released_input):
        rig.controller.fault("stuck_input", index=index)


def _stick_pressed(rig: Rig) -> None:
    set_inputs(rig, hold_to_run=True, hold_to_run_released=False)
    _hold_fast(rig)


def _stick_one_contact(rig: Rig) -> None:
    """Weld the contact that is made while the switch is pressed, then release the switch."""
    set_inputs(rig, hold_to_run=True)
    rig.controller.fault("stuck_input", index=TWO_CONTACTS.hold_to_run_input)
    set_inputs(rig, hold_to_run_released=True)


def _unplug(rig: Rig) -> None:
    set_inputs(rig, hold_to_run=False, hold_to_run_released=False)
    _hold_fast(rig)


ONE_CONTACT = SwitchFault("hold-to-run switch released, one contact stuck pressed", _stick_one_contact)
UNPLUGGED = SwitchFault("hold-to-run switch unplugged", _unplug)
STUCK = SwitchFault("hold-to-run switch stuck pressed", _stick_pressed)
IN_SLOW_MOTION = (ONE_CONTACT, UNPLUGGED)
"""Both contacts that stick at once in a motion cannot be told from a switch that is held: the next one is refused."""
SWITCH_FAULTS = (ONE_CONTACT, UNPLUGGED, STUCK)


def switch_rows(rig: Rig) -> Iterator[Measurement]:
    """Yield each fault of the switch in a slow motion, in mid-swing and at rest."""
    for fault in IN_SLOW_MOTION:
        yield Measurement(27, fault.fault, Phase.SLOW, rig.name, BRAKES, partial(in_slow_motion, fault, rig))
    for fault in SWITCH_FAULTS:
        yield Measurement(27, fault.fault, Phase.SWING, rig.name, GOES_ON, partial(in_swing, fault, rig))
        yield Measurement(27, fault.fault, Phase.REST, rig.name, REFUSED, partial(at_rest, fault, rig))


def in_slow_motion(fault: SwitchFault, rig: Rig) -> FaultRow:
    """Measure a fault of the switch while a person holds it and the arm moves slowly."""
    path = _slow(rig)
    after: list[str] = []

    def execute(motion: Trajectory, _guard: ContactGuard | None, _watch: MotionWatch) -> MotionReport:
        with wire(rig) as person:
            motions = _motions(rig, person)
            motions.begin()
            try:
                return motions.execute("slow motion", motion, None)
            finally:
                after.extend(_not_refused(rig, motions))

    happened = rig.inject(partial(fault.inject, rig), execute=execute, slow=path)
    stop, error = happened.stop, happened.error
    # The inputs' and the supervisor's polling, and the data's way here.
    notice = PERIOD + WATCH + 2 * rig.period
    allowed = notice + rig.setting.braking(path, stop.path_time, notice, rig.swing.config.arm) + 2 * rig.period
    wrong = list(after)
    if not isinstance(error, PersonNearError) or error.code != "person_near.during_motion":
        wrong.append(f"person_near.during_motion expected, got {error!r}")
    if stop.standstill > allowed:
        wrong.append(f"standstill after {stop.standstill * 1e3:.0f} ms, {allowed * 1e3:.0f} allowed")
    if stop.off_path > rig.off_path(stop.path_time, None, notice):
        wrong.append(f"the joints left the path by {stop.off_path:.4f} rad")
    return FaultRow(
        27, fault.fault, Phase.SLOW, rig.name, BRAKES, str(getattr(error, "code", error)), False, not wrong,
        "; ".join(wrong), stop.reaction, stop.standstill, allowed, stop.speed, stop.off_path,
    )  # fmt: skip


def in_swing(fault: SwitchFault, rig: Rig) -> FaultRow:
    """Measure a fault of the switch in a swing, which nobody holds it for."""
    after: list[str] = []

    def execute(_strike: Trajectory, _guard: ContactGuard | None, _watch: MotionWatch) -> MotionReport:
        with wire(rig) as person:
            time.sleep(SEEN_TIME)
            report = swing(rig, person, [])
            after.extend(_not_refused(rig, _motions(rig, person)))
            return report

    happened = rig.inject(partial(fault.inject, rig), execute=execute)
    stop, wrong = happened.stop, list(after)
    if happened.error is not None:
        wrong.append(f"the swing was disturbed: {happened.error!r}")
    elif stop.reached < rig.strike.duration - 2 * rig.period:
        ended = happened.report and happened.report.outcome
        wrong.append(f"the swing did not reach its end: {ended} at {stop.reached:.2f} of {rig.strike.duration:.2f} s")
    if stop.off_path > rig.off_path(stop.path_time, None, 0.0):
        wrong.append(f"the joints left the path by {stop.off_path:.4f} rad")
    return FaultRow(
        27, fault.fault, Phase.SWING, rig.name, GOES_ON, NOT_TAKEN if not after else "; ".join(after), False, not wrong,
        "; ".join(wrong), speed=stop.speed, off_path=stop.off_path,
    )  # fmt: skip


def at_rest(fault: SwitchFault, rig: Rig) -> FaultRow:
    """Measure a fault of the switch while the arm stands."""
    rig.prepare()
    before = rig.controller.state()["tick"]
    with wire(rig) as person:
        time.sleep(SEEN_TIME)
        fault.inject(rig)
        time.sleep(SEEN_TIME)
        wrong = _not_refused(rig, _motions(rig, person))
    got = f"{NOT_TAKEN}, stands still" if not wrong else "; ".join(wrong)
    return FaultRow(
        27, fault.fault, Phase.REST, rig.name, REFUSED, got, False, not wrong, "; ".join(wrong),
        off_path=travel(rig, before),
    )  # fmt: skip


def _slow(rig: Rig) -> Trajectory:
    """A motion from the start of the swing away from the work, at the speed of a handover, as the arm gets it."""
    planned, config = rig.swing, rig.swing.config
    start = rig.strike.q[0]
    way = good(planned, start, AWAY * (start - rig.strike.q[-1]))
    way = slowed_to(way, planned.world, config.supervisor.handover_speed)
    return bound_stop(way, planned.robot, config.arm.model, planned.q_hand, None)


def _motions(rig: Rig, person: Person) -> Motions:
    """The task's motions in HANDOVER mode, with wide bounds, so that a busy machine adds no faults."""
    planned = rig.swing
    task = replace(planned.config.task, handover_timeout=ANSWER_TIME)
    bounds = replace(planned.config.supervisor, data_cycles=PATIENT.data_cycles, overruns=PATIENT.overruns)
    config: StationConfig = replace(planned.config, task=task, supervisor=bounds)
    devices: Any = {"hand": _OpenHand(planned.q_hand), "camera": None}
    station = Station(arm=rig.arm, person=person, clock=HostClock(), **devices)
    motions = Motions(station, config, planned.robot, TaskObserver())
    assert motions.arm.mode is Mode.HANDOVER
    return motions


def _not_refused(rig: Rig, motions: Motions) -> list[str]:
    """What is wrong with the refusal of a slow motion, and of the permission for a fast one, if anything."""
    time.sleep(STILL_TIME)
    before = rig.controller.state()["tick"]
    away = good(rig.swing, rig.q_commanded, LITTLE * (rig.strike.q[0] - rig.strike.q[-1]))
    wrong = []
    attempts: tuple[tuple[str, Callable[[], object]], ...] = (
        (NOT_TAKEN, lambda: motions.transfer("next", away, None)),
        (NOT_CONFIRMED, lambda: motions.arm.permit_swings(ANSWER_TIME)),
    )
    for code, attempt in attempts:
        try:
            attempt()
            wrong.append(f"{code} expected, it was permitted")
        except TooleeError as error:
            if error.code != code:
                wrong.append(f"{code} expected, got {error!r}")
    moved = travel(rig, before)
    if moved > AT_REST:
        wrong.append(f"the arm moved by {moved:.4f} rad with the switch at fault")
    return wrong

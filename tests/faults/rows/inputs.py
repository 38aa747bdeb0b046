"""Faults of door and hold-to-run switch on the robot's digital inputs, in front of the real driver."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from tests.faults.record import FaultRow, Measurement, Phase
from tests.faults.rows.arm import AT_REST
from tests.faults.rows.commands import good
from tests.faults.rows.released_stops import travel
from tests.rigs.driver_rig import Rig
from tests.rigs.joints_path import PATIENT
from tests.rigs.panel import TWO_CONTACTS, later
from toolee_robot.control.arm_dynamics import ArmDynamics, bound_stop
from toolee_robot.control.limits import Mode, slowed_to
from toolee_robot.control.supervisor import Supervisor
from toolee_robot.devices.person import PERIOD, DigitalInputPerson
from toolee_robot.errors import DeviceError, PersonNearError, TooleeError
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard, HandState, MotionReport, MotionWatch, Person, Station
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.ur_controller.faults.fault_port import FaultClient
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.motions import HOLD_SWITCH, Motions
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.watches import PersonProof
from toolee_robot.types import JointState, Trajectory

BRAKES, REFUSED = "brakes on the path, latches", "no motion"
WATCH = 0.01  # [s], polling period of the supervisor
SEEN_TIME = 0.15  # [s] after which the inputs count
ANSWER_TIME = 3.0  # [s]


@dataclass(frozen=True)
class InputFault:
    """A fault of what is wired to the digital inputs."""

    fault: str
    inject: Callable[[Rig], object]


def set_inputs(rig: Rig, **high: bool) -> None:
    """Set inputs of the stand-in, from any thread, as people do."""
    with FaultClient(rig.controller.host) as robot:
        for name, value in high.items():
            robot.fault("digital_input", index=getattr(TWO_CONTACTS, f"{name}_input"), high=value)


def _stick_closed(rig: Rig) -> None:
    """Bridge the door's contacts, then open the door, which nothing tells."""
    for index in (TWO_CONTACTS.door_closed_input, TWO_CONTACTS.door_open_input):
        rig.controller.fault("stuck_input", index=index)
    set_inputs(rig, door_closed=False, door_open=True)


def _stick_one_contact(rig: Rig) -> None:
    """Weld the contact that is made while the door is closed, then open the door."""
    rig.controller.fault("stuck_input", index=TWO_CONTACTS.door_closed_input)
    set_inputs(rig, door_closed=False, door_open=True)


IN_SWING = (
    InputFault("door opens, on the digital inputs", lambda r: set_inputs(r, door_closed=False, door_open=True)),
    InputFault("door's cable is pulled", lambda r: set_inputs(r, door_closed=False)),
    InputFault("door opens, one contact stuck closed", _stick_one_contact),
)
AT_STANDSTILL = (
    *IN_SWING,
    InputFault("door's inputs stuck closed", _stick_closed),
)


def input_rows(rig: Rig) -> Iterator[Measurement]:
    """Yield each fault of the inputs, in mid-swing and at rest."""
    for fault in IN_SWING:
        yield Measurement(27, fault.fault, Phase.SWING, rig.name, BRAKES, partial(_in_swing, fault, rig))
    for fault in AT_STANDSTILL:
        yield Measurement(27, fault.fault, Phase.REST, rig.name, REFUSED, partial(_at_rest, fault, rig))


def wire(rig: Rig) -> DigitalInputPerson:
    """Make a person on the stand-in's inputs, who has closed the door and released the switch."""

    def switch(held: bool) -> None:
        set_inputs(rig, hold_to_run=held, hold_to_run_released=not held)
        time.sleep(SEEN_TIME)

    def take() -> None:
        switch(False)
        switch(True)

    def press() -> None:
        take()
        switch(False)

    def tell(prompt: str) -> None:
        later(take if prompt == HOLD_SWITCH else press, SEEN_TIME)

    set_inputs(rig, door_closed=True, door_open=False, hold_to_run=False, hold_to_run_released=True)
    return DigitalInputPerson(TWO_CONTACTS, lambda age: rig.arm.state(age).digital_inputs, HostClock(), tell)


def swing(rig: Rig, person: DigitalInputPerson | PersonProof, latched: list[str]) -> MotionReport:
    """Swing under a supervisor, once the person has confirmed it."""
    planned, plan = rig.swing, rig.swing.plan
    # Wide bounds, so that a busy machine adds no faults.
    bounds = replace(planned.config.supervisor, data_cycles=PATIENT.data_cycles, overruns=PATIENT.overruns)
    config = replace(planned.config, supervisor=bounds)
    supervisor = Supervisor(rig.arm, person, planned.robot, config, world=lambda: planned.world)
    guard = rig.contact_guard()
    try:
        supervisor.mode = Mode.UNATTENDED
        supervisor.permit_swings(ANSWER_TIME)
        return supervisor.swing(rig.strike, guard, plan.expected_contact)[0]
    finally:
        latched.append(str(supervisor.latched or ""))


def _in_swing(fault: InputFault, rig: Rig) -> FaultRow:
    latched: list[str] = []

    def execute(_strike: Trajectory, _guard: ContactGuard | None, _watch: MotionWatch) -> MotionReport:
        with wire(rig) as person:
            time.sleep(SEEN_TIME)
            return swing(rig, person, latched)

    happened = rig.inject(partial(fault.inject, rig), execute=execute)
    stop, limits = happened.stop, rig.swing.config.arm
    # The inputs' and the supervisor's polling, and the data's way here.
    notice = PERIOD + WATCH + 2 * rig.period
    allowed = notice + rig.setting.braking(rig.strike, stop.path_time, notice, limits) + 2 * rig.period
    wrong = []
    if not isinstance(happened.error, PersonNearError):
        wrong.append(f"PersonNearError expected, got {happened.error!r}")
    if not any(latched):
        wrong.append("it did not latch")
    if stop.standstill > allowed:
        wrong.append(f"standstill after {stop.standstill * 1e3:.0f} ms, {allowed * 1e3:.0f} allowed")
    if stop.off_path > rig.off_path(stop.path_time, None, notice):
        wrong.append(f"the joints left the path by {stop.off_path:.4f} rad")
    return FaultRow(
        27, fault.fault, Phase.SWING, rig.name, BRAKES, type(happened.error).__name__, any(latched), not wrong,
        "; ".join(wrong), stop.reaction, stop.standstill, allowed, stop.speed, stop.off_path,
    )  # fmt: skip


def _at_rest(fault: InputFault, rig: Rig) -> FaultRow:
    rig.prepare()
    before = rig.controller.state()["tick"]
    latched: list[str] = []
    got: object = None
    with wire(rig) as person:
        time.sleep(SEEN_TIME)
        fault.inject(rig)
        time.sleep(SEEN_TIME)
        try:
            got = swing(rig, PersonProof(person), latched)
        except DeviceError as error:
            got = error
    moved = travel(rig, before)
    wrong = [] if isinstance(got, PersonNearError) else [f"PersonNearError expected, got {got!r}"]
    if moved > AT_REST:
        wrong.append(f"the arm moved by {moved:.4f} rad")
    return FaultRow(
        27, fault.fault, Phase.REST, rig.name, REFUSED, f"{getattr(got, 'code', got)}, stands still", any(latched),
        not wrong, "; ".join(wrong), off_path=moved,
    )  # fmt: skip


BRAKES_SWITCH = "brakes on the path; no further motion"
GOES_ON = "the swing goes on; no further motion"
REFUSED_SWITCH = "no motion, neither slow nor fast"
ANSWER_TIME_SWITCH = 1.5  # [s] for which the person is asked; who can operate the switch needs 0.5 s
STILL_TIME = 0.3  # [s] until the servo's tail is over
AWAY, LITTLE = 0.6, 0.1  # of the swing's way, backwards: slow motions of some 2 s and 0.4 s
NOT_TAKEN, NOT_CONFIRMED = "person_near.switch_not_taken", "person_near.swing_not_confirmed"


@dataclass(frozen=True)
class SwitchFault:
    """A fault of the hold-to-run switch."""

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


def _stick_one_contact_of_switch(rig: Rig) -> None:
    """Weld the contact that is made while the switch is pressed, then release the switch."""
    set_inputs(rig, hold_to_run=True)
    rig.controller.fault("stuck_input", index=TWO_CONTACTS.hold_to_run_input)
    set_inputs(rig, hold_to_run_released=True)


def _unplug(rig: Rig) -> None:
    set_inputs(rig, hold_to_run=False, hold_to_run_released=False)
    _hold_fast(rig)


ONE_CONTACT = SwitchFault("hold-to-run switch released, one contact stuck pressed", _stick_one_contact_of_switch)
UNPLUGGED = SwitchFault("hold-to-run switch unplugged", _unplug)
STUCK = SwitchFault("hold-to-run switch stuck pressed", _stick_pressed)
IN_SLOW_MOTION = (ONE_CONTACT, UNPLUGGED)
"""Both contacts that stick at once in a motion cannot be told from a switch that is held: the next one is refused."""
SWITCH_FAULTS = (ONE_CONTACT, UNPLUGGED, STUCK)


def switch_rows(rig: Rig) -> Iterator[Measurement]:
    """Yield each fault of the switch in a slow motion, in mid-swing and at rest."""
    for fault in IN_SLOW_MOTION:
        yield Measurement(27, fault.fault, Phase.SLOW, rig.name, BRAKES_SWITCH, partial(in_slow_motion, fault, rig))
    for fault in SWITCH_FAULTS:
        yield Measurement(27, fault.fault, Phase.SWING, rig.name, GOES_ON, partial(in_swing, fault, rig))
        yield Measurement(27, fault.fault, Phase.REST, rig.name, REFUSED_SWITCH, partial(at_rest, fault, rig))


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
        27, fault.fault, Phase.SLOW, rig.name, BRAKES_SWITCH, str(getattr(error, "code", error)), False, not wrong,
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
        27, fault.fault, Phase.REST, rig.name, REFUSED_SWITCH, got, False, not wrong, "; ".join(wrong),
        off_path=travel(rig, before),
    )  # fmt: skip


def _slow(rig: Rig) -> Trajectory:
    """A motion from the start of the swing away from the work, at the speed of a handover, as the arm gets it."""
    planned, config = rig.swing, rig.swing.config
    start = rig.strike.q[0]
    way = good(planned, start, AWAY * (start - rig.strike.q[-1]))
    way = slowed_to(way, planned.world, config.supervisor.handover_speed)
    return bound_stop(way, ArmDynamics.with_payload(planned.robot, planned.q_hand, None), config.arm.model)


def _motions(rig: Rig, person: Person) -> Motions:
    """The task's motions in HANDOVER mode, with wide bounds, so that a busy machine adds no faults."""
    planned = rig.swing
    task = replace(planned.config.task, handover_timeout=ANSWER_TIME_SWITCH)
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
        (NOT_CONFIRMED, lambda: motions.arm.permit_swings(ANSWER_TIME_SWITCH)),
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

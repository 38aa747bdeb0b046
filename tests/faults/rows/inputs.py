"""Faults of door and hold-to-run switch on the robot's digital inputs, in front of the real driver."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

from tests.faults.record import FaultRow, Measurement, Phase
from tests.faults.rows.arm import AT_REST
from tests.faults.rows.released_stops import travel
from tests.rigs.driver_rig import Rig
from tests.rigs.panel import TWO_CONTACTS, later
from tests.rigs.time_bounds import PATIENT
from toolee_robot.control.limits import Mode
from toolee_robot.control.supervisor import Supervisor
from toolee_robot.devices.person import PERIOD, DigitalInputPerson
from toolee_robot.errors import DeviceError, PersonNearError
from toolee_robot.hal import ContactGuard, MotionReport, MotionWatch
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.ur_controller.faults.client import FaultClient
from toolee_robot.tasks.common.motions import HOLD_SWITCH
from toolee_robot.tasks.common.watches import PersonProof
from toolee_robot.types import Trajectory

BRAKES, REFUSED = "brakes on the path, latches", "no motion"
WATCH = 0.01  # [s], polling period of the supervisor
SEEN_TIME = 0.15  # [s] after which the inputs count
ANSWER_TIME = 3.0  # [s]


@dataclass(frozen=True)
class InputFault:
    """A fault of what is wired to the digital inputs.

    Attributes:
        inject: Brings it about.
    """

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

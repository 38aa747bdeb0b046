"""Release and Play after every kind of stop: nothing may move.

A protective stop, a safeguard stop and a pause at the pendant only pause a program, with its motion. Whoever then
presses Play, or on some CB3 robots closes the safeguard, would send the arm on to its last target, so the driver ends
the program at once, also where its link is lost around the stop. An emergency stop, a violation and a fault end the
program by themselves and leave the arm off: it is switched on before Play is pressed. Judged on the joints of the
stand-in.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from tests.faults.record import FaultRow, Measurement, Phase
from tests.faults.rows.arm import AT_REST, REST_TIME
from tests.rigs.driver_rig import Rig, StopKind
from toolee_robot.devices.ur.protocols.tcp import DASHBOARD_PORT
from toolee_robot.errors import DeviceError, EmergencyStopError, MotionFaultError, ProtectiveStopError
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess

EXPECTED = "the robot's program is ended; nothing moves after release and Play; latched"
PLAY_TIME = 0.6  # [s] of observation after Play: a resumed swing would be over
DOOR = 0  # digital input of the door
BLINK = 0.06  # [s] for which a light curtain is broken
PAUSE_SLEW = 0.25  # [s] in which a pause at the pendant brings the arm to rest
LINK_GAP = 0.01  # [s] from the loss of the link to the stop: well below the watchdog's time
ANSWER_TIME, POWER_TIME = 2.0, 5.0  # [s] of the dashboard server, and until the arm is on


@dataclass(frozen=True)
class ReleasedStop:
    """A stop and its release."""

    number: int
    fault: str
    stop: Callable[[ControllerProcess], object]
    release: Callable[[ControllerProcess], object]
    error: type[MotionFaultError]
    by_robot: StopKind
    notice: float = 0.0


def _blink(controller: ControllerProcess) -> None:
    controller.fault("safeguard_stop")
    time.sleep(BLINK)
    controller.fault("safeguard_stop", active=False)


def _open_the_door(controller: ControllerProcess) -> None:
    controller.fault("digital_input", index=DOOR, high=True)
    controller.fault("stuck_input", index=DOOR)
    controller.fault("door", opened=True, index=DOOR)


def _lose_link_before(controller: ControllerProcess) -> None:
    controller.fault("drop", port="rtde")
    time.sleep(LINK_GAP)
    controller.fault("protective_stop")


def _lose_link_after(controller: ControllerProcess) -> None:
    controller.fault("protective_stop")
    controller.fault("drop", port="rtde")  # a tick later


def _switch_on(controller: ControllerProcess, *orders: str) -> None:
    """Give orders on the dashboard server, release the brakes, and wait until the arm is on."""
    with socket.create_connection((controller.host, DASHBOARD_PORT), ANSWER_TIME) as sock, sock.makefile("rw") as lines:
        lines.readline()  # its greeting
        for order in (*orders, "brake release"):
            print(order, file=lines, flush=True)
            lines.readline()
    deadline = time.monotonic() + POWER_TIME
    while controller.state()["robot_mode"] != "RUNNING":
        if time.monotonic() > deadline:
            raise DeviceError("the stand-in's arm cannot be switched on")
        time.sleep(0.05)


def _pull_out(controller: ControllerProcess) -> None:
    controller.fault("emergency_stop", pressed=False)
    _switch_on(controller)


def _restart_safety(controller: ControllerProcess) -> None:
    _switch_on(controller, "restart safety")


RELEASED_STOPS = (
    ReleasedStop(
        12, "protective stop, released, Play", lambda c: c.fault("protective_stop"), lambda c: c.fault("unlock"),
        ProtectiveStopError, "protective",
    ),
    ReleasedStop(
        13, "safeguard opened, closed, Play", lambda c: c.fault("safeguard_stop"),
        lambda c: c.fault("safeguard_stop", active=False), EmergencyStopError, "safeguard",
    ),
    ReleasedStop(
        13, f"safeguard open for {BLINK * 1e3:.0f} ms, Play", _blink, lambda _: None, MotionFaultError, "safeguard",
    ),
    ReleasedStop(
        27, "door opened, its input stuck closed, Play", _open_the_door,
        lambda c: c.fault("door", opened=False, index=DOOR), EmergencyStopError, "safeguard",
    ),
    ReleasedStop(
        13, "paused at the pendant, Play", lambda c: c.fault("pause"), lambda _: None, MotionFaultError, "program",
        PAUSE_SLEW,
    ),
    ReleasedStop(
        13, "emergency stop, pulled out, switched on, Play", lambda c: c.fault("emergency_stop"), _pull_out,
        EmergencyStopError, "emergency",
    ),
    ReleasedStop(
        13, "safety violation, safety restarted, switched on, Play", lambda c: c.fault("safety_fault", violation=True),
        _restart_safety, MotionFaultError, "emergency",
    ),
    ReleasedStop(
        13, "safety fault, safety restarted, switched on, Play", lambda c: c.fault("safety_fault"), _restart_safety,
        MotionFaultError, "emergency",
    ),
    ReleasedStop(
        9, f"link lost {LINK_GAP * 1e3:.0f} ms before a protective stop, released, Play", _lose_link_before,
        lambda c: c.fault("unlock"), MotionFaultError, "protective", 2 * LINK_GAP,
    ),
    ReleasedStop(
        9, "link lost a tick after a protective stop, released, Play", _lose_link_after,
        lambda c: c.fault("unlock"), MotionFaultError, "protective",
    ),
)  # fmt: skip


def released_rows(rig: Rig) -> Iterator[Measurement]:
    """Yield each stop, its release and Play, in mid-swing and at rest."""
    for fault in RELEASED_STOPS:
        for phase in (Phase.SWING, Phase.REST):
            run = partial(released_row, fault, phase, rig)
            yield Measurement(fault.number, fault.fault, phase, rig.name, EXPECTED, run)


def released_row(fault: ReleasedStop, phase: Phase, rig: Rig) -> FaultRow:
    """Measure one stop, its release and Play."""
    return _in_swing(fault, rig) if phase is Phase.SWING else _at_rest(fault, rig)


def _in_swing(fault: ReleasedStop, rig: Rig) -> FaultRow:
    happened = rig.inject(lambda: fault.stop(rig.controller))
    stop = happened.stop
    wrong, moved, latched = release_and_play(rig, fault.release)
    # A pause of the program ends with the driver's stop of it, after which the controller brakes.
    allowed = fault.notice + stop.speed / float(getattr(rig.setting.stops, fault.by_robot)) + 4 * rig.period
    if not isinstance(happened.error, fault.error):
        wrong.append(f"{fault.error.__name__} expected, got {happened.error!r}")
    if stop.standstill > allowed:
        wrong.append(f"standstill after {stop.standstill * 1e3:.0f} ms, {allowed * 1e3:.0f} allowed")
    if stop.off_path > rig.off_path(stop.path_time, fault.by_robot, 2 * rig.period):
        wrong.append(f"the joints left the path by {stop.off_path:.4f} rad")
    got = f"{type(happened.error).__name__}, moves {moved * 1e3:.1f} mrad after Play"
    return FaultRow(
        fault.number, fault.fault, Phase.SWING, rig.name, EXPECTED, got, latched, not wrong, "; ".join(wrong),
        stop.reaction, stop.standstill, allowed, stop.speed, stop.off_path,
    )  # fmt: skip


def _at_rest(fault: ReleasedStop, rig: Rig) -> FaultRow:
    rig.prepare()
    before = rig.controller.state()["tick"]
    fault.stop(rig.controller)
    time.sleep(REST_TIME)
    wrong, moved, latched = release_and_play(rig, fault.release)
    moved = max(moved, travel(rig, before))
    if moved > AT_REST:
        wrong.append(f"the arm moved by {moved:.4f} rad")
    got = f"moves {moved * 1e3:.1f} mrad after Play"
    return FaultRow(
        fault.number, fault.fault, Phase.REST, rig.name, EXPECTED, got, latched, not wrong, "; ".join(wrong),
        off_path=moved,
    )  # fmt: skip


def release_and_play(rig: Rig, release: Callable[[ControllerProcess], object]) -> tuple[list[str], float, bool]:
    """Release a stop and press Play."""
    controller = rig.controller
    wrong = program_not_ended(rig)
    before = controller.state()["tick"]
    release(controller)
    time.sleep(0.1)  # a controller may resume the program by itself
    if controller.fault("play")["resumed"]:
        wrong.append("Play resumed the program")
    time.sleep(PLAY_TIME)
    latched = rig.is_latched()
    if not latched:
        wrong.append("the next motion was not refused")
    moved = travel(rig, before)
    if moved > AT_REST:
        wrong.append(f"the arm moved by {moved:.4f} rad after release and Play")
    return wrong, moved, latched


def program_not_ended(rig: Rig) -> list[str]:
    """What is wrong where the robot's program still runs, or is paused."""
    state = rig.controller.state()["program_state"]
    return [] if state == "STOPPED" else [f"the robot's program is {state}: Play would resume it"]


def travel(rig: Rig, before: int) -> float:
    """How far the joints, or their set-points, have moved."""
    trace = rig.controller.trace(before)
    return float(max(np.ptp(trace.q, axis=0).max(), np.ptp(trace.q_target, axis=0).max()))

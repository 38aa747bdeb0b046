"""Noise that must disturb no motion, and a servo that suddenly lags more."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from tests.faults.record import FaultRow, Measurement, Phase
from tests.faults.rows.arm import AT_REST
from tests.faults.rows.released_stops import travel
from tests.rigs.driver_rig import OFF_PATH, Rig
from tests.rigs.time_bounds import PATIENT
from toolee_robot.errors import TooleeError, TrackingError
from toolee_robot.hal import MotionOutcome
from toolee_robot.sim_backend.ur_controller.profile import profile as profile_of

NOISE, CONTACT_NOISE, LAGS = (
    "noise of encoders and force",
    "noise of the force, contact detection armed",
    "servo lags by 0.2 s more",
)
UNDISTURBED = "the motion is completed, nothing latches"
MORE = 0.2  # [s] of lag
REST_TIME = 1.0  # [s] at rest with noise
FINISH_TIME = 0.4
"""[s] From a motion's last command until it counts as ended: the servo's tail, standstill for 0.1 s, and a little."""


def following_rows(rig: Rig) -> Iterator[Measurement]:
    """Yield the noise in mid-swing and at rest, and the lag in mid-swing: at rest there is nothing to lag."""
    yield Measurement(0, NOISE, Phase.SWING, rig.name, UNDISTURBED, partial(_swing_with_noise, rig, False))
    yield Measurement(0, NOISE, Phase.REST, rig.name, "stands still, does not latch", partial(_rest_with_noise, rig))
    yield Measurement(0, CONTACT_NOISE, Phase.SWING, rig.name, UNDISTURBED, partial(_swing_with_noise, rig, True))
    yield Measurement(7, LAGS, Phase.SWING, rig.name, "brakes on the path, latches", partial(_lags, rig))


def _make_noise(rig: Rig) -> None:
    """The noise of a controller of this generation, whatever the profile."""
    harsh = profile_of("harsh", rig.setting.controller.e_series)
    rig.controller.fault(
        "noise", position=harsh.encoders.position, velocity=harsh.encoders.velocity, force=harsh.force.noise[0],
        torque=harsh.force.noise[1], offset=harsh.force.offset[0],
    )  # fmt: skip


def _swing_with_noise(rig: Rig, armed: bool) -> FaultRow:
    rig.make_ready()
    _make_noise(rig)
    rig.arm.zero_wrench()
    rig.go_to_start()
    strike, guard = rig.strike, rig.contact_guard() if armed else None
    wrong: list[str] = []
    began = time.monotonic()
    try:
        got = str(rig.arm.execute(strike, guard, PATIENT).outcome)
    except TooleeError as error:
        got = type(error).__name__
        wrong.append(f"the motion was stopped: {error}")
    took = time.monotonic() - began
    if got != MotionOutcome.COMPLETED and not wrong:
        wrong.append(f"the motion ended as {got}")
    late = took - strike.duration - FINISH_TIME
    if late > 0.0:
        wrong.append(f"the end of the motion was noticed {late:.2f} s late")
    end = float(np.abs(np.array(rig.controller.state()["q"]) - strike.q[-1]).max())
    if end > AT_REST:
        wrong.append(f"the joints stand {end:.4f} rad beside the end of the path")
    return FaultRow(
        0, CONTACT_NOISE if armed else NOISE, Phase.SWING, rig.name, UNDISTURBED, got, bool(wrong), not wrong,
        "; ".join(wrong), off_path=end,
    )  # fmt: skip


def _rest_with_noise(rig: Rig) -> FaultRow:
    rig.prepare()
    before = rig.controller.state()["tick"]
    _make_noise(rig)
    time.sleep(REST_TIME)
    moved = travel(rig, before)
    wrong = [] if moved < AT_REST else [f"the arm moved by {moved:.4f} rad"]
    latched = False
    try:
        rig.nudge()
    except TooleeError as error:
        latched = True
        wrong.append(f"the next motion failed: {error}")
    return FaultRow(
        0, NOISE, Phase.REST, rig.name, "stands still, does not latch", "stands still", latched, not wrong,
        "; ".join(wrong), off_path=moved,
    )  # fmt: skip


def _lags(rig: Rig) -> FaultRow:
    setting = rig.setting
    usual = profile_of("harsh", setting.controller.e_series).servo
    assert usual is not None
    more = replace(usual, dead_time=usual.dead_time + MORE)
    happened = rig.inject(lambda: rig.controller.fault("lag", seconds=MORE))
    stop, strike, limits = happened.stop, rig.strike, rig.swing.config.arm
    latched = rig.is_latched()
    notice = setting.noticing(strike, stop.path_time, PATIENT.tracking_error, more) + 3 * rig.period
    # One more cycle: the fault itself takes effect in the controller's next one.
    allowed = notice + setting.braking(strike, stop.path_time, notice, limits, lag=more) + 3 * rig.period
    wrong = []
    if not isinstance(happened.error, TrackingError):
        wrong.append(f"TrackingError expected, got {happened.error!r}")
    if not latched:
        wrong.append("the next motion was not refused")
    if stop.standstill > allowed:
        wrong.append(f"standstill after {stop.standstill * 1e3:.0f} ms, {allowed * 1e3:.0f} allowed")
    if stop.off_path > OFF_PATH + setting.rounding(strike, more):
        wrong.append(f"the joints left the path by {stop.off_path:.4f} rad")
    return FaultRow(
        7, LAGS, Phase.SWING, rig.name, "brakes on the path, latches", type(happened.error).__name__, latched,
        not wrong, "; ".join(wrong), stop.reaction, stop.standstill, allowed, stop.speed, stop.off_path,
    )  # fmt: skip

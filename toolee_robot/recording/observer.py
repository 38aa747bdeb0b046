"""Observers that record a job: the MCAP recording, and the contents of the picture."""
# ruff: noqa: ARG002 - an observer receives more than it records

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict
from typing import Any

import numpy as np

from toolee_robot.control.records import StrikePlan
from toolee_robot.end_effectors import Category
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport, Station
from toolee_robot.recording.messages import plain
from toolee_robot.recording.picture import NailCurve, draw
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.robots import ARM_JOINTS
from toolee_robot.station import ONLY_NAIL, StationConfig
from toolee_robot.tasks.common.observer import HandCourse, TaskObserver
from toolee_robot.tasks.common.outcome import HammerResult, NailResult, Stage, Strike
from toolee_robot.types import InHandEstimate, RgbdFrame, ToolEstimate


class RecordingObserver(TaskObserver):
    """Writes the events of a task to a recorder.

    Args:
        recorder: The open recorder.
        station: The devices: clock, names of the hand's joints, the arm's own safety status after each motion.
        config: What the station file says; it is attached to the recording.
    """

    def __init__(self, recorder: RunRecorder, station: Station, config: StationConfig) -> None:
        self._recorder, self._station, self._clock = recorder, station, station.clock
        recorder.attach("station.json", "application/json", json.dumps(plain(asdict(config))).encode())
        recorder.record_pose(self._clock.now(), "base", "camera", config.camera.X_base_camera)
        self._nail = ONLY_NAIL
        for name, work in config.work.each():
            frame = name if len(config.work.names) == 1 else f"nail {name}"
            recorder.record_pose(self._clock.now(), "base", frame, work.X_base_nail())

    def stage_started(self, stage: Stage) -> None:
        self._recorder.record_decision(self._clock.now(), "stage", f"{stage} begins", {"stage": stage})

    def stage_ended(self, stage: Stage, seconds: float) -> None:
        data = {"stage": stage, "wall_seconds": seconds}
        self._recorder.record_decision(self._clock.now(), "stage_ended", f"{stage} ends", data)

    def message(self, text: str) -> None:
        self._recorder.record_log(self._clock.now(), text)

    def frame(self, frame: RgbdFrame, estimates: list[ToolEstimate], X_camera_hand: Array) -> None:
        self._recorder.record_pose(frame.stamp, "camera", "hand", X_camera_hand)
        self._recorder.record_frame(frame)
        for e in estimates:
            self._recorder.record_estimate(frame.stamp, e)
            if np.all(np.isfinite(e.X_camera_ee)):
                self._recorder.record_pose(frame.stamp, "camera", f"seen_{e.category}", e.X_camera_ee)
            if e.hypotheses is not None and e.category is Category.HAMMER_HEAD:
                self._recorder.record_cloud(frame.stamp, "camera", e.hypotheses.points)
                self._recorder.record_hypotheses(frame.stamp, "camera", e.hypotheses.Xs_camera_ee)
        usable = [e for e in estimates if e.usable]
        best = max(usable or estimates, key=lambda e: e.trust, default=None)
        reason = "nothing detected" if best is None else f"{best.category.label}, trust {best.trust:.2f}: {best.reason}"
        data = {"detections": len(estimates), "usable": len(usable)}
        self._recorder.record_decision(frame.stamp, "frame", reason, data)

    def in_hand(self, stamp: float, estimate: InHandEstimate) -> None:
        self._recorder.record_in_hand(stamp, estimate)
        if np.all(np.isfinite(estimate.X_hand_ee)):
            self._recorder.record_pose(stamp, "hand", str(estimate.category), estimate.X_hand_ee)
        verdict = "used" if estimate.usable else f"not used, {estimate.reason}"
        reason = f"{estimate.frames_used} of {estimate.frames_seen} frames agree: {verdict}"
        data: dict[str, Any] = {"usable": estimate.usable}
        data |= {"camera_error": None if estimate.camera is None else estimate.camera.mean.tolist()}
        self._recorder.record_decision(stamp, "pose_in_hand", reason, data)

    def planned(self, stamp: float, plan: StrikePlan) -> None:
        data: dict[str, Any] = {"speed": plan.speed, "spin": plan.theta, "clearance": plan.clearance.distance}
        data |= {"X_base_ee_contact": plan.X_base_ee_contact, "planning_seconds": plan.planning_time}
        data |= {"wanted_speed": plan.wanted_speed, "attainable_speed": plan.attainable_speed}
        data |= {"brake_length": plan.brake_length}
        reason = (
            f"strike at {plan.speed:.2f} m/s of {plan.wanted_speed:.2f} wanted, "
            f"clearance {plan.clearance.distance * 1e3:.0f} mm"
        )
        self._recorder.record_decision(stamp, "plan", reason, data)

    def motion(self, name: str, report: MotionReport, hand: HandCourse) -> None:
        # First, so that what is known of the hand is never younger than the motion that is drawn.
        for stamp, q in hand:
            self._recorder.record_joints(stamp, self._station.hand.joint_names, q, "/hand/measured")
        self._recorder.record_motion(name, report, ARM_JOINTS)
        self._status()

    def contact(self, stamp: float, force: float, X_base_ee: Array) -> None:
        self._recorder.record_contact(stamp, force, X_base_ee)

    def nail_started(self, name: str, protrusion: float) -> None:
        self._nail = name
        data = {"nail": name, "protrusion": protrusion}
        reason = f"nail {name}, {protrusion * 1e3:.1f} mm over the wood"
        self._recorder.record_decision(self._clock.now(), "nail", reason, data)

    def nail_ended(self, result: NailResult) -> None:
        data = {"nail": result.name, "outcome": str(result.outcome), "strikes": len(result.strikes)}
        reason = f"nail {result.name}: {str(result.outcome).replace('_', ' ')}, {result.reason}"
        self._recorder.record_decision(self._clock.now(), "nail_ended", reason, data)

    def strike(self, strike: Strike) -> None:
        data: dict[str, Any] = {"nail": self._nail, "number": strike.number, "protrusion": strike.protrusion}
        data |= {"speed": strike.speed, "peak_force": strike.peak_force, "meeting": str(strike.meeting)}
        data |= asdict(strike.load)
        left = "nail not measured" if strike.protrusion is None else f"{strike.protrusion * 1e3:.1f} mm left"
        reason = f"strike {strike.number}: {strike.meeting}, {left}, {strike.peak_force:.0f} N"
        self._recorder.record_decision(self._clock.now(), "strike", reason, data)

    def ended(self, result: HammerResult) -> None:
        self._status()
        data: dict[str, Any] = {"outcome": str(result.outcome), "reason": result.reason}
        data |= {"strikes": len(result.strikes), "nails": {n.name: n.outcome and str(n.outcome) for n in result.nails}}
        reason = f"{str(result.outcome).replace('_', ' ')}: {result.reason}"
        self._recorder.record_decision(self._clock.now(), "ended", reason, data)

    def _status(self) -> None:
        with suppress(DeviceError):  # an arm that does not answer has no status; the job's end says so
            self._recorder.record_status(self._station.arm.state())


class PictureCollector(TaskObserver):
    """Collects the contents of the picture: the best frame of the first look, and each nail after every strike.

    Args:
        flush: Largest protrusion that counts as flush [m].
    """

    def __init__(self, flush: float) -> None:
        self._best: tuple[RgbdFrame, list[ToolEstimate]] | None = None
        self._rank = (False, -1.0)
        self._nails: list[tuple[str, list[float | None]]] = []
        self._struck = False
        self._flush_mm = flush * 1e3

    def frame(self, frame: RgbdFrame, estimates: list[ToolEstimate], X_camera_hand: Array) -> None:
        rank = max(((e.usable, e.confidence) for e in estimates if e.category is Category.HAMMER_HEAD), default=None)
        if self._best is None or (not self._struck and rank is not None and rank > self._rank):
            self._best, self._rank = (frame, estimates), rank or self._rank

    def nail_started(self, name: str, protrusion: float) -> None:
        self._nails.append((name, [protrusion * 1e3]))

    def strike(self, strike: Strike) -> None:
        self._struck = True
        self._nails[-1][1].append(None if strike.protrusion is None else strike.protrusion * 1e3)

    def picture(self, title: str, note: str) -> bytes:
        """Draw the picture.

        Args:
            title: Title of the picture.
            note: Text at its upper right corner.

        Returns:
            The picture as PNG.
        """
        frame, estimates = self._best or (None, [])
        nails = [NailCurve(tuple(heights), self._flush_mm, name) for name, heights in self._nails]
        return draw(frame, estimates, nails, title=title, note=note, focus=Category.HAMMER_HEAD)

"""Observers that record a job: the MCAP recording, and the contents of the picture."""
# ruff: noqa: ARG002 - an observer receives more than it records

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from toolee_robot.control.records import StrikePlan
from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, MotionReport
from toolee_robot.recording.picture import NailCurve, draw
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.robots import ARM_JOINTS
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import HammerResult, Stage, Strike
from toolee_robot.types import InHandEstimate, RgbdFrame, ToolEstimate


class RecordingObserver(TaskObserver):
    """Writes the events of a task to a recorder.

    Args:
        recorder: The open recorder.
        clock: The station's clock.
        hand_joints: Names of the hand's joints, wrist first.
        X_base_camera: Pose of the camera in `base`, (4, 4).
    """

    def __init__(self, recorder: RunRecorder, clock: Clock, hand_joints: Sequence[str], X_base_camera: Array) -> None:
        self._recorder = recorder
        self._clock = clock
        self._hand_joints = hand_joints
        recorder.record_pose(clock.now(), "base", "camera", X_base_camera)

    def stage_started(self, stage: Stage) -> None:
        self._recorder.record_event(self._clock.now(), "stage", {"stage": str(stage)})

    def stage_ended(self, stage: Stage, seconds: float) -> None:
        self._recorder.record_event(self._clock.now(), "stage_ended", {"stage": str(stage), "wall_seconds": seconds})

    def message(self, text: str) -> None:
        self._recorder.record_log(self._clock.now(), text)

    def frame(self, frame: RgbdFrame, estimates: list[ToolEstimate], X_camera_hand: Array) -> None:
        self._recorder.record_frame(frame)
        self._recorder.record_pose(frame.stamp, "camera", "hand", X_camera_hand)
        for e in estimates:
            data: dict[str, Any] = {
                "category": str(e.category),
                "score": e.detection.score,
                "box": list(e.detection.box),
            }
            data |= {
                "confidence": e.confidence,
                "trust": e.trust,
                "usable": e.usable,
                "reason": e.reason,
                "covariance": e.covariance,
            }
            self._recorder.record_event(frame.stamp, "estimate", data)
            if np.all(np.isfinite(e.X_camera_ee)):
                self._recorder.record_pose(frame.stamp, "camera", f"seen_{e.category}", e.X_camera_ee)
            if e.hypotheses is not None and e.category is Category.HAMMER_HEAD:
                self._recorder.record_cloud(frame.stamp, "camera", e.hypotheses.points)
                self._recorder.record_hypotheses(frame.stamp, "camera", e.hypotheses.Xs_camera_ee)

    def in_hand(self, stamp: float, estimate: InHandEstimate) -> None:
        if np.all(np.isfinite(estimate.X_hand_ee)):
            self._recorder.record_pose(stamp, "hand", str(estimate.category), estimate.X_hand_ee)
        data: dict[str, Any] = {
            "category": str(estimate.category),
            "covariance": estimate.covariance,
            "usable": estimate.usable,
        }
        data |= {"frames_used": estimate.frames_used, "frames_seen": estimate.frames_seen, "reason": estimate.reason}
        self._recorder.record_event(stamp, "in_hand", data)

    def planned(self, stamp: float, plan: StrikePlan) -> None:
        data: dict[str, Any] = {"speed": plan.speed, "spin": plan.theta, "clearance": plan.clearance.distance}
        data |= {"X_base_ee_contact": plan.X_base_ee_contact, "planning_seconds": plan.planning_time}
        self._recorder.record_event(stamp, "plan", data)

    def motion(self, name: str, report: MotionReport, hand_joints: Array) -> None:
        self._recorder.record_motion(name, report, ARM_JOINTS)
        self._recorder.record_joints(self._clock.now(), self._hand_joints, hand_joints, "/hand/measured")

    def contact(self, stamp: float, force: float, X_base_ee: Array) -> None:
        self._recorder.record_contact(stamp, force, X_base_ee)

    def strike(self, strike: Strike) -> None:
        data: dict[str, Any] = {"number": strike.number, "protrusion": strike.protrusion}
        data |= {"speed": strike.speed, "peak_force": strike.peak_force, "meeting": str(strike.meeting)}
        data |= asdict(strike.load)
        self._recorder.record_event(strike.stamp, "blow", data)

    def ended(self, result: HammerResult) -> None:
        data = {"outcome": str(result.outcome), "reason": result.reason, "blows": len(result.strikes)}
        self._recorder.record_event(self._clock.now(), "ended", data)


class PictureCollector(TaskObserver):
    """Collects the contents of the picture: the best frame of the first look, and the nail after every strike.

    Args:
        protrusion: Protrusion of the nail before the first strike [m].
        flush: Largest protrusion that counts as flush [m].

    Attributes:
        strikes: The strikes so far.
    """

    def __init__(self, protrusion: float, flush: float) -> None:
        self._best: tuple[RgbdFrame, list[ToolEstimate]] | None = None
        self._rank = (False, -1.0)
        self.strikes: list[Strike] = []
        self._protrusion_mm = protrusion * 1e3
        self._flush_mm = flush * 1e3

    def frame(self, frame: RgbdFrame, estimates: list[ToolEstimate], X_camera_hand: Array) -> None:
        rank = max(((e.usable, e.confidence) for e in estimates if e.category is Category.HAMMER_HEAD), default=None)
        if self._best is None or (not self.strikes and rank is not None and rank > self._rank):
            self._best, self._rank = (frame, estimates), rank or self._rank

    def strike(self, strike: Strike) -> None:
        self.strikes.append(strike)

    def picture(self, title: str, note: str) -> bytes | None:
        """Draw the picture.

        Args:
            title: Title of the picture.
            note: Text at its upper right corner.

        Returns:
            The picture as PNG, or None when no frame was taken.
        """
        if self._best is None:
            return None
        measured = (None if b.protrusion is None else b.protrusion * 1e3 for b in self.strikes)
        nail = NailCurve((self._protrusion_mm, *measured), self._flush_mm)
        return draw(*self._best, nail, title=title, note=note, focus=Category.HAMMER_HEAD)

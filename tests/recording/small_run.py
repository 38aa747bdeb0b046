"""A small run, recorded without a job: two motions, a frame, an estimate, a strike."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolee_robot.end_effectors import Category
from toolee_robot.frames import inverse, transform
from toolee_robot.hal import ArmState, MotionOutcome, MotionReport
from toolee_robot.recording.mcap_file import tool_model
from toolee_robot.recording.messages import plain
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.robots import ARM_JOINTS, load_robot
from toolee_robot.station import sim_station
from toolee_robot.tools import ToolKind, make_tool
from toolee_robot.types import (
    CameraIntrinsics,
    Detection,
    InHandEstimate,
    JointState,
    PoseHypotheses,
    RgbdFrame,
    ToolEstimate,
)

INTRINSICS = CameraIntrinsics(365.5, 365.5, 15.5, 11.5, 32, 24)
X_HAND_EE = transform(p=[0.2, -0.02, 0.12])
REACHED = np.array([0.3, -1.5, 1.6, -1.2, -1.5, 0.2])


def motion(q: NDArray[np.float64], begin: float, peak: float) -> MotionReport:
    """One second at 125 Hz from home to q, with a peak of the force [N] in its middle."""
    n = 126
    path = np.linspace(np.array(sim_station().scene.home), q, n)
    wrenches = np.zeros((n, 6))
    wrenches[n // 2, 2] = peak
    return MotionReport(MotionOutcome.COMPLETED, begin + np.arange(n) / 125, path, path, wrenches)


def status(stamp: float, **known: Any) -> ArmState:
    """A state of the arm at a time [s], ready unless `known` says otherwise."""
    return ArmState(JointState(REACHED, np.zeros(6), stamp), REACHED, np.zeros(6), **known)


def estimate(rng: np.random.Generator) -> ToolEstimate:
    """An estimate of a hammer's face half a metre before the camera."""
    X = transform(None, [0.05, 0.04, 0.6])
    mask = np.zeros((24, 32), np.bool_)
    detection = Detection(Category.HAMMER_HEAD, 0.9, mask, (4.0, 5.0, 9.0, 9.0))
    Xs = np.stack([X @ transform(None, rng.normal(0, 0.002, 3)) for _ in range(8)])
    cloud = X[:3, 3] + rng.normal(0.0, 0.01, (50, 3))
    return ToolEstimate(
        detection, X, np.diag([1e-6] * 6), 0.8, True, "ok", PoseHypotheses(Xs, cloud, 1e-3, 0.02, 0.1), 0.9
    )


def record(recorder: RunRecorder) -> None:
    """Record the run, 4.3 s of it."""
    config, rng = sim_station(), np.random.default_rng(0)
    description = load_robot()
    recorder.attach("station.json", "application/json", json.dumps(plain(asdict(config))).encode())
    recorder.attach("tool.glb", "model/gltf-binary", tool_model(make_tool(ToolKind.CLAW_HAMMER, 3)))
    recorder.record_decision(0.0, "stage", "handover begins", {"stage": "handover"})
    recorder.record_joints(0.5, description.hand_joints, description.hand_open, "/hand/measured")
    recorder.record_motion("to the handover", motion(REACHED, 0.5, 0.0), ARM_JOINTS)
    recorder.record_status(status(1.5))
    recorder.record_decision(2.0, "stage_ended", "grip ends", {"stage": "grip"})
    recorder.record_decision(2.0, "stage", "perceive begins", {"stage": "perceive"})
    rgb = rng.integers(0, 256, (24, 32, 3), dtype=np.uint8)
    frame = RgbdFrame(rgb, np.full((24, 32), 0.6, np.float32), INTRINSICS, 2.5)
    recorder.record_pose(2.5, "camera", "hand", inverse(transform(p=[0.0, 0.0, -0.4])))
    recorder.record_frame(frame)
    seen = estimate(rng)
    assert seen.hypotheses is not None
    recorder.record_estimate(2.5, seen)
    recorder.record_cloud(2.5, "camera", seen.hypotheses.points)
    recorder.record_hypotheses(2.5, "camera", seen.hypotheses.Xs_camera_ee)
    fused = InHandEstimate(Category.HAMMER_HEAD, X_HAND_EE, np.diag([1e-6] * 6), 0.9, 1, 1, True, "ok")
    recorder.record_in_hand(2.6, fused)
    recorder.record_decision(2.6, "pose_in_hand", "1 of 1 frames agree: believed", {"usable": True})
    recorder.record_decision(2.7, "stage", "strike begins", {"stage": "strike"})
    recorder.record_motion("strike", motion(REACHED, 3.0, 54.0), ARM_JOINTS)
    recorder.record_log(4.0, "the nail went in")
    data = {"number": 1, "protrusion": 0.0123, "peak_force": 54.0}
    recorder.record_decision(4.1, "strike", "strike 1: expected, 12.3 mm left, 54 N", data)
    recorder.record_decision(4.3, "ended", "flush: the head stands 0.2 mm over the wood", {"outcome": "flush"})


def write(path: Path) -> Path:
    """Write the recording of the run; returns the file."""
    metadata = {"seed": 7, "title": "a small run", "X_hand_ee": np.eye(4), "X_tool_ee": np.eye(4)}
    with RunRecorder(path, metadata) as recorder:
        record(recorder)
    return path

"""The recording of a run: one MCAP file of images, frames, poses, joints, contacts and decisions.

    with RunRecorder(folder / "run.mcap", {"seed": 7}) as recorder:
        recorder.record_frame(frame)
        recorder.record_pose(stamp, "base", "ee", X_base_ee)

Messages are Protocol Buffers, Foxglove's published ones where there is one, so that Foxglove and Rerun show them
without configuration. A thread of its own encodes and writes them; after a kill the file can be read up to its last
second. Stamps are seconds on the station's clock.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np

from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmState, MotionReport
from toolee_robot.recording import messages
from toolee_robot.recording.history import RunHistory
from toolee_robot.recording.mcap_file import Item, McapFile
from toolee_robot.recording.own_messages import Contact, SafetyBits, StopRatios, Wrench
from toolee_robot.types import InHandEstimate, RgbdFrame, ToolEstimate


class RunRecorder:
    """Context manager that writes an MCAP file, which is complete after the context, also after an exception.

    Args:
        path: The file; its folder exists.
        metadata: Metadata of the file by name: text, or JSON values.

    Attributes:
        path: The file.
        metadata: Metadata of the file, text by name.
        history: Receives all that is recorded from now on, as the file does; None for none.
    """

    def __init__(self, path: Path, metadata: Mapping[str, Any] | None = None) -> None:
        self.path = path
        self.history: RunHistory | None = None
        self.metadata = {name: messages.as_text(value) for name, value in (metadata or {}).items()}
        self._file: McapFile | None = None

    def __enter__(self) -> Self:
        """Open the file; raises UserError where it cannot be written."""
        self._file = McapFile(self.path)
        self._file.metadata("run", self.metadata)
        return self

    def __exit__(self, *_: object) -> None:
        assert self._file is not None
        file, self._file = self._file, None
        file.close()

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file to the recording.

        Args:
            name: Its name.
            media_type: Its media type, such as "application/json".
            data: Its content.
        """
        self._opened(name).attach(name, media_type, data)
        if self.history is not None:
            self.history.attachments[name] = data

    def record_frame(self, frame: RgbdFrame) -> None:
        """Record a frame on `/camera/rgb` (PNG), `/camera/depth` (32 bit, metres) and `/camera/calibration`.

        Args:
            frame: The frame, whose arrays are not changed any more.

        Raises:
            UserError: The colour image is empty.
        """
        if frame.rgb.size == 0:
            raise UserError("the colour image could not be encoded as PNG: it is empty", code="user.empty_image")

        def build() -> list[Item]:
            _, png = cv2.imencode(".png", cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR))
            return [
                ("/camera/rgb", frame.stamp, messages.color_image(frame, png.tobytes())),
                ("/camera/depth", frame.stamp, messages.depth_image(frame)),
                ("/camera/calibration", frame.stamp, messages.calibration(frame.stamp, frame.intrinsics)),
            ]

        self._write("/camera/rgb", frame.stamp, build)

    def record_pose(self, stamp: float, parent: str, child: str, X: Array) -> None:
        """Record a pose as a transform on `/tf`.

        Args:
            stamp: Time [s].
            parent: Name of the parent frame.
            child: Name of the child frame.
            X: X_parent_child, (4, 4).
        """
        X = np.array(X)
        self._one("/tf", stamp, lambda: messages.transform_message(stamp, parent, child, X))

    def record_cloud(self, stamp: float, frame: str, points: Array) -> None:
        """Record a point cloud on `/perception/cloud`.

        Args:
            stamp: Time [s].
            frame: Name of the points' frame.
            points: The points, (N, 3) [m].
        """
        self._one("/perception/cloud", stamp, lambda: messages.point_cloud(stamp, frame, points))

    def record_hypotheses(self, stamp: float, frame: str, Xs: Array) -> None:
        """Record candidate poses on `/perception/hypotheses`.

        Args:
            stamp: Time [s].
            frame: Name of the poses' frame.
            Xs: Candidate poses of the end effector, (K, 4, 4).
        """
        self._one("/perception/hypotheses", stamp, lambda: messages.poses_in_frame(stamp, frame, Xs))

    def record_estimate(self, stamp: float, estimate: ToolEstimate) -> None:
        """Record an estimate from one frame on `/perception/estimates`, with its covariance.

        Args:
            stamp: Time of the frame [s].
            estimate: The estimate, in the camera's frame.
        """
        self._one("/perception/estimates", stamp, lambda: messages.estimate(stamp, estimate))

    def record_in_hand(self, stamp: float, estimate: InHandEstimate) -> None:
        """Record a fused estimate on `/perception/in_hand`, with its covariance.

        Args:
            stamp: Time of the fusion [s].
            estimate: The estimate, in the hand's frame.
        """
        self._one("/perception/in_hand", stamp, lambda: messages.in_hand(stamp, estimate))

    def record_joints(self, stamp: float, names: Sequence[str], q: Array, topic: str = "/joints") -> None:
        """Record joint positions.

        Args:
            stamp: Time [s].
            names: Names of the n joints.
            q: Joint positions, (n,) [rad].
            topic: Name of the topic.
        """
        q = np.array(q)
        self._one(topic, stamp, lambda: messages.joint_states(stamp, names, q))

    def record_motion(self, name: str, report: MotionReport, joint_names: Sequence[str]) -> None:
        """Record every sample of an arm's motion, and its outcome as a decision.

        Topics: `/arm/measured`, `/arm/commanded`, `/arm/wrench`; `/arm/stop_ratios`, `/arm/currents` and
        `/arm/safety_bits` where the controller reports them, the last at the motion's begin and where they change. A
        command that was not sent is not recorded.

        Args:
            name: Name of the motion.
            report: What was commanded and measured; its arrays are not changed any more.
            joint_names: Names of the arm's joints.
        """
        if len(report.stamps):
            self._write("/arm/measured", float(report.stamps[-1]), lambda: _motion(report, joint_names))
            reason = f"{name}: {report.outcome.value}"
            data = {"name": name, "outcome": report.outcome.value, "overruns": report.overruns}
            self.record_decision(float(report.stamps[-1]), "motion", reason, data)

    def record_status(self, state: ArmState) -> None:
        """Record the state of the robot's own safety system on `/arm/status`.

        Args:
            state: State of the arm.
        """
        stamp = state.joints.stamp
        self._one("/arm/status", stamp, lambda: messages.arm_status(stamp, state))

    def record_contact(self, stamp: float, force: float, X_base_ee: Array) -> None:
        """Record a contact of the face on `/contacts`.

        Args:
            stamp: Time [s].
            force: Sensed force [N].
            X_base_ee: Estimated pose of the end effector in `base`, (4, 4).
        """
        position = messages.vector(X_base_ee[:3, 3])
        message = Contact(timestamp=messages.timestamp(stamp), force=float(force), position=position)
        self._one("/contacts", stamp, lambda: message)

    def record_decision(self, stamp: float, name: str, reason: str, data: Mapping[str, Any] | None = None) -> None:
        """Record on `/decisions` what was decided, or what happened that decides how the job goes on.

        Args:
            stamp: Time [s].
            name: Its kind, such as "plan".
            reason: The reason, for a person.
            data: Its data: JSON values, numpy numbers and arrays.
        """
        data = messages.plain(dict(data or {}))
        self._one("/decisions", stamp, lambda: messages.decision(stamp, name, reason, data))

    def record_log(self, stamp: float, text: str, level: str = "info") -> None:
        """Record a message for a person on `/log`.

        Args:
            stamp: Time [s].
            text: The message.
            level: debug, info, warning or error.
        """
        self._one("/log", stamp, lambda: messages.log(stamp, text, level))

    def _one(self, topic: str, stamp: float, build: Callable[[], Any]) -> None:
        self._write(topic, stamp, lambda: [(topic, stamp, build())])

    def _write(self, topic: str, stamp: float, build: Callable[[], list[Item]]) -> None:
        messages.nanoseconds(stamp)  # refuses a bad one here, where it comes from
        self._opened(topic).write(build, self._told)

    def _opened(self, what: str) -> McapFile:
        if self._file is None:
            raise RuntimeError(f"nothing can be recorded on {what}: use RunRecorder in a `with` block")
        return self._file

    def _told(self, item: Item) -> None:
        if self.history is not None:
            self.history.add(*item)


def _motion(report: MotionReport, names: Sequence[str]) -> list[Item]:
    sent = len(report.stamps) if report.commands is None else report.commands
    deviation, collision = report.position_deviation_ratios, report.collision_ratios
    qd, torques, currents, bits = report.qd_measured, report.torques, report.currents, report.safety_bits
    items: list[Item] = []
    for i, t in enumerate(map(float, report.stamps)):
        velocity, torque_row = (None if rows is None else rows[i] for rows in (qd, torques))
        items.append(("/arm/measured", t, messages.joint_states(t, names, report.q_measured[i], velocity)))
        if i < sent:
            commanded = messages.joint_states(t, names, report.q_commanded[i], effort=torque_row)
            items.append(("/arm/commanded", t, commanded))
        if currents is not None:
            items.append(("/arm/currents", t, messages.joint_currents(t, currents[i])))
        if bits is not None and (i == 0 or bits[i] != bits[i - 1]):
            changed = SafetyBits(timestamp=messages.timestamp(t), bits=int(bits[i]))
            items.append(("/arm/safety_bits", t, changed))
        force, torque = messages.vector(report.wrenches[i, :3]), messages.vector(report.wrenches[i, 3:])
        items.append(("/arm/wrench", t, Wrench(timestamp=messages.timestamp(t), force=force, torque=torque)))
        if deviation is not None and collision is not None:
            ratios = StopRatios(position_deviation=float(deviation[i]), collision=float(collision[i]))
            ratios.timestamp.CopyFrom(messages.timestamp(t))
            items.append(("/arm/stop_ratios", t, ratios))
    return items

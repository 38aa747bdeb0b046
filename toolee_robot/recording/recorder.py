"""Writes everything that happens during a job to an MCAP file.

Whoever records hands over, and goes on: a thread of its own encodes and writes. After a kill the file can be read up to
its last second. If the disk is full, recording stops and says so, and the job goes on. Stamps are seconds on the
station's clock.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np

from toolee_robot.errors import UserError, words_of
from toolee_robot.frames import Array
from toolee_robot.hal import ArmState, MotionReport
from toolee_robot.recording import messages
from toolee_robot.recording.history import RunHistory
from toolee_robot.recording.mcap_file import McapFile
from toolee_robot.recording.messages import Packed
from toolee_robot.types import InHandEstimate, RgbdFrame, ToolEstimate

FLUSH_PERIOD = 1.0
"""Longest time that a message waits in memory [s]; what a killed process loses."""
Item = tuple[str, float, Packed]
"""Topic, stamp [s] on the station's clock, message."""


class RunRecorder:
    """Context manager that writes an MCAP file, which is complete after the context, also after an exception.

    Args:
        path: The file; its folder exists.
        metadata: Metadata of the file by name: text, or JSON values.
        tell: Told at once, from another thread, why recording has stopped; None: the program's log is told.

    Attributes:
        path: The file.
        metadata: Metadata of the file, text by name.
        history: Receives all that is recorded from now on, as the file does; None for none.
        stopped: Why recording has stopped; empty as long as it goes on.
    """

    def __init__(
        self, path: Path, metadata: Mapping[str, Any] | None = None, tell: Callable[[str], None] | None = None
    ) -> None:
        self.path = path
        self.history: RunHistory | None = None
        self.metadata = {name: messages.as_text(value) for name, value in (metadata or {}).items()}
        self.stopped = ""
        self._tell = tell or logging.getLogger(__name__).error
        self._queue: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._decoders: dict[str, Callable[[bytes], Any]] = {}
        self._file: McapFile | None = None

    def __enter__(self) -> Self:
        """Open the file; raises UserError if it cannot be written."""
        self._file = file = McapFile(self.path)
        file.metadata("run", self.metadata)
        self._thread = threading.Thread(target=self._run, args=(file,), name="recording", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._file = None
        self._queue.put(None)
        self._thread.join()

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file to the recording.

        Args:
            name: Its name.
            media_type: Its media type, such as "application/json".
            data: Its content.
        """
        file = self._opened(name)
        self._queue.put(lambda: file.attach(name, media_type, data))
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
            raise UserError("the colour image could not be encoded as PNG: it is empty")

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
        message = messages.contact(stamp, force, X_base_ee[:3, 3])
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

    def _one(self, topic: str, stamp: float, build: Callable[[], Packed]) -> None:
        self._write(topic, stamp, lambda: [(topic, stamp, build())])

    def _write(self, topic: str, stamp: float, build: Callable[[], list[Item]]) -> None:
        messages.nanoseconds(stamp)  # refuses a bad one here, where it comes from
        file = self._opened(topic)

        def write() -> None:
            for name, at, packed in build():
                file.write(name, messages.nanoseconds(at), packed.schema, packed.data)
                if self.history is not None:
                    if name not in self._decoders:
                        self._decoders[name] = messages.decoder(packed.schema)
                    self.history.add(name, at, self._decoders[name](packed.data))

        self._queue.put(write)

    def _opened(self, what: str) -> McapFile:
        if self._file is None:
            raise RuntimeError(f"nothing can be recorded on {what}: use RunRecorder in a `with` block")
        return self._file

    def _run(self, file: McapFile) -> None:
        """Write what is handed over until None comes; a failure ends the recording only."""
        pending, flushed = False, time.monotonic()
        while True:
            wait = max(FLUSH_PERIOD - (time.monotonic() - flushed), 0.0) if pending else None
            action: Callable[[], None] | None = _nothing
            try:
                action = self._queue.get(timeout=wait)
                pending = True
            except queue.Empty:
                pass
            try:
                if action is None:
                    file.close()
                elif not self.stopped:  # the queue is emptied nevertheless: a full disk must not fill the memory, too
                    action()
                    if pending and time.monotonic() - flushed >= FLUSH_PERIOD:
                        file.flush()
                        pending, flushed = False, time.monotonic()
            except Exception as error:  # noqa: BLE001 - a recording must never end a job
                self._stop(f"{type(error).__name__}: {error}")
            if file.failure is not None:
                self._stop(words_of(file.failure))
            if action is None:
                return

    def _stop(self, why: str) -> None:
        if not self.stopped:
            self.stopped = f"recording has stopped, the job goes on: {why} ({self.path})"
            self._tell(self.stopped)


def _nothing() -> None:
    """What is done when only time has passed."""


def _motion(report: MotionReport, names: Sequence[str]) -> list[Item]:
    sent = len(report.stamps) if report.commands is None else report.commands
    deviation, collision = report.position_deviation_ratios, report.collision_ratios
    qd, torques, currents, bits = report.qd_measured, report.torques, report.currents, report.safety_bits
    items: list[Item] = []
    for i, t in enumerate(map(float, report.stamps)):
        velocity, torque = (None if rows is None else rows[i] for rows in (qd, torques))
        items.append(("/arm/measured", t, messages.joint_states(t, names, report.q_measured[i], velocity)))
        if i < sent:
            commanded = messages.joint_states(t, names, report.q_commanded[i], effort=torque)
            items.append(("/arm/commanded", t, commanded))
        if currents is not None:
            items.append(("/arm/currents", t, messages.joint_currents(t, currents[i])))
        if bits is not None and (i == 0 or bits[i] != bits[i - 1]):
            items.append(("/arm/safety_bits", t, messages.safety_bits(t, bits[i])))
        items.append(("/arm/wrench", t, messages.wrench(t, report.wrenches[i])))
        if deviation is not None and collision is not None:
            items.append(("/arm/stop_ratios", t, messages.stop_ratios(t, deviation[i], collision[i])))
    return items

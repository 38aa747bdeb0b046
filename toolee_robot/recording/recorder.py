"""The recording of a run: one MCAP file of images, frames, poses, joints, contacts and events, for Foxglove.

    with RunRecorder(folder / "run.mcap", {"seed": "7"}) as recorder:
        recorder.record_frame(frame)
        recorder.record_pose(stamp, "base", "ee", X_base_ee)

Messages use Foxglove's own types (JSON encoding) where there is one, so that its image, 3D and log panels work without
configuration, and plain JSON with a schema elsewhere. The file is written under a hidden name and renamed when it is
complete, whatever ended the run. Stamps are seconds on the station's clock.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Self

import cv2
import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

import toolee_robot
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.hal import MotionReport
from toolee_robot.recording.schemas import SCHEMAS
from toolee_robot.types import CameraIntrinsics, RgbdFrame

MOTION_PERIOD = 1 / 125
"""Time between recorded samples of a motion [s]."""
_FLOAT32 = 7  # foxglove.PackedElementField's code
_LOG_LEVELS = {"debug": 1, "info": 2, "warning": 3, "error": 4}


class RunRecorder:
    """Context manager that writes an MCAP file, which is complete after the context, also after an exception.

    Args:
        path: The file; its folder exists.
        metadata: Metadata of the file, as text by name.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path, metadata: Mapping[str, str] | None = None) -> None:
        self.path = path
        self._part = path.with_name(f".{path.name}.part")
        self._metadata = dict(metadata or {})
        self._file: IO[bytes] | None = None
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}

    def __enter__(self) -> Self:
        """Open the file; raises UserError where it cannot be written."""
        try:
            self._file = self._part.open("wb")
        except OSError as error:
            raise UserError(
                f"cannot write the recording {self.path}: {error.strerror or error}", code="user.recording_not_writable"
            ) from error
        self._writer = Writer(self._file)
        self._writer.start(profile="", library=f"toolee_robot {toolee_robot.__version__}")
        self._writer.add_metadata("run", self._metadata)
        return self

    def __exit__(self, *_: object) -> None:
        assert self._file is not None
        try:
            with self._file:
                self._writer.finish()  # type: ignore[no-untyped-call]
            self._part.replace(self.path)
        except BaseException:
            self._part.unlink(missing_ok=True)
            raise
        finally:
            self._file = None

    def record_frame(self, frame: RgbdFrame) -> None:
        """Record a frame on `/camera/rgb`, `/camera/depth` and `/camera/calibration`.

        Args:
            frame: The frame. The image is stored as PNG, the depth with 16 bits in millimetres, 0 where unknown.

        Raises:
            UserError: The colour image is empty.
        """
        header = {"timestamp": _time(frame.stamp), "frame_id": "camera"}
        ok, png = cv2.imencode(".png", cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR))
        if not ok:
            raise UserError("the colour image could not be encoded as PNG: it is empty", code="user.empty_image")
        self._write(
            "/camera/rgb", "foxglove.CompressedImage", frame.stamp, header | {"data": _b64(png), "format": "png"}
        )
        depth_mm = np.clip(np.nan_to_num(frame.depth * 1e3, posinf=0.0, neginf=0.0), 0, 65535).round().astype("<u2")
        height, width = depth_mm.shape
        image = {"width": width, "height": height, "encoding": "16UC1", "step": 2 * width, "data": _b64(depth_mm)}
        self._write("/camera/depth", "foxglove.RawImage", frame.stamp, header | image)
        calibration = header | _calibration(frame.intrinsics)
        self._write("/camera/calibration", "foxglove.CameraCalibration", frame.stamp, calibration)

    def record_pose(self, stamp: float, parent: str, child: str, X: Array) -> None:
        """Record a pose as a transform on `/tf`.

        Args:
            stamp: Time [s].
            parent: Name of the parent frame.
            child: Name of the child frame.
            X: X_parent_child, (4, 4).
        """
        pose = _pose(X)
        transform = {
            "timestamp": _time(stamp),
            "parent_frame_id": parent,
            "child_frame_id": child,
            "translation": pose["position"],
            "rotation": pose["orientation"],
        }
        self._write("/tf", "foxglove.FrameTransforms", stamp, {"transforms": [transform]})

    def record_cloud(self, stamp: float, frame: str, points: Array) -> None:
        """Record a point cloud on `/perception/cloud`.

        Args:
            stamp: Time [s].
            frame: Name of the points' frame.
            points: The points, (N, 3) [m].
        """
        cloud = {
            "timestamp": _time(stamp),
            "frame_id": frame,
            "pose": _pose(np.eye(4)),
            "point_stride": 12,
            "fields": [{"name": name, "offset": 4 * i, "type": _FLOAT32} for i, name in enumerate("xyz")],
            "data": _b64(np.asarray(points, dtype="<f4").reshape(-1, 3)),
        }
        self._write("/perception/cloud", "foxglove.PointCloud", stamp, cloud)

    def record_hypotheses(self, stamp: float, frame: str, Xs: Array) -> None:
        """Record candidate poses on `/perception/hypotheses`.

        Args:
            stamp: Time [s].
            frame: Name of the poses' frame.
            Xs: Candidate poses of the end effector, (K, 4, 4).
        """
        poses = {"timestamp": _time(stamp), "frame_id": frame, "poses": [_pose(X) for X in Xs]}
        self._write("/perception/hypotheses", "foxglove.PosesInFrame", stamp, poses)

    def record_joints(self, stamp: float, names: Sequence[str], q: Array, topic: str = "/joints") -> None:
        """Record joint positions.

        Args:
            stamp: Time [s].
            names: Names of the n joints.
            q: Joint positions, (n,) [rad].
            topic: Name of the topic.
        """
        position = dict(zip(names, map(float, q), strict=True))
        self._write(topic, "toolee.Joints", stamp, {"timestamp": _time(stamp), "position": position})

    def record_motion(self, name: str, report: MotionReport, joint_names: Sequence[str]) -> None:
        """Record an arm's motion on `/arm/measured`, `/arm/commanded` and `/arm/wrench`, and its outcome as an event.

        One sample is kept per MOTION_PERIOD, that of the greatest force, so that the peak of a strike is recorded. A
        command that was not sent is not recorded.

        Args:
            name: Name of the motion.
            report: What was commanded and measured.
            joint_names: Names of the arm's joints.
        """
        sent = len(report.stamps) if report.commands is None else report.commands
        for i in _thin(report.stamps, np.linalg.norm(report.wrenches[:, :3], axis=1)):
            stamp = float(report.stamps[i])
            self.record_joints(stamp, joint_names, report.q_measured[i], "/arm/measured")
            if i < sent:
                self.record_joints(stamp, joint_names, report.q_commanded[i], "/arm/commanded")
            wrench = {"force": _xyz(report.wrenches[i, :3]), "torque": _xyz(report.wrenches[i, 3:])}
            self._write("/arm/wrench", "toolee.Wrench", stamp, {"timestamp": _time(stamp)} | wrench)
        if len(report.stamps):
            self.record_event(float(report.stamps[-1]), "motion", {"name": name, "outcome": report.outcome.value})

    def record_contact(self, stamp: float, force: float, X_base_ee: Array) -> None:
        """Record a contact of the face on `/contacts`.

        Args:
            stamp: Time [s].
            force: Sensed force [N].
            X_base_ee: Estimated pose of the end effector in `base`, (4, 4).
        """
        contact = {"timestamp": _time(stamp), "force": float(force), "position": _xyz(X_base_ee[:3, 3])}
        self._write("/contacts", "toolee.Contact", stamp, contact)

    def record_event(self, stamp: float, name: str, data: Mapping[str, Any] | None = None) -> None:
        """Record an event on `/events`.

        Args:
            stamp: Time [s].
            name: Name of the event.
            data: Its data: JSON values, numpy numbers and arrays.
        """
        event = {"timestamp": _time(stamp), "name": name, "data": dict(data or {})}
        self._write("/events", "toolee.Event", stamp, event)

    def record_log(self, stamp: float, text: str, level: str = "info") -> None:
        """Record a message for a person on `/log`.

        Args:
            stamp: Time [s].
            text: The message.
            level: debug, info, warning or error.
        """
        log = {"timestamp": _time(stamp), "level": _LOG_LEVELS[level], "message": text, "name": "toolee"}
        self._write("/log", "foxglove.Log", stamp, log | {"file": "", "line": 0})

    def _write(self, topic: str, schema: str, stamp: float, message: Mapping[str, Any]) -> None:
        if self._file is None:
            raise RuntimeError(f"nothing can be recorded on {topic}: use RunRecorder in a `with` block")
        if topic not in self._channels:
            if schema not in self._schemas:
                text = json.dumps(SCHEMAS[schema]).encode()
                self._schemas[schema] = self._writer.register_schema(schema, SchemaEncoding.JSONSchema, text)
            channel = self._writer.register_channel(topic, MessageEncoding.JSON, self._schemas[schema])
            self._channels[topic] = channel
        data = json.dumps(_plain(message), allow_nan=False, separators=(",", ":")).encode()
        time = _nanoseconds(stamp)
        self._writer.add_message(self._channels[topic], log_time=time, data=data, publish_time=time)


def _nanoseconds(stamp: float) -> int:
    if not (math.isfinite(stamp) and stamp >= 0.0):
        raise ValueError(f"stamp {stamp}: the station's clock counts seconds from 0")
    return round(stamp * 1e9)


def _time(stamp: float) -> dict[str, int]:
    sec, nsec = divmod(_nanoseconds(stamp), 10**9)
    return {"sec": sec, "nsec": nsec}


def _b64(data: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(data).tobytes()).decode("ascii")


def _xyz(v: Array) -> dict[str, float]:
    return dict(zip("xyz", map(float, v), strict=True))


def _pose(X: Array) -> dict[str, dict[str, float]]:
    quaternion = Rotation.from_matrix(X[:3, :3]).as_quat()
    return {"position": _xyz(X[:3, 3]), "orientation": dict(zip("xyzw", map(float, quaternion), strict=True))}


def _calibration(c: CameraIntrinsics) -> dict[str, Any]:
    P = np.hstack([c.matrix, np.zeros((3, 1))])
    return {
        "width": c.width,
        "height": c.height,
        "distortion_model": "plumb_bob",
        "D": [0.0] * 5,
        "K": c.matrix.ravel().tolist(),
        "R": np.eye(3).ravel().tolist(),
        "P": P.ravel().tolist(),
    }


def _thin(stamps: Array, weight: Array) -> list[int]:
    """Select the sample of the greatest weight in each MOTION_PERIOD, and the first and last; returns their indices."""
    if not len(stamps):
        return []
    bins = np.floor((stamps - stamps[0]) / MOTION_PERIOD).astype(int)
    best: dict[int, int] = {}
    for i, b in enumerate(bins):
        if b not in best or weight[i] > weight[best[b]]:
            best[b] = i
    return sorted({0, len(stamps) - 1, *best.values()})


def _plain(value: Any) -> Any:
    """Convert to JSON types: arrays become lists, non-finite numbers become null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

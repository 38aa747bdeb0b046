"""The recording of a run: one MCAP file of images, frames, poses, joints, contacts and events, for Foxglove.

    with RunRecorder(folder / "run.mcap", {"seed": "7"}) as recorder:
        recorder.record_frame(frame)
        recorder.record_pose(stamp, "base", "ee", X_base_ee)

Foxglove's own message types (JSON encoding) where it has one, so that its image, 3D and log panels work unasked; plain
JSON with a schema elsewhere, for its plots. The file grows under a hidden name and gets its own when it is
complete, whatever ended the run. Stamps are seconds on the station's clock.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
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

MOTION_PERIOD = 1 / 125  # [s] between recorded samples of a motion
_FLOAT32 = 7  # foxglove.PackedElementField's code
_LOG_LEVELS = {"debug": 1, "info": 2, "warning": 3, "error": 4}


class RunRecorder:
    """Writes the MCAP file `path`. metadata: text by name, kept with the file. A context manager; the file is complete
    after the context, also when an exception left it. Raises UserError where it cannot be written."""

    def __init__(self, path: Path, metadata: Mapping[str, str] | None = None) -> None:
        self.path = path
        self._part = path.with_name(f".{path.name}.part")
        self._metadata = dict(metadata or {})
        self._file: IO[bytes] | None = None
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}

    def __enter__(self) -> Self:
        try:
            self._file = self._part.open("wb")
        except OSError as error:
            raise UserError(f"cannot write the recording {self.path}: {error.strerror or error}") from error
        self._writer = Writer(self._file)
        self._writer.start(profile="", library=f"toolee_robot {toolee_robot.__version__}")
        self._writer.add_metadata("run", self._metadata)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
        """`/camera/rgb` (PNG), `/camera/depth` (16 bit, millimetres, 0 where unknown) and `/camera/calibration`."""
        header = {"timestamp": _time(frame.stamp), "frame_id": "camera"}
        ok, png = cv2.imencode(".png", cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR))
        if not ok:
            raise UserError("the colour image could not be encoded as PNG: it is empty")
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
        """X_parent_child, 4x4, as a transform on `/tf`."""
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
        """Points (N, 3) [m] in `frame`, on `/perception/cloud`."""
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
        """Candidate poses (K, 4, 4) of the EE in `frame`, on `/perception/hypotheses`."""
        poses = {"timestamp": _time(stamp), "frame_id": frame, "poses": [_pose(X) for X in Xs]}
        self._write("/perception/hypotheses", "foxglove.PosesInFrame", stamp, poses)

    def record_joints(self, stamp: float, names: Sequence[str], q: Array, topic: str = "/joints") -> None:
        """Joint positions (n,) [rad] by name, on `topic`."""
        position = dict(zip(names, map(float, q), strict=True))
        self._write(topic, "toolee.Joints", stamp, {"timestamp": _time(stamp), "position": position})

    def record_motion(self, name: str, report: MotionReport, joint_names: Sequence[str]) -> None:
        """An arm's motion: `/arm/measured`, `/arm/commanded` and `/arm/wrench`, and its outcome as an event. Thinned to
        MOTION_PERIOD: of each period the sample of the greatest force, so that no strike's peak is lost."""
        for i in _thin(report.stamps, np.linalg.norm(report.wrenches[:, :3], axis=1)):
            stamp = float(report.stamps[i])
            self.record_joints(stamp, joint_names, report.q_measured[i], "/arm/measured")
            self.record_joints(stamp, joint_names, report.q_commanded[i], "/arm/commanded")
            wrench = {"force": _xyz(report.wrenches[i, :3]), "torque": _xyz(report.wrenches[i, 3:])}
            self._write("/arm/wrench", "toolee.Wrench", stamp, {"timestamp": _time(stamp)} | wrench)
        if len(report.stamps):
            self.record_event(float(report.stamps[-1]), "motion", {"name": name, "outcome": report.outcome.value})

    def record_contact(self, stamp: float, force: float, X_base_ee: Array) -> None:
        """The face met something: sensed force [N] and where the EE was believed to be, on `/contacts`."""
        contact = {"timestamp": _time(stamp), "force": float(force), "position": _xyz(X_base_ee[:3, 3])}
        self._write("/contacts", "toolee.Contact", stamp, contact)

    def record_event(self, stamp: float, name: str, data: Mapping[str, Any] | None = None) -> None:
        """Something that happened, with whatever belongs to it (JSON values, numpy numbers and arrays): `/events`."""
        event = {"timestamp": _time(stamp), "name": name, "data": dict(data or {})}
        self._write("/events", "toolee.Event", stamp, event)

    def record_log(self, stamp: float, text: str, level: str = "info") -> None:
        """A sentence for the person, on `/log`. level: debug, info, warning or error."""
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
    """Indices of the sample of the greatest weight in each MOTION_PERIOD, and of the first and last."""
    if not len(stamps):
        return []
    bins = np.floor((stamps - stamps[0]) / MOTION_PERIOD).astype(int)
    best: dict[int, int] = {}
    for i, b in enumerate(bins):
        if b not in best or weight[i] > weight[best[b]]:
            best[b] = i
    return sorted({0, len(stamps) - 1, *best.values()})


def _plain(value: Any) -> Any:
    """JSON's own types: arrays become lists, what is not finite becomes null."""
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

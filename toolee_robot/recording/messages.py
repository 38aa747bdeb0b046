"""Messages of a recording: Foxglove's, made with its SDK, and our own ones where it has none."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from foxglove import Schema
from foxglove import messages as sdk
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.records import Schema as McapSchema
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array
from toolee_robot.hal import ArmState
from toolee_robot.types import CameraIntrinsics, InHandEstimate, RgbdFrame, ToolEstimate

LOG_LEVELS = {
    "debug": sdk.LogLevel.Debug, "info": sdk.LogLevel.Info, "warning": sdk.LogLevel.Warning,
    "error": sdk.LogLevel.Error,
}  # fmt: skip
"""Levels of `foxglove.Log` by name."""
_FIELD = descriptor_pb2.FieldDescriptorProto
_SCALARS = {
    "double": _FIELD.TYPE_DOUBLE, "string": _FIELD.TYPE_STRING, "bool": _FIELD.TYPE_BOOL, "uint32": _FIELD.TYPE_UINT32,
}  # fmt: skip
_OWN = {
    "Wrench": {"force": "foxglove.Vector3", "torque": "foxglove.Vector3"},
    "Contact": {"force": "double", "position": "foxglove.Vector3"},
    "StopRatios": {"position_deviation": "double", "collision": "double"},
    "JointCurrents": {"currents": "double*"},
    "SafetyBits": {"bits": "uint32"},
    "ArmStatus": {
        "status": "string", "digital_inputs": "uint32", "safety_bits": "uint32?", "error_code": "string?",
    },
    "Estimate": {
        "frame_id": "string", "category": "string", "pose": "foxglove.Pose", "covariance": "double*",
        "confidence": "double", "trust": "double", "usable": "bool", "reason": "string", "score": "double",
        "box": "double*", "frames_used": "uint32", "frames_seen": "uint32",
    },
    "Decision": {"name": "string", "reason": "string", "data": "string"},
}  # fmt: skip
"""Our own messages: their fields in order, after the timestamp; `*` marks a list, `?` what may be absent."""


@dataclass(frozen=True)
class Packed:
    """A message as it is written.

    Attributes:
        schema: Its schema.
        data: Its content, by Protocol Buffers.
    """

    schema: Schema
    data: bytes


def decoder(schema: Schema | McapSchema) -> Callable[[bytes], Any]:
    """What makes messages of their bytes, with fields as attributes, by a schema as a recording has it."""
    return _message_class(schema.name, schema.data).FromString


def nanoseconds(stamp: float) -> int:
    """Convert a stamp on the station's clock [s] to nanoseconds; raises ValueError if it is negative or not finite."""
    if not (math.isfinite(stamp) and stamp >= 0.0):
        raise ValueError(f"stamp {stamp}: the station's clock counts seconds from 0")
    return round(stamp * 1e9)


def transform_message(stamp: float, parent: str, child: str, X: Array) -> Packed:
    """X_parent_child, (4, 4), as a transform."""
    one = sdk.FrameTransform(
        timestamp=_timestamp(stamp), parent_frame_id=parent, child_frame_id=child, translation=_vector(X[:3, 3]),
        rotation=_quaternion(X),
    )  # fmt: skip
    return _packed(sdk.FrameTransforms(transforms=[one]))


def color_image(frame: RgbdFrame, png: bytes) -> Packed:
    """A frame's colour image, which is given as PNG."""
    return _packed(sdk.CompressedImage(timestamp=_timestamp(frame.stamp), frame_id="camera", data=png, format="png"))


def depth_image(frame: RgbdFrame) -> Packed:
    """A frame's depth image, as it is: 32 bit, metres."""
    height, width = frame.depth.shape
    data = np.ascontiguousarray(frame.depth, dtype="<f4").tobytes()
    return _packed(
        sdk.RawImage(
            timestamp=_timestamp(frame.stamp), frame_id="camera", width=width, height=height, encoding="32FC1",
            step=4 * width, data=data,
        )
    )  # fmt: skip


def calibration(stamp: float, c: CameraIntrinsics) -> Packed:
    """A camera's intrinsics."""
    return _packed(
        sdk.CameraCalibration(
            timestamp=_timestamp(stamp), frame_id="camera", width=c.width, height=c.height,
            distortion_model="plumb_bob", D=[0.0] * 5, K=c.matrix.ravel().tolist(), R=np.eye(3).ravel().tolist(),
            P=np.hstack([c.matrix, np.zeros((3, 1))]).ravel().tolist(),
        )
    )  # fmt: skip


def point_cloud(stamp: float, frame: str, points: Array) -> Packed:
    """Points, (N, 3) [m], in the axes of a frame."""
    single = sdk.PackedElementFieldNumericType.Float32
    fields = [sdk.PackedElementField(name=name, offset=4 * i, type=single) for i, name in enumerate("xyz")]
    data = np.asarray(points, dtype="<f4").reshape(-1, 3).tobytes()
    return _packed(
        sdk.PointCloud(
            timestamp=_timestamp(stamp), frame_id=frame, pose=_pose(np.eye(4)), point_stride=12, fields=fields,
            data=data,
        )
    )  # fmt: skip


def poses_in_frame(stamp: float, frame: str, Xs: Array) -> Packed:
    """Poses, (K, 4, 4), in the axes of a frame."""
    return _packed(sdk.PosesInFrame(timestamp=_timestamp(stamp), frame_id=frame, poses=[_pose(X) for X in Xs]))


def joint_states(
    stamp: float, names: Sequence[str], q: Array, velocity: Array | None = None, effort: Array | None = None
) -> Packed:
    """Joint positions (n,) [rad], with velocities [rad/s] and torques [Nm] where they are known."""
    joints = [
        sdk.JointState(
            name=name, position=float(q[i]), velocity=None if velocity is None else float(velocity[i]),
            effort=None if effort is None else float(effort[i]),
        )
        for i, name in enumerate(names)
    ]  # fmt: skip
    return _packed(sdk.JointStates(timestamp=_timestamp(stamp), joints=joints))


def wrench(stamp: float, values: Array) -> Packed:
    """Force [N] and torque [Nm], (6,)."""
    return _own("Wrench", stamp, force=_xyz(values[:3]), torque=_xyz(values[3:]))


def contact(stamp: float, force: float, position: Array) -> Packed:
    """A contact: its force [N] and its place, (3,) [m]."""
    return _own("Contact", stamp, force=float(force), position=_xyz(position))


def stop_ratios(stamp: float, position_deviation: float, collision: float) -> Packed:
    """How near the arm is to its protective stops, which come at 1."""
    return _own("StopRatios", stamp, position_deviation=float(position_deviation), collision=float(collision))


def joint_currents(stamp: float, currents: Array) -> Packed:
    """Currents of the joints' motors, (n,) [A]."""
    return _own("JointCurrents", stamp, currents=currents.tolist())


def safety_bits(stamp: float, bits: int) -> Packed:
    """The controller's own safety status."""
    return _own("SafetyBits", stamp, bits=int(bits))


def arm_status(stamp: float, state: ArmState) -> Packed:
    """State of the arm's own safety system."""
    return _own(
        "ArmStatus", stamp, status=str(state.status), digital_inputs=state.digital_inputs,
        safety_bits=state.safety_bits, error_code=state.error_code,
    )  # fmt: skip


def estimate(stamp: float, e: ToolEstimate) -> Packed:
    """An estimate from one frame, in the camera's frame."""
    return _own(
        "Estimate", stamp, frame_id="camera", category=str(e.category), pose=_known_pose(e.X_camera_ee),
        covariance=e.covariance.ravel().tolist(), confidence=e.confidence, trust=e.trust, usable=e.usable,
        reason=e.reason, score=e.detection.score, box=list(e.detection.box), frames_used=1, frames_seen=1,
    )  # fmt: skip


def in_hand(stamp: float, e: InHandEstimate) -> Packed:
    """An estimate fused over frames, in the hand's frame."""
    return _own(
        "Estimate", stamp, frame_id="hand", category=str(e.category), pose=_known_pose(e.X_hand_ee),
        covariance=e.covariance.ravel().tolist(), confidence=e.confidence, usable=e.usable, reason=e.reason,
        frames_used=e.frames_used, frames_seen=e.frames_seen,
    )  # fmt: skip


def decision(stamp: float, name: str, reason: str, data: Mapping[str, Any]) -> Packed:
    """A decision: its kind, the reason for a person, and data, which become JSON text."""
    return _own("Decision", stamp, name=name, reason=reason, data=json.dumps(plain(data)))


def log(stamp: float, text: str, level: str) -> Packed:
    """A sentence for a person; `level` is debug, info, warning or error."""
    return _packed(sdk.Log(timestamp=_timestamp(stamp), level=LOG_LEVELS[level], message=text, name="toolee"))


def matrix(position: Any, orientation: Any) -> Array:
    """The pose that a message tells by a position [m] and a quaternion, (4, 4)."""
    X = np.eye(4)
    X[:3, :3] = Rotation.from_quat([orientation.x, orientation.y, orientation.z, orientation.w]).as_matrix()
    X[:3, 3] = position.x, position.y, position.z
    return X


def plain(value: Any) -> Any:
    """Convert to JSON values: arrays become lists, what is not finite becomes null, enumerations text."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, str | bool | int | float | type(None)) else str(value)


def as_text(value: Any) -> str:
    """Metadata of a recording are text: strings as they are, everything else as JSON."""
    return value if isinstance(value, str) else json.dumps(plain(value))


def _timestamp(stamp: float) -> sdk.Timestamp:
    return sdk.Timestamp(*divmod(nanoseconds(stamp), 10**9))


def _vector(v: Array) -> sdk.Vector3:
    return sdk.Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def _quaternion(X: Array) -> sdk.Quaternion:
    x, y, z, w = Rotation.from_matrix(X[:3, :3]).as_quat().tolist()
    return sdk.Quaternion(x=x, y=y, z=z, w=w)


def _pose(X: Array) -> sdk.Pose:
    return sdk.Pose(position=_vector(X[:3, 3]), orientation=_quaternion(X))


def _xyz(v: Array) -> dict[str, float]:
    return dict(zip("xyz", map(float, v), strict=True))


def _known_pose(X: Array) -> dict[str, dict[str, float]] | None:
    if not np.all(np.isfinite(X)):
        return None
    turn = Rotation.from_matrix(X[:3, :3]).as_quat().tolist()
    return {"position": _xyz(X[:3, 3]), "orientation": dict(zip("xyzw", turn, strict=True))}


def _packed(message: Any) -> Packed:
    kind: Any = type(message)
    return Packed(_schema_of(kind), message.encode())


@cache
def _schema_of(kind: Any) -> Schema:
    schema: Schema = kind.get_schema()
    return schema


def _own(kind: str, stamp: float, /, **fields: Any) -> Packed:
    """One of our own messages; fields that are None are left out."""
    sec, nanos = divmod(nanoseconds(stamp), 10**9)
    schema, make = _own_kind(kind)
    return Packed(schema, make(timestamp={"seconds": sec, "nanos": nanos}, **fields).SerializeToString())


@cache
def _own_kind(name: str) -> tuple[Schema, Any]:
    """Schema and class of one of our own messages; the schema describes Foxglove's that it holds, too."""
    files = descriptor_pb2.FileDescriptorSet.FromString(sdk.PosesInFrame.get_schema().data).file
    file = descriptor_pb2.FileDescriptorProto(name="toolee/recording.proto", package="toolee", syntax="proto3")
    file.dependency.extend(used.name for used in files)
    for own, fields in _OWN.items():
        message = file.message_type.add(name=own)
        for number, (field, kind) in enumerate({"timestamp": "google.protobuf.Timestamp", **fields}.items(), 1):
            scalar = _SCALARS.get(kind.rstrip("*?"))
            label = _FIELD.LABEL_REPEATED if kind.endswith("*") else _FIELD.LABEL_OPTIONAL
            added = message.field.add(name=field, number=number, label=label, type=scalar or _FIELD.TYPE_MESSAGE)
            if scalar is None:
                added.type_name = f".{kind}"
            if kind.endswith("?"):  # proto3 tells absent from 0 by a `oneof` of this field alone
                added.proto3_optional, added.oneof_index = True, len(message.oneof_decl)
                message.oneof_decl.add(name=f"_{field}")
    described = descriptor_pb2.FileDescriptorSet(file=[*files, file])
    schema = Schema(name=f"toolee.{name}", encoding="protobuf", data=described.SerializeToString())
    return schema, _message_class(schema.name, schema.data)


@cache
def _message_class(name: str, described: bytes) -> Any:
    """Class of a message, by a schema that describes it."""
    files = {file.name: file for file in descriptor_pb2.FileDescriptorSet.FromString(described).file}
    pool = descriptor_pool.DescriptorPool()

    def add(file: descriptor_pb2.FileDescriptorProto) -> None:
        for needed in file.dependency:
            if needed in files:
                add(files.pop(needed))
        pool.Add(file)

    while files:
        add(files.pop(next(iter(files))))
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))

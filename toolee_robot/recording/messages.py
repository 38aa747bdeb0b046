"""Builds the messages of a recording: Foxglove's published Protocol Buffers, and those of `own_messages`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array
from toolee_robot.hal import ArmState
from toolee_robot.recording.own_messages import (
    ArmStatus,
    Decision,
    Estimate,
    JointCurrents,
)
from toolee_robot.types import CameraIntrinsics, InHandEstimate, RgbdFrame, ToolEstimate

LOG_LEVELS = {"debug": 1, "info": 2, "warning": 3, "error": 4}
"""Levels of `foxglove.Log` by name."""


def nanoseconds(stamp: float) -> int:
    """Convert a stamp on the station's clock [s] to nanoseconds; raises ValueError if it is negative or not finite."""
    if not (math.isfinite(stamp) and stamp >= 0.0):
        raise ValueError(f"stamp {stamp}: the station's clock counts seconds from 0")
    return round(stamp * 1e9)


def seconds(timestamp: Timestamp) -> float:
    """The time [s] of a message's timestamp."""
    return float(timestamp.seconds + timestamp.nanos * 1e-9)


def timestamp(stamp: float) -> Timestamp:
    """The message of a stamp [s]."""
    sec, nanos = divmod(nanoseconds(stamp), 10**9)
    return Timestamp(seconds=sec, nanos=nanos)


def pose(X: Array) -> Pose:
    """The message of a pose, (4, 4)."""
    x, y, z, w = Rotation.from_matrix(X[:3, :3]).as_quat().tolist()
    return Pose(position=vector(X[:3, 3]), orientation=Quaternion(x=x, y=y, z=z, w=w))


def vector(v: Array) -> Vector3:
    """The message of a vector, (3,)."""
    x, y, z = map(float, v)
    return Vector3(x=x, y=y, z=z)


def transform_message(stamp: float, parent: str, child: str, X: Array) -> FrameTransforms:
    """The message of a transform.

    Args:
        stamp: Time [s].
        parent: Name of the parent frame.
        child: Name of the child frame.
        X: X_parent_child, (4, 4).

    Returns:
        The message.
    """
    p = pose(X)
    one = FrameTransform(
        timestamp=timestamp(stamp), parent_frame_id=parent, child_frame_id=child, translation=p.position,
        rotation=p.orientation,
    )  # fmt: skip
    return FrameTransforms(transforms=[one])


def color_image(frame: RgbdFrame, png: bytes) -> CompressedImage:
    """The message of a frame's colour image.

    Args:
        frame: The frame.
        png: Its colour image as PNG.

    Returns:
        The message.
    """
    return CompressedImage(timestamp=timestamp(frame.stamp), frame_id="camera", data=png, format="png")


def depth_image(frame: RgbdFrame) -> RawImage:
    """The message of a frame's depth image, as it is: 32 bit, metres."""
    height, width = frame.depth.shape
    data = np.ascontiguousarray(frame.depth, dtype="<f4").tobytes()
    return RawImage(
        timestamp=timestamp(frame.stamp), frame_id="camera", width=width, height=height, encoding="32FC1",
        step=4 * width, data=data,
    )  # fmt: skip


def calibration(stamp: float, c: CameraIntrinsics) -> CameraCalibration:
    """The message of a camera's intrinsics.

    Args:
        stamp: Time [s].
        c: The intrinsics.

    Returns:
        The message.
    """
    return CameraCalibration(
        timestamp=timestamp(stamp), frame_id="camera", width=c.width, height=c.height, distortion_model="plumb_bob",
        D=[0.0] * 5, K=c.matrix.ravel().tolist(), R=np.eye(3).ravel().tolist(),
        P=np.hstack([c.matrix, np.zeros((3, 1))]).ravel().tolist(),
    )  # fmt: skip


def point_cloud(stamp: float, frame: str, points: Array) -> PointCloud:
    """The message of points.

    Args:
        stamp: Time [s].
        frame: Name of the points' frame.
        points: The points, (N, 3) [m].

    Returns:
        The message.
    """
    fields = [
        PackedElementField(name=name, offset=4 * i, type=PackedElementField.FLOAT32) for i, name in enumerate("xyz")
    ]
    data = np.asarray(points, dtype="<f4").reshape(-1, 3).tobytes()
    return PointCloud(
        timestamp=timestamp(stamp), frame_id=frame, pose=pose(np.eye(4)), point_stride=12, fields=fields, data=data
    )


def poses_in_frame(stamp: float, frame: str, Xs: Array) -> PosesInFrame:
    """The message of poses.

    Args:
        stamp: Time [s].
        frame: Name of the poses' frame.
        Xs: The poses, (K, 4, 4).

    Returns:
        The message.
    """
    return PosesInFrame(timestamp=timestamp(stamp), frame_id=frame, poses=[pose(X) for X in Xs])


def joint_states(
    stamp: float, names: Sequence[str], q: Array, velocity: Array | None = None, effort: Array | None = None
) -> JointStates:
    """The message of joint positions.

    Args:
        stamp: Time [s].
        names: Names of the n joints.
        q: Joint positions, (n,) [rad].
        velocity: Joint velocities, (n,) [rad/s]; None where they are not known.
        effort: Joint torques, (n,) [Nm]; None likewise.

    Returns:
        The message.
    """
    joints = [JointState(name=name, position=float(p)) for name, p in zip(names, q, strict=True)]
    for i, joint in enumerate(joints):
        if velocity is not None:
            joint.velocity = float(velocity[i])
        if effort is not None:
            joint.effort = float(effort[i])
    return JointStates(timestamp=timestamp(stamp), joints=joints)


def joint_currents(stamp: float, currents: Array) -> Any:
    """The message of motor currents.

    Args:
        stamp: Time [s].
        currents: Currents of the joints' motors, (n,) [A].

    Returns:
        The message.
    """
    return JointCurrents(timestamp=timestamp(stamp), currents=currents.tolist())


def arm_status(stamp: float, state: ArmState) -> Any:
    """The message of the arm's own safety system.

    Args:
        stamp: Time [s].
        state: State of the arm.

    Returns:
        The message.
    """
    return ArmStatus(
        timestamp=timestamp(stamp), status=str(state.status), digital_inputs=state.digital_inputs,
        safety_bits=state.safety_bits, error_code=state.error_code,
    )  # fmt: skip


def estimate(stamp: float, e: ToolEstimate) -> Any:
    """The message of an estimate from one frame.

    Args:
        stamp: Time [s].
        e: The estimate, in the camera's frame.

    Returns:
        The message.
    """
    return Estimate(
        timestamp=timestamp(stamp), frame_id="camera", category=str(e.category), pose=_known_pose(e.X_camera_ee),
        covariance=e.covariance.ravel().tolist(), confidence=e.confidence, trust=e.trust, usable=e.usable,
        reason=e.reason, score=e.detection.score, box=list(e.detection.box), frames_used=1, frames_seen=1,
    )  # fmt: skip


def in_hand(stamp: float, e: InHandEstimate) -> Any:
    """The message of an estimate fused over frames.

    Args:
        stamp: Time [s].
        e: The estimate, in the hand's frame.

    Returns:
        The message.
    """
    return Estimate(
        timestamp=timestamp(stamp), frame_id="hand", category=str(e.category), pose=_known_pose(e.X_hand_ee),
        covariance=e.covariance.ravel().tolist(), confidence=e.confidence, usable=e.usable, reason=e.reason,
        frames_used=e.frames_used, frames_seen=e.frames_seen,
    )  # fmt: skip


def decision(stamp: float, name: str, reason: str, data: Mapping[str, Any]) -> Any:
    """The message of a decision.

    Args:
        stamp: Time [s].
        name: Its kind.
        reason: The reason, for a person.
        data: Its data, which become JSON text.

    Returns:
        The message.
    """
    return Decision(timestamp=timestamp(stamp), name=name, reason=reason, data=json.dumps(plain(data)))


def log(stamp: float, text: str, level: str) -> Log:
    """The message of a sentence for a person.

    Args:
        stamp: Time [s].
        text: The sentence.
        level: debug, info, warning or error.

    Returns:
        The message.
    """
    return Log(timestamp=timestamp(stamp), level=LOG_LEVELS[level], message=text, name="toolee")  # type: ignore[arg-type]


def matrix(position: Any, orientation: Any) -> Array:
    """The pose that a message tells.

    Args:
        position: Its position [m].
        orientation: Its quaternion.

    Returns:
        The pose, (4, 4).
    """
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


def _known_pose(X: Array) -> Pose | None:
    return pose(X) if np.all(np.isfinite(X)) else None

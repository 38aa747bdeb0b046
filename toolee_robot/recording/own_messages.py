"""Messages of a recording that no maintained schema covers; the recording describes them itself."""

from __future__ import annotations

from typing import Any

from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.timestamp_pb2 import Timestamp

_FIELD = descriptor_pb2.FieldDescriptorProto
_SCALARS = {"double": _FIELD.TYPE_DOUBLE, "string": _FIELD.TYPE_STRING, "bool": _FIELD.TYPE_BOOL}
_SCALARS["uint32"] = _FIELD.TYPE_UINT32
_OWN = {
    "Wrench": {"timestamp": "google.protobuf.Timestamp", "force": "foxglove.Vector3", "torque": "foxglove.Vector3"},
    "Contact": {"timestamp": "google.protobuf.Timestamp", "force": "double", "position": "foxglove.Vector3"},
    "StopRatios": {"timestamp": "google.protobuf.Timestamp", "position_deviation": "double", "collision": "double"},
    "JointCurrents": {"timestamp": "google.protobuf.Timestamp", "currents": "double*"},
    "SafetyBits": {"timestamp": "google.protobuf.Timestamp", "bits": "uint32"},
    "ArmStatus": {
        "timestamp": "google.protobuf.Timestamp", "status": "string", "digital_inputs": "uint32",
        "safety_bits": "uint32?", "error_code": "string?",
    },
    "Estimate": {
        "timestamp": "google.protobuf.Timestamp", "frame_id": "string", "category": "string", "pose": "foxglove.Pose",
        "covariance": "double*", "confidence": "double", "trust": "double", "usable": "bool", "reason": "string",
        "score": "double", "box": "double*", "frames_used": "uint32", "frames_seen": "uint32",
    },
    "Decision": {
        "timestamp": "google.protobuf.Timestamp", "name": "string", "reason": "string",
        "data": "string",
    },
}  # fmt: skip
"""Messages that no maintained schema covers: their fields in order; `*` marks a list, `?` what may be absent."""


def _own_messages() -> dict[str, type[Any]]:
    """Classes of the messages in _OWN; the file that describes them goes into every recording."""
    file = descriptor_pb2.FileDescriptorProto(name="toolee/recording.proto", package="toolee", syntax="proto3")
    used = (Timestamp, Vector3, Pose)
    file.dependency.extend(kind.DESCRIPTOR.file.name for kind in used)
    for name, fields in _OWN.items():
        message = file.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields.items(), 1):
            scalar = _SCALARS.get(kind.rstrip("*?"))
            label = _FIELD.LABEL_REPEATED if kind.endswith("*") else _FIELD.LABEL_OPTIONAL
            added = message.field.add(name=field, number=number, label=label, type=scalar or _FIELD.TYPE_MESSAGE)
            if scalar is None:
                added.type_name = f".{kind}"
            if kind.endswith("?"):  # proto3 tells absent from 0 by a `oneof` of this field alone
                added.proto3_optional, added.oneof_index = True, len(message.oneof_decl)
                message.oneof_decl.add(name=f"_{field}")
    descriptor_pool.Default().Add(file)
    find = descriptor_pool.Default().FindMessageTypeByName
    return {name: message_factory.GetMessageClass(find(f"toolee.{name}")) for name in _OWN}


_CLASSES = _own_messages()
Wrench, Contact, StopRatios = _CLASSES["Wrench"], _CLASSES["Contact"], _CLASSES["StopRatios"]
JointCurrents, SafetyBits = _CLASSES["JointCurrents"], _CLASSES["SafetyBits"]
ArmStatus, Estimate, Decision = _CLASSES["ArmStatus"], _CLASSES["Estimate"], _CLASSES["Decision"]

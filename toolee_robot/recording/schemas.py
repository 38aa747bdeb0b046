"""JSON schemas of the recorded messages. The `foxglove.*` ones are Foxglove's well-known types, by name and fields."""

from __future__ import annotations

from typing import Any

_NUMBER = {"type": "number"}
_INTEGER = {"type": "integer"}
_TEXT = {"type": "string"}
_BYTES = {"type": "string", "contentEncoding": "base64"}
_ANY = {"type": "object"}


def _object(title: str, **properties: Any) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


def _array(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_TIME = _object("time", sec=_INTEGER, nsec=_INTEGER)
_VECTOR = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
_HEADER = {"timestamp": _TIME, "frame_id": _TEXT}

_ALL = [
    _object("foxglove.CompressedImage", **_HEADER, data=_BYTES, format=_TEXT),
    _object(
        "foxglove.RawImage", **_HEADER, width=_INTEGER, height=_INTEGER, encoding=_TEXT, step=_INTEGER, data=_BYTES
    ),
    _object(
        "foxglove.CameraCalibration",
        **_HEADER,
        width=_INTEGER,
        height=_INTEGER,
        distortion_model=_TEXT,
        D=_array(_NUMBER),
        K=_array(_NUMBER) | {"minItems": 9, "maxItems": 9},
        R=_array(_NUMBER) | {"minItems": 9, "maxItems": 9},
        P=_array(_NUMBER) | {"minItems": 12, "maxItems": 12},
    ),
    _object(
        "foxglove.FrameTransforms",
        transforms=_array(
            _object(
                "foxglove.FrameTransform",
                timestamp=_TIME,
                parent_frame_id=_TEXT,
                child_frame_id=_TEXT,
                translation=_VECTOR,
                rotation=_QUATERNION,
            )
        ),
    ),
    _object(
        "foxglove.PointCloud",
        **_HEADER,
        pose=_POSE,
        point_stride=_INTEGER,
        fields=_array(_object("foxglove.PackedElementField", name=_TEXT, offset=_INTEGER, type=_INTEGER)),
        data=_BYTES,
    ),
    _object("foxglove.PosesInFrame", **_HEADER, poses=_array(_POSE)),
    _object("foxglove.Log", timestamp=_TIME, level=_INTEGER, message=_TEXT, name=_TEXT, file=_TEXT, line=_INTEGER),
    _object("toolee.Joints", timestamp=_TIME, position=_ANY),
    _object("toolee.Wrench", timestamp=_TIME, force=_VECTOR, torque=_VECTOR),
    _object("toolee.Contact", timestamp=_TIME, force=_NUMBER, position=_VECTOR),
    _object("toolee.Event", timestamp=_TIME, name=_TEXT, data=_ANY),
]

SCHEMAS: dict[str, dict[str, Any]] = {schema["title"]: schema for schema in _ALL}

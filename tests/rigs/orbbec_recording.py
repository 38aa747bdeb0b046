"""Recordings in the format of OrbbecSDK 2, which its playback device opens like a camera: for the Orbbec driver.

The container is ROS 1's bag, version 2.0 (wiki.ros.org/Bags/Format/2.0); topics and messages are those that
OrbbecSDK_v2 (MIT) reads in src/media/ros/RosbagReader.cpp, with the checksums of its message headers.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from toolee_robot.types import CameraIntrinsics

SERIAL = "CL8T1240042"
FPS = 30
COLOR = CameraIntrinsics(373.5, 373.2, 319.1, 241.3, 640, 480)
COLOR_DISTORTION = (0.075, -0.105, 0.041, 0.0, 0.0, 0.0, 2e-4, -1e-4)
"""k1 to k6, p1, p2."""
DEPTH = CameraIntrinsics(252.3, 252.4, 165.1, 169.0, 320, 288)
DEPTH_DISTORTION = (0.6, 0.2, 0.01, 0.95, 0.38, 0.04, -5e-5, 3e-5)
TRANSLATION_MM = (-32.1, -2.2, 4.0)
"""Of the depth camera in the colour camera."""
BROWN_CONRADY, BROWN_CONRADY_K6 = 3, 4
_FEMTO_BOLT = (0x2BC5, 0x066B)
_BEGIN = 100_000_000
_TYPES = {
    "image": ("sensor_msgs/Image", "060021388200f6f0f447d0fcd9c64743"),
    "profile": ("custom_msg/OBStreamProfileInfo", "0123456789abcdef" * 2),
    "property": ("custom_msg/OBProperty", "0123456789abcdef" * 2),
    "info": ("custom_msg/OBDeviceInfo", "afef5328bb4abebd1a309e1ea8b26b3a"),
}

Message = tuple[str, int, str, bytes]
"""Topic, time [us], kind, and the message itself."""


def write_recording(
    path: Path,
    pictures: Sequence[tuple[NDArray[np.uint8], NDArray[np.uint16]]],
    serial: str = SERIAL,
    *,
    color: CameraIntrinsics = COLOR,
    depth: CameraIntrinsics = DEPTH,
    last_stamp: int | None = None,
) -> None:
    """Write a recording of a Femto Bolt, at FPS."""
    t = _BEGIN
    messages = [
        ("/cam/deviceInfo", t, "info", _info(t, serial)),
        ("/cam/property", t, "property", _header(t) + _u32(0, 8) + struct.pack("<d", 2.0) + _u32(8)),  # of the format
        ("/cam/streamProfileType_3", t, "profile", _profile(t, 3, 8, depth, DEPTH_DISTORTION, BROWN_CONRADY_K6)),
        ("/cam/streamProfileType_2", t, "profile", _profile(t, 2, 22, color, COLOR_DISTORTION, BROWN_CONRADY)),
    ]
    for number, (rgb, deep) in enumerate(pictures):
        t = _BEGIN + number * 1_000_000 // FPS
        stamped = number if last_stamp is None else min(number, last_stamp)
        stamp = _BEGIN + stamped * 1_000_000 // FPS
        messages.append(("/cam/sensor_3/frameType_3", t, "image", _image(stamp, deep, "mono16", number)))
        messages.append(("/cam/sensor_2/frameType_2", t, "image", _image(stamp, rgb, "rgb8", number)))
    _write_bag(path, messages)


def _u32(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}I", *values)


def _text(text: str) -> bytes:
    return _u32(len(text)) + text.encode()


def _time(us: int) -> bytes:
    return _u32(us // 10**6, us % 10**6 * 1000)


def _header(us: int) -> bytes:
    return _u32(0) + _time(us) + _text("")


def _info(us: int, serial: str) -> bytes:
    names = [_text(name) for name in ("uid", serial, "1.1.2", "1.0", "1.9.9", "USB3.1")]
    head = _header(us) + _text("Femto Bolt") + _text("Orbbec Femto Bolt") + _text("")
    return head + struct.pack("<HH", *_FEMTO_BOLT) + b"".join(names) + b"\1\0\0" + _text("") + _text("")


def _profile(
    us: int, stream: int, layout: int, k: CameraIntrinsics, distortion: tuple[float, ...], model: int
) -> bytes:
    pose = struct.pack("<12f", *np.eye(3).ravel(), *TRANSLATION_MM)
    size = struct.pack("<HHH", k.width, k.height, FPS)
    lens = struct.pack("<12fB", k.fx, k.fy, k.cx, k.cy, *distortion, model)
    return _header(us) + bytes([stream, layout]) + pose + size + lens


def _image(us: int, image: NDArray[np.uint8] | NDArray[np.uint16], encoding: str, number: int) -> bytes:
    height, width = image.shape[:2]
    data = image.tobytes()
    head = _header(us) + _u32(height, width) + _text(encoding) + b"\0" + _u32(len(data) // height, len(data)) + data
    bits = 16 if image.dtype == np.uint16 else 8
    return head + struct.pack("<fQQQQIIB", 1.0, number, us, us, us, 0, 0, bits)


def _record(data: bytes, **fields: bytes) -> bytes:
    header = _fields(**fields)
    return _u32(len(header)) + header + _u32(len(data)) + data


def _fields(**fields: bytes) -> bytes:
    named = [name.encode() + b"=" + value for name, value in fields.items()]
    return b"".join(_u32(len(one)) + one for one in named)


def _connection(topic: str, number: int, kind: str) -> bytes:
    of_type, md5 = _TYPES[kind]
    data = _fields(topic=topic.encode(), type=of_type.encode(), md5sum=md5.encode(), message_definition=b"")
    return _record(data, conn=_u32(number), op=b"\x07", topic=topic.encode())


def _write_bag(path: Path, messages: Sequence[Message]) -> None:
    connections: dict[str, tuple[int, str]] = {}
    index: dict[int, list[bytes]] = {}
    chunk = bytearray()
    for topic, us, kind, data in messages:
        if topic not in connections:
            connections[topic] = (len(connections), kind)
            chunk += _connection(topic, *connections[topic])
        number = connections[topic][0]
        index.setdefault(number, []).append(_time(us) + _u32(len(chunk)))
        chunk += _record(data, conn=_u32(number), op=b"\x02", time=_time(us))
    begin = b"#ROSBAG V2.0\n"
    chunk_at = len(begin) + 4096
    body = bytearray(_record(bytes(chunk), compression=b"none", op=b"\x05", size=_u32(len(chunk))))
    for number, entries in index.items():
        count = _u32(len(entries))
        body += _record(b"".join(entries), conn=_u32(number), count=count, op=b"\x04", ver=_u32(1))
    index_at = chunk_at + len(body)
    for topic, (number, kind) in connections.items():
        body += _connection(topic, number, kind)
    times = [us for _, us, _, _ in messages]
    counts = b"".join(_u32(number, len(entries)) for number, entries in index.items())
    body += _record(
        counts, chunk_pos=struct.pack("<Q", chunk_at), count=_u32(len(index)), end_time=_time(max(times)), op=b"\x06",
        start_time=_time(min(times)), ver=_u32(1),
    )  # fmt: skip
    header = _fields(
        chunk_count=_u32(1), conn_count=_u32(len(connections)), index_pos=struct.pack("<Q", index_at), op=b"\x03"
    )
    padding = 4096 - 8 - len(header)
    path.write_bytes(begin + _u32(len(header)) + header + _u32(padding) + b" " * padding + bytes(body))

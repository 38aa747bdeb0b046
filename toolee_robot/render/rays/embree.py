"""Rays against triangles, sixteen at a time: embree's packets, called through its C interface.

The package `embreex` brings the library, but its own calls shoot one ray at a time: neighbouring pixels' rays go the
same way through the tree, and in packets they take a third to a quarter of the time.
"""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Sequence
from functools import lru_cache
from itertools import repeat
from typing import Any

import numpy as np
import warp as wp
from embreex import rtcore_scene
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.render.device import DeviceArray, put
from toolee_robot.render.mesh import FloatArray, Mesh
from toolee_robot.render.rays.tracer import Found, in_camera

_BATCH = 512
"""Packets that are filled and shot together; they stay in the processor's cache."""
# RTCRayHit16 and the like, in fields of one float a ray: origin 0-2, tnear 3, direction 4-6, time 7, tfar 8, mask 9,
# id, flags, Ng 12-14, u 15, v 16, primID 17, geomID 18, instID, instPrimID.
_RAY, _RAY_HIT = 12, 21
_ORIGIN, _DIRECTION, _REACH = slice(0, 3), slice(4, 7), slice(8, 9)
_TFAR, _MASK, _GEOMETRY = 8, 9, 18
_VALUES, _IDS = slice(12, 17), slice(17, 19)
_TRIANGLES, _INDEX, _VERTEX, _UINT3, _FLOAT3 = 0, 0, 1, 0x5003, 0x9003
_NATIVE = {16: 34, 8: 33}
"""Packet width -> RTC_DEVICE_PROPERTY_NATIVE_RAY*_SUPPORTED."""


class _Arguments(ctypes.Structure):
    """RTCIntersectArguments, and RTCOccludedArguments, which is the same."""

    _fields_ = (
        ("flags", ctypes.c_uint),
        ("features", ctypes.c_uint),
        ("context", ctypes.c_void_p),
        ("filter", ctypes.c_void_p),
        ("function", ctypes.c_void_p),
        ("width", ctypes.c_float),
    )


_COHERENT = _Arguments(flags=1 << 16, features=0xFFFFFFFF)


class _Library:
    """Embree's functions and one device. width: rays in a packet, the widest that this processor has."""

    def __init__(self) -> None:
        # The package's own module leads to the library that it is linked to, wherever the package is installed. The
        # interpreter's lock is kept for packets, which take about a microsecond, and released while a tree is built:
        # an emulated camera shares its process with drivers that must not wait.
        c, unlocked = ctypes.PyDLL(rtcore_scene.__file__), ctypes.CDLL(rtcore_scene.__file__)
        pointer, uint, size = ctypes.c_void_p, ctypes.c_uint, ctypes.c_size_t
        self.new_scene = _function(c.rtcNewScene, pointer, pointer)
        self.commit_scene = _function(unlocked.rtcCommitScene, None, pointer)
        self.release_scene = _function(c.rtcReleaseScene, None, pointer)
        self.new_geometry = _function(c.rtcNewGeometry, pointer, pointer, ctypes.c_int)
        self.new_buffer = _function(
            c.rtcSetNewGeometryBuffer, pointer, pointer, ctypes.c_int, uint, ctypes.c_int, size, size
        )
        self.commit_geometry = _function(c.rtcCommitGeometry, None, pointer)
        self.release_geometry = _function(c.rtcReleaseGeometry, None, pointer)
        self.attach_geometry = _function(c.rtcAttachGeometry, uint, pointer, pointer)
        has = _function(c.rtcGetDeviceProperty, ctypes.c_ssize_t, pointer, ctypes.c_int)
        # One thread: processes share the cores among them, and a scene is built in milliseconds.
        self.device = _function(c.rtcNewDevice, pointer, ctypes.c_char_p)(b"threads=1")
        if not self.device:
            raise RuntimeError("embree cannot start on this processor")
        self.width = next((width for width, name in _NATIVE.items() if has(self.device, name)), 4)
        shoot = (pointer,) * 4
        self.intersect = _function(getattr(c, f"rtcIntersect{self.width}"), None, *shoot)
        self.occluded = _function(getattr(c, f"rtcOccluded{self.width}"), None, *shoot)
        self.valid = _aligned((self.width,))
        self.valid.view(np.int32)[:] = -1

    def packets(self, rays: int, fields: int) -> FloatArray:
        """(packets, fields, width) for so many rays, or for a batch of them; whatever is not written later is set."""
        packets = _aligned((min(_BATCH, -(-rays // self.width)), fields, self.width))
        packets.view(np.uint32)[:, _MASK] = 0xFFFFFFFF
        return packets


def _function(function: Any, result: Any, *arguments: Any) -> Any:
    function.restype, function.argtypes = result, arguments
    return function


def _aligned(shape: tuple[int, ...]) -> FloatArray:
    """Zeros at an address that embree's packets may have."""
    count = 4 * int(np.prod(shape))
    memory = np.zeros(count + 64, np.uint8)
    start = -memory.ctypes.data % 64
    return memory[start : start + count].view(np.float32).reshape(shape)


@lru_cache(maxsize=1)
def _library() -> _Library:
    return _Library()


class EmbreeTracer:
    """`tracing.Tracer` on the processor."""

    def __init__(self, meshes: Sequence[tuple[Mesh, Array]]) -> None:
        """meshes: each with its X_camera_body (4x4)."""
        self._library = e = _library()
        self._scene = e.new_scene(e.device)
        for mesh, X_camera_body in meshes:
            geometry = e.new_geometry(e.device, _TRIANGLES)
            for what, kind, rows in ((_VERTEX, _FLOAT3, in_camera(mesh, X_camera_body)), (_INDEX, _UINT3, mesh.faces)):
                data = np.ascontiguousarray(rows, np.float32 if what == _VERTEX else np.int32)
                ctypes.memmove(e.new_buffer(geometry, what, 0, kind, 12, len(data)), data.ctypes.data, data.nbytes)
            e.commit_geometry(geometry)
            e.attach_geometry(self._scene, geometry)
            e.release_geometry(geometry)
        e.commit_scene(self._scene)

    def __del__(self) -> None:
        self._library.release_scene(self._scene)

    def closest(self, rays: DeviceArray) -> Found:
        """See `Tracer`."""
        e, directions = self._library, rays.numpy()
        n = directions.shape[1]
        packets, batch = e.packets(n, _RAY_HIT), _BATCH * e.width
        values, ids = np.empty((6, n), np.float32), np.empty((2, n), np.int32)
        for start in range(0, n, batch):
            place = slice(start, min(start + batch, n))
            part = _whole_packets(directions[:, place], e.width)
            count = part.shape[1] // e.width
            packets[:count, _DIRECTION] = part.reshape(3, count, e.width).transpose(1, 0, 2)
            packets[:count, _TFAR] = np.inf
            packets.view(np.uint32)[:count, _GEOMETRY] = 0xFFFFFFFF
            self._shoot(e.intersect, packets[:count])
            found = packets[:count].transpose(1, 0, 2).reshape(_RAY_HIT, -1)[:, : place.stop - start]
            values[0, place], values[1:, place] = found[_TFAR], found[_VALUES]
            ids[:, place] = found.view(np.int32)[_IDS]
        values[0, ids[1] < 0] = 0.0
        return Found(put(values, wp.float32, "cpu"), put(ids, wp.int32, "cpu"))

    def blocked(self, origins: DeviceArray, directions: DeviceArray, reach: DeviceArray) -> DeviceArray:
        """See `Tracer`."""
        e, n = self._library, reach.shape[0]
        rows = ((_ORIGIN, origins.numpy()), (_DIRECTION, directions.numpy()), (_REACH, reach.numpy()[None]))
        packets, batch = e.packets(n, _RAY), _BATCH * e.width
        met = np.empty(-(-n // e.width) * e.width, np.uint8)
        for start in range(0, n, batch):
            place = slice(start, start + batch)
            for field, values in rows:
                part = _whole_packets(values[:, place], e.width)
                count = part.shape[1] // e.width
                packets[:count, field] = part.reshape(-1, count, e.width).transpose(1, 0, 2)
            asked = np.flatnonzero((packets[:count, _TFAR] > 0).any(axis=1))
            self._shoot(e.occluded, packets, asked)
            met[place].reshape(count, e.width)[:] = packets[:count, _TFAR] < 0
        return put(met[:n], wp.uint8, "cpu")

    def _shoot(self, function: Any, packets: FloatArray, which: NDArray[np.signedinteger] | None = None) -> None:
        first, step = packets.ctypes.data, packets.strides[0]
        every = range(first, first + len(packets) * step, step)
        addresses = every if which is None else [every[k] for k in which.tolist()]
        valid, arguments = self._library.valid.ctypes.data, ctypes.addressof(_COHERENT)
        deque(map(function, repeat(valid), repeat(self._scene), addresses, repeat(arguments)), maxlen=0)


def _whole_packets(rows: FloatArray, width: int) -> FloatArray:
    """Rows (K, N) with the last ray repeated until the packet is full."""
    missing = -rows.shape[1] % width
    return rows if missing == 0 else np.concatenate([rows, np.repeat(rows[:, -1:], missing, axis=1)], axis=1)

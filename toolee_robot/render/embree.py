"""Rays against triangles, sixteen at a time: embree's packets, called through its C interface.

The package `embreex` brings the library, but its own calls shoot one ray at a time: neighbouring pixels' rays go the
same way through the tree, and in packets they take a third to a quarter of the time.
"""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from itertools import repeat
from typing import Any

import numpy as np
from embreex import rtcore_scene
from numpy.typing import NDArray

from toolee_robot.render.mesh import FloatArray

_BATCH = 512
"""Packets that are filled and shot together; they stay in the processor's cache."""
# RTCRayHit16 and the like, in fields of one float a ray: origin 0-2, tnear 3, direction 4-6, time 7, tfar 8, mask 9,
# id, flags, Ng 12-14, u 15, v 16, primID 17, geomID 18, instID, instPrimID.
_RAY, _RAY_HIT = 12, 21
_ORIGIN, _DIRECTION, _REACH, _HIT = slice(0, 3), slice(4, 7), slice(8, 9), slice(12, 19)
_TFAR, _MASK, _GEOMETRY = 8, 9, 18
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
        # The package's own module leads to the library that it is linked to, wherever the wheel has put it. The
        # interpreter's lock is kept: a packet takes about a microsecond.
        c = ctypes.PyDLL(rtcore_scene.__file__)
        pointer, uint, size = ctypes.c_void_p, ctypes.c_uint, ctypes.c_size_t
        self.new_scene = _function(c.rtcNewScene, pointer, pointer)
        self.commit_scene = _function(c.rtcCommitScene, None, pointer)
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


@dataclass(frozen=True, eq=False)
class Closest:
    """What rays (N,) hit first. mesh (N,) int32: index of the mesh, -1 for none; the rest is undefined there. face (N,)
    int32; distance (N,) in lengths of the ray's direction; u, v (N,): barycentric, of the face's second and third
    corner; normals (3, N): geometric, of any length, on either side."""

    mesh: NDArray[np.int32]
    face: NDArray[np.int32]
    distance: FloatArray
    u: FloatArray
    v: FloatArray
    normals: FloatArray

    def followed_by(self, other: Closest) -> Closest:
        """What these rays hit, and then what other rays at the same meshes hit."""
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))
        return Closest(*(np.concatenate(pair, axis=-1) for pair in pairs))


class Tracer:
    """Meshes that rays are shot at."""

    def __init__(self, meshes: Sequence[tuple[FloatArray, NDArray[np.int32]]]) -> None:
        """meshes: vertices (V, 3) and faces (F, 3)."""
        self._library = e = _library()
        self._scene = e.new_scene(e.device)
        for vertices, faces in meshes:
            geometry = e.new_geometry(e.device, _TRIANGLES)
            for what, kind, rows in ((_VERTEX, _FLOAT3, vertices), (_INDEX, _UINT3, faces)):
                data = np.ascontiguousarray(rows, np.float32 if what == _VERTEX else np.int32)
                ctypes.memmove(e.new_buffer(geometry, what, 0, kind, 12, len(data)), data.ctypes.data, data.nbytes)
            e.commit_geometry(geometry)
            e.attach_geometry(self._scene, geometry)
            e.release_geometry(geometry)
        e.commit_scene(self._scene)

    def __del__(self) -> None:
        self._library.release_scene(self._scene)

    def closest(self, directions: FloatArray) -> Closest:
        """What rays from the origin hit; directions (3, N), of any length."""
        e, n = self._library, directions.shape[1]
        packets, batch = e.packets(n, _RAY_HIT), _BATCH * e.width
        found = np.empty((8, -(-n // e.width) * e.width), np.float32)
        for start in range(0, n, batch):
            part = _whole_packets(directions[:, start : start + batch], e.width)
            count = part.shape[1] // e.width
            packets[:count, _DIRECTION] = part.reshape(3, count, e.width).transpose(1, 0, 2)
            packets[:count, _TFAR] = np.inf
            packets.view(np.uint32)[:count, _GEOMETRY] = 0xFFFFFFFF
            self._shoot(e.intersect, packets[:count])
            out = found[:, start : start + part.shape[1]].reshape(8, count, e.width)
            out[0], out[1:] = packets[:count, _TFAR], packets[:count, _HIT].transpose(1, 0, 2)
        ids = found.view(np.int32)[:, :n]
        found = found[:, :n]
        return Closest(ids[7], ids[6], found[0], found[4], found[5], found[1:4])

    def blocked(self, origins: FloatArray, directions: FloatArray, reach: FloatArray) -> NDArray[np.bool_]:
        """(N,) whether anything is met between origins (3, N) and origins + reach (N,) * directions (3, N)."""
        e, n = self._library, len(reach)
        packets, batch = e.packets(n, _RAY), _BATCH * e.width
        found = np.empty(-(-n // e.width) * e.width, np.bool_)
        for start in range(0, n, batch):
            place = slice(start, start + batch)
            for field, rows in ((_ORIGIN, origins), (_DIRECTION, directions), (_REACH, reach[None])):
                part = _whole_packets(rows[:, place], e.width)
                count = part.shape[1] // e.width
                packets[:count, field] = part.reshape(-1, count, e.width).transpose(1, 0, 2)
            self._shoot(e.occluded, packets[:count])
            found[place].reshape(count, e.width)[:] = packets[:count, _TFAR] < 0
        return found[:n]

    def _shoot(self, function: Any, packets: FloatArray) -> None:
        first, step = packets.ctypes.data, packets.strides[0]
        addresses = range(first, first + len(packets) * step, step)
        valid, arguments = self._library.valid.ctypes.data, ctypes.addressof(_COHERENT)
        deque(map(function, repeat(valid), repeat(self._scene), addresses, repeat(arguments)), maxlen=0)


def _whole_packets(rows: FloatArray, width: int) -> FloatArray:
    """Rows (K, N) with the last ray repeated until the packet is full."""
    missing = -rows.shape[1] % width
    return rows if missing == 0 else np.concatenate([rows, np.repeat(rows[:, -1:], missing, axis=1)], axis=1)

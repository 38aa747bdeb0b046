"""The ray tracers: Embree on the CPU, Warp's trees on a GPU.

Embree's packets of sixteen rays are called through its C interface. The package `embreex` brings the library, but its
own calls shoot one ray at a time. Neighbouring pixels' rays go the same way through the tree: packets take a third to a
quarter of the time. On the CPU Embree takes an eighth of the time of Warp's trees.

A tree of Warp's that finds hits quickly takes milliseconds to build, so lasting meshes keep theirs, each in its body's
frame; the others of a scene, mostly boxes, have one together.
"""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import repeat
from typing import Any, Protocol
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp
from embreex import rtcore_scene
from numpy.typing import NDArray

from toolee_robot.frames import Array
from toolee_robot.render.device import DeviceArray, empty, launch, put, rows_of
from toolee_robot.render.kernels import bvh as kernels
from toolee_robot.render.mesh import FloatArray, IntArray, Mesh


@dataclass(frozen=True, eq=False)
class Found:
    """The first hits of N rays.

    Attributes:
        values: (6, N) float32: distance in lengths of the ray's direction, 0 where nothing is hit; the geometric
            normal, of any length, on either side; barycentric coordinates u, v of the face's second and third corner.
        ids: (2, N) int32: index of the face in its mesh, and of the mesh; -1 where nothing is hit, and the other rows
            are undefined there.
    """

    values: DeviceArray
    ids: DeviceArray


class Tracer(Protocol):
    """Meshes on a device that rays are cast at; camera frame."""

    def closest(self, rays: DeviceArray) -> Found:
        """Find the first hits of rays from the origin.

        Args:
            rays: Directions, (3, N).

        Returns:
            The hits.
        """

    def blocked(self, origins: DeviceArray, directions: DeviceArray, reach: DeviceArray) -> DeviceArray:
        """Check whether anything lies between points and other points, origins + reach * directions.

        Args:
            origins: Origins of the rays, (3, N) [m].
            directions: Directions of the rays, (3, N).
            reach: Lengths of the rays in lengths of their directions, (N,).

        Returns:
            1 where something is hit, else 0, (N,) uint8; undefined where the reach is negative.
        """


def in_camera(mesh: Mesh, X_camera_body: Array) -> FloatArray:
    """Vertices of a mesh in the camera frame.

    They are computed in float64 and rounded once, so that depth stays exact to a millimetre for far-away world origins.

    Args:
        mesh: The mesh.
        X_camera_body: Its pose, (4, 4).

    Returns:
        The vertices, (V, 3) [m].
    """
    vertices = mesh.vertices.astype(np.float64) @ X_camera_body[:3, :3].T + X_camera_body[:3, 3]
    return np.asarray(vertices, np.float32)


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


_KIND = "sah"
"""Built on the processor: a whole scene took 5 ms where a GPU took 0.8, but its rays then a third of the time."""


@dataclass(frozen=True, eq=False)
class _Kept:
    """The tree of a lasting mesh and a sphere around it, body frame.

    Attributes:
        tree: The `wp.Mesh`.
        centre: Centre of the sphere, (3,) [m].
        radius: Radius of the sphere [m].
    """

    tree: Any
    centre: Array
    radius: float


_kept: dict[str, WeakKeyDictionary[Mesh, _Kept]] = {}


class BvhTracer:
    """Ray tracer on Warp's bounding volume hierarchies, see `Tracer`.

    Args:
        meshes: The meshes, each with its X_camera_body, (4, 4).
        device: Warp device.
    """

    def __init__(self, meshes: Sequence[tuple[Mesh, Array]], device: str) -> None:
        self._device = device
        kept = _kept.setdefault(device, WeakKeyDictionary())
        rows, loose, bodies = [], [], []
        for body, (mesh, X) in enumerate(meshes):
            if not mesh.lasting:
                loose.append((in_camera(mesh, X), mesh.faces))
                bodies.append(body)
            elif len(mesh.faces):
                if mesh not in kept:
                    kept[mesh] = _keep(mesh, device)
                ball = kept[mesh]
                centre = X[:3, :3] @ ball.centre + X[:3, 3]
                rows.append((ball.tree.id, X[:3, :3], X[:3, 3], centre, ball.radius, body))
        self._trees = [kept[mesh].tree for mesh, _ in meshes if mesh in kept]  # as long as their ids are in use
        self._instances = put(rows_of(kernels.Instance, rows), kernels.Instance, device)
        first = np.cumsum([0, *(len(faces) for _, faces in loose)]).astype(np.int32)
        self._first_face = put(first, wp.int32, device)
        self._bodies = put(np.array(bodies, np.int32), wp.int32, device)
        self._loose = None
        if first[-1]:
            starts = np.cumsum([0, *(len(vertices) for vertices, _ in loose)])
            joined = [faces + start for (_, faces), start in zip(loose, starts, strict=False)]
            self._loose = _tree(np.concatenate([vertices for vertices, _ in loose]), np.concatenate(joined), device)

    @property
    def _loose_id(self) -> Any:
        return wp.uint64(0) if self._loose is None else self._loose.id

    def closest(self, rays: DeviceArray) -> Found:
        """See `Tracer`."""
        n = rays.shape[1]
        found = Found(empty((6, n), wp.float32, self._device), empty((2, n), wp.int32, self._device))
        scene = (self._loose_id, self._first_face, self._bodies, self._instances)
        launch(kernels.closest, n, *scene, rays, found.values, found.ids, device=self._device)
        return found

    def blocked(self, origins: DeviceArray, directions: DeviceArray, reach: DeviceArray) -> DeviceArray:
        """See `Tracer`."""
        out = empty(reach.shape[0], wp.uint8, self._device)
        arguments = (self._loose_id, self._instances, origins, directions, reach, out)
        launch(kernels.blocked, reach.shape[0], *arguments, device=self._device)
        return out


def _keep(mesh: Mesh, device: str) -> _Kept:
    low, high = mesh.vertices.min(axis=0).astype(np.float64), mesh.vertices.max(axis=0).astype(np.float64)
    centre = (low + high) / 2
    # A little more, for rays are rounded otherwise than the tree's.
    radius = 1.001 * float(np.linalg.norm(mesh.vertices - centre, axis=1).max()) + 1e-5
    return _Kept(_tree(mesh.vertices, mesh.faces, device), centre, radius)


def _tree(vertices: FloatArray, faces: IntArray, device: str) -> Any:
    indices = put(faces.astype(np.int32).reshape(-1), wp.int32, device)
    return wp.Mesh(put(vertices, wp.vec3, device), indices, bvh_constructor=_KIND)

"""Reading of custom tools: one folder each with `tool.yaml` and a mesh; `docs/dataset.md` has an example."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydantic import AfterValidator, ConfigDict, Field

from toolee_robot.end_effectors import Category
from toolee_robot.errors import ConfigError, words_of
from toolee_robot.frames import Array, angle_between, frame_from_axes, inverse, transform_points
from toolee_robot.perception.offline.dataset.catalogue import MATERIALS, CustomMesh, CustomToolRecord, cut_at_parts
from toolee_robot.perception.offline.dataset.instances import ply_bytes
from toolee_robot.runtime.yaml_files import read_record
from toolee_robot.symmetry import SymmetryKind

DESCRIPTION = "tool.yaml"
_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
_Vector = tuple[float, float, float]
_Row = tuple[float, ...]
_SMALLEST, _LARGEST = 0.05, 1.0
"""Length [m] of a hand tool."""
_SCALES = (0.001, 0.01, 0.0254, 1.0)
_GRIP = 0.08
"""A hand nominally holds a handle so far [m] from the butt, or in the middle of a shorter one."""
_MAX_THICKNESS = 0.035
"""Half-width [m] of a handle that a hand can hold, and a little."""
_OFF_SURFACE = 0.04
_SAMPLES = 30_000


def _known(material: str) -> str:
    if material not in MATERIALS:
        raise ValueError(f"choose one of {', '.join(MATERIALS)}")
    return material


_Material = Annotated[str, AfterValidator(_known)]


MOST_FACES = 250_000
"""Of a tool's mesh: more take seconds in every check, and show nothing more to the camera."""


@dataclass(frozen=True)
class EeConfig:
    """An end effector; its frame is that of the category (`EndEffectorSpec.frame`).

    Attributes:
        category: Category of the EE.
        position: Origin (3,), frame and unit of the mesh.
        z: Direction of the z axis (3,), frame of the mesh.
        x: Direction of the x axis (3,), frame of the mesh; None where the symmetry of the category leaves it free.
    """

    __pydantic_config__ = _STRICT
    category: Category
    position: _Vector
    z: _Vector
    x: _Vector | None = None


@dataclass(frozen=True)
class HandleConfig:
    """The axis of the handle, in the frame and unit of the mesh.

    Attributes:
        butt: Centre of the free end (3,).
        end: Centre of the end towards the working end (3,).
    """

    __pydantic_config__ = _STRICT
    butt: _Vector
    end: _Vector


@dataclass(frozen=True)
class MaterialsConfig:
    """Materials of a tool; half of the images replace their colours.

    Attributes:
        handle: Material of the handle.
        head: Material of the head.
    """

    __pydantic_config__ = _STRICT
    handle: _Material = "plastic"
    head: _Material = "steel_bright"


@dataclass(frozen=True)
class ToolConfig:
    """Content of `tool.yaml`.

    Attributes:
        mesh: Mesh file in the same folder, in a format that trimesh reads.
        scale: Metres per unit of the mesh.
        handle: Axis of the handle.
        ees: One or two end effectors, the working end first.
        materials: Materials of handle and head.
    """

    __pydantic_config__ = _STRICT
    mesh: str
    scale: Annotated[float, Field(gt=0)]
    handle: HandleConfig
    ees: Annotated[tuple[EeConfig, ...], Field(min_length=1, max_length=2)]
    materials: MaterialsConfig = field(default_factory=MaterialsConfig)


def read_custom_tools(folder: Path) -> tuple[CustomMesh, ...]:
    """Read custom tools, sorted by name.

    Args:
        folder: Folder with one folder per tool.

    Raises:
        ConfigError: A tool is invalid; the message names the file and what to change.
    """
    if not folder.is_dir():
        raise ConfigError(f"--tools {folder}: there is no such folder")
    folders = sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
    if not folders:
        raise ConfigError(f"--tools {folder} holds no folders: give each tool one, with {DESCRIPTION} and a mesh in it")
    return tuple(_read_tool(path) for path in folders)


def _read_tool(folder: Path) -> CustomMesh:
    path = folder / DESCRIPTION
    if not re.fullmatch(r"[\w.-]{1,64}", folder.name, re.ASCII):
        raise ConfigError(f"{folder}: the folder is the tool's name; use letters, digits, dots, - and _ only")
    config = read_record(path, ToolConfig, "tool (see docs/dataset.md)")
    try:
        return _resolved(folder.name, config, *_read_mesh(folder / config.mesh))
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error


def _read_mesh(path: Path) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) in the mesh's frame and unit, faces (F, 3) turned outwards."""
    try:
        mesh = trimesh.load(path, force="mesh")
    except Exception as error:  # each format's reader has its own
        raise ConfigError(f"cannot read the mesh {path}: {words_of(error)}") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0 or not np.all(np.isfinite(mesh.vertices)):
        raise ConfigError(f"{path} holds no triangles: give a surface, not a cloud of points")
    if not 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices):
        raise ConfigError(f"{path} is damaged: a triangle has a vertex that is not there")
    if len(mesh.faces) > MOST_FACES:
        raise ConfigError(f"{path} has {len(mesh.faces):,} triangles: simplify it to {MOST_FACES:,} or fewer")
    if mesh.volume < 0:
        mesh.invert()
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)


def _resolved(name: str, config: ToolConfig, vertices: Array, faces: NDArray[np.int64]) -> CustomMesh:
    """Everything in metres in the tool's frame. Raises ValueError with what to change."""
    length = _length(vertices) * config.scale
    if not _SMALLEST <= length <= _LARGEST:
        fits = [s for s in _SCALES if 2 * _SMALLEST <= length / config.scale * s <= 0.8 * _LARGEST]
        hint = f"; scale: {fits[0]:g} would make it {length / config.scale * fits[0]:.2f} m" if fits else ""
        raise ValueError(f"with scale {config.scale:g} the tool is {length:.3g} m long{hint}")
    vertices = config.scale * vertices
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    surface = np.asarray(trimesh.sample.sample_surface(mesh, _SAMPLES, seed=0)[0])
    butt, end = (config.scale * np.asarray(p) for p in (config.handle.butt, config.handle.end))
    Xs_mesh_ee = [_ee_frame(k, ee, config.scale, butt, surface) for k, ee in enumerate(config.ees)]
    if not 0.03 <= np.linalg.norm(end - butt) <= length:
        raise ValueError(
            f"handle: butt and end are {np.linalg.norm(end - butt):.3g} m apart, the tool is {length:.3g} m long; give "
            "both in the mesh's unit"
        )
    X_tool_mesh = inverse(_tool_frame(config.ees[0].category, Xs_mesh_ee[0], butt, end))
    z_butt, z_end = (float(transform_points(X_tool_mesh, p[None])[0, 2]) for p in (butt, end))
    record = CustomToolRecord(
        name,
        "",
        tuple(ee.category for ee in config.ees),
        tuple(tuple(round(float(v), 9) for v in (X_tool_mesh @ X).reshape(-1)) for X in Xs_mesh_ee),
        _handle(transform_points(X_tool_mesh, surface), z_butt, z_end),
        config.materials.handle,
        config.materials.head,
    )
    vertices, faces = cut_at_parts(record, transform_points(X_tool_mesh, vertices), faces)
    ply = ply_bytes(1e3 * vertices, faces)
    return CustomMesh(replace(record, mesh_sha256=hashlib.sha256(ply).hexdigest()), ply)


def _length(vertices: Array) -> float:
    """Along the longest of the principal axes, so that it does not depend on the mesh's frame."""
    centred = vertices - vertices.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    return float(np.ptp(centred @ axes.T, axis=0).max())


def _ee_frame(k: int, ee: EeConfig, scale: float, butt: Array, surface: Array) -> Array:
    """X_mesh_ee [m]. surface (N, 3): samples [m]."""
    p, z = scale * np.asarray(ee.position), np.asarray(ee.z)
    where = f"ees.{k} ({ee.category})"
    free = ee.category.symmetry.kind is SymmetryKind.CINF
    if ee.x is None and not free:
        raise ValueError(f"{where}: needs x, for its turn about z is not free. Its frame: {ee.category.spec.frame}")
    if not np.any(z) or (ee.x is not None and not np.any(ee.x)):
        raise ValueError(f"{where}: an axis is zero")
    x = butt - p if ee.x is None else np.asarray(ee.x)
    if ee.x is not None and abs(angle_between(x, z) - np.pi / 2) > np.deg2rad(10.0):
        raise ValueError(f"{where}: x and z are {np.rad2deg(angle_between(x, z)):.0f} deg apart, they must be square")
    if np.linalg.norm(np.cross(x, z)) < 1e-3 * np.linalg.norm(x) * np.linalg.norm(z):
        x = np.eye(3)[int(np.argmin(np.abs(z)))]  # any: the handle lies along z
    X = frame_from_axes(z=z, x=x, p=p)
    off = float(np.linalg.norm(surface - p, axis=1).min())
    if off > _OFF_SURFACE:
        raise ValueError(f"{where}: position is {off:.3g} m off the surface; give it in the mesh's frame and unit")
    local = transform_points(inverse(X), surface)
    beyond = local[np.linalg.norm(local[:, :2], axis=1) < 0.005, 2].max(initial=0.0)
    if free and beyond > 0.004:
        raise ValueError(f"{where}: the tool reaches {1e3 * beyond:.0f} mm beyond position along z; z points out of it")
    return X


def _tool_frame(category: Category, X_mesh_ee: Array, butt: Array, end: Array) -> Array:
    """X_mesh_tool: the grip's centre, z from butt to end, x to the working side (a wrench's y: the nut's axis)."""
    z = (end - butt) / np.linalg.norm(end - butt)
    side = X_mesh_ee[:3, 2]
    x = np.cross(side, z) if category.spec.R_tool_ee[1, 2] else side
    if np.linalg.norm(np.cross(x, z)) < 0.1:
        x = X_mesh_ee[:3, 0]
    return frame_from_axes(z=z, x=x, p=butt + z * min(_GRIP, 0.5 * float(np.linalg.norm(end - butt))))


def _handle(surface: Array, z_butt: float, z_end: float) -> tuple[_Row, _Row, _Row]:
    """z, half-widths along x and y [m] of the surface (N, 3), `tool` frame, around the line from butt to end."""
    near = surface[np.linalg.norm(surface[:, :2], axis=1) < _MAX_THICKNESS]
    edges = np.linspace(z_butt, z_end, 25)
    which = np.digitize(near[:, 2], edges) - 1
    slabs = [np.abs(near[which == k, :2]) for k in range(len(edges) - 1)]
    there = np.array([len(slab) >= 3 for slab in slabs])
    if there.mean() < 0.75:
        raise ValueError(
            f"handle: along {1 - there.mean():.0%} of the line from butt to end no surface is within "
            f"{1e3 * _MAX_THICKNESS:.0f} mm; give both points on the handle's axis, in the mesh's frame and unit"
        )
    middles = 0.5 * (edges[1:] + edges[:-1])
    widths = np.array([slab.max(axis=0) for slab, ok in zip(slabs, there, strict=True) if ok])
    radii_x, radii_y = (_row(np.interp(edges, middles[there], widths[:, axis])) for axis in (0, 1))
    return _row(edges), radii_x, radii_y


def _row(values: Array) -> _Row:
    return tuple(round(float(v), 6) for v in values)

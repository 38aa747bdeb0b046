"""The records of a tool: parts, end effectors, handle; of a generated one also its mass properties.

`tool` frame: origin at the grip centre of the handle (where a hand nominally holds it), z along the handle from the
butt to the working end, x to the working side (a hammer's: along the striking face's normal; a wrench's y is the
normal of its flat sides).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.tools.mass import mass_properties
from toolee_robot.tools.materials import Material
from toolee_robot.tools.solids import Convex, hull, signed_volume, to_trimesh, without


class Family(StrEnum):
    """Kinds of tools that one generator makes."""

    HAMMERS = "hammers"
    SCREWDRIVERS = "screwdrivers"
    WRENCHES = "wrenches"


class ToolKind(StrEnum):
    """What `make_tool` can make: a record each in `catalog.TOOL_SPECS`."""

    CLAW_HAMMER = "claw_hammer"
    BALL_PEEN_HAMMER = "ball_peen_hammer"
    CROSS_PEEN_HAMMER = "cross_peen_hammer"
    CLUB_HAMMER = "club_hammer"
    MALLET = "mallet"
    SLOTTED_SCREWDRIVER = "slotted_screwdriver"
    PHILLIPS_SCREWDRIVER = "phillips_screwdriver"
    NUT_DRIVER = "nut_driver"
    OPEN_END_WRENCH = "open_end_wrench"
    COMBINATION_WRENCH = "combination_wrench"
    ADJUSTABLE_WRENCH = "adjustable_wrench"
    BOX_WRENCH = "box_wrench"
    SOCKET_WRENCH = "socket_wrench"


def tool_name(kind: ToolKind, seed: int) -> str:
    """The name of a generated tool."""
    return f"{kind}-{seed:04d}"


@dataclass(frozen=True, eq=False)
class Part:
    """One labelled piece of one material."""

    label: str
    material: Material


@dataclass(frozen=True, eq=False)
class SolidPart(Part):
    """A part as a body. Parts do not overlap: a handle's eye is a hole in the head."""

    _solid: Any
    _others: tuple[Any, ...]

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """Watertight, `tool` frame [m]. Cut out when first asked for: a picture of the tool does not need it, and it
        takes as long as the tool's surface."""
        return to_trimesh(without(self._solid, self._others))

    @property
    def density(self) -> float:
        """[kg/m^3]"""
        return self.material.density


@dataclass(frozen=True, eq=False)
class EndEffector:
    """X_tool_ee: 4x4, as the category defines the frame. A tool with two like ends has two of one category."""

    category: Category
    X_tool_ee: Array


@dataclass(frozen=True, eq=False)
class Handle:
    """What a hand can close around: from z_min (the butt) to z_max on the tool's z axis [m].

    z, radii_x, radii_y: (N,) half-widths [m] of the section along the handle, z increasing.
    """

    z: Array
    radii_x: Array
    radii_y: Array

    @property
    def z_min(self) -> float:
        return float(self.z[0])

    @property
    def z_max(self) -> float:
        return float(self.z[-1])

    @property
    def grip_radius(self) -> float:
        """Mean half-width at the grip centre [m]: the radius that a hand closes around."""
        return float(np.mean(self.radii_at(0.0)))

    def radii_at(self, z: float = 0.0) -> tuple[float, float]:
        """Half-widths [m] along tool x and y at height z; the grip centre is z = 0."""
        return float(np.interp(z, self.z, self.radii_x)), float(np.interp(z, self.z, self.radii_y))


@dataclass(frozen=True, eq=False, repr=False)
class ToolShape:
    """What is seen and held of a rigid tool, all in the `tool` frame, SI units.

    name: of the instance. mesh: the outer surface of all parts. face_parts: (F,) index into `parts` of each of the
    mesh's faces. ees[0] is the working end.
    """

    name: str
    parts: tuple[Part, ...]
    mesh: trimesh.Trimesh
    face_parts: NDArray[np.int64]
    ees: tuple[EndEffector, ...]
    handle: Handle

    @property
    def categories(self) -> tuple[Category, ...]:
        return tuple(dict.fromkeys(ee.category for ee in self.ees))

    def ee(self, category: Category) -> EndEffector:
        """The first (working) EE of that category. Raises UserError if the tool has none."""
        for ee in self.ees:
            if ee.category == category:
                return ee
        raise UserError(f"{self.name} has no {category}; it has {', '.join(self.categories)}")

    def sample_surface(self, n: int, rng: np.random.Generator) -> tuple[Array, Array, NDArray[np.int64]]:
        """n points uniform on the outer surface: points (n, 3), outward unit normals (n, 3), part indices (n,)."""
        cumulative = self._cumulative_area
        faces = np.searchsorted(cumulative, rng.uniform(0.0, cumulative[-1], n), side="right")
        faces = np.minimum(faces, len(cumulative) - 1)
        triangles = self.mesh.vertices.view(np.ndarray)[self.mesh.faces.view(np.ndarray)[faces]]
        r = np.sqrt(rng.uniform(size=(n, 1)))
        s = rng.uniform(size=(n, 1))
        points = (1 - r) * triangles[:, 0] + r * (1 - s) * triangles[:, 1] + r * s * triangles[:, 2]
        return points, self._face_normals[faces], self.face_parts[faces]

    @cached_property
    def _cross_products(self) -> Array:
        a, b, c = np.moveaxis(self.mesh.vertices.view(np.ndarray)[self.mesh.faces.view(np.ndarray)], 1, 0)
        return np.cross(b - a, c - a)

    @cached_property
    def _cumulative_area(self) -> Array:
        return np.cumsum(np.linalg.norm(self._cross_products, axis=1))

    @cached_property
    def _face_normals(self) -> Array:
        norms = np.linalg.norm(self._cross_products, axis=1, keepdims=True)
        return self._cross_products / np.maximum(norms, 1e-300)


@dataclass(frozen=True, eq=False, repr=False)
class Tool(ToolShape):
    """A generated tool. mesh: the union of all parts, watertight, without inner surfaces."""

    kind: ToolKind
    seed: int
    parts: tuple[SolidPart, ...]
    _convex: tuple[tuple[str, Convex], ...]

    def __repr__(self) -> str:
        return f"<Tool {self.name}: {self.mass:.3f} kg, {', '.join(part.label for part in self.parts)}>"

    @property
    def mass(self) -> float:
        """[kg]"""
        return self._mass_properties[0]

    def mass_within(self, low: float, high: float) -> bool:
        """Whether the mass [kg] is; told without cutting the parts apart where that is clear.

        Each point where parts overlap is counted too often, by densities between the least and the greatest.
        """
        densities = [part.density for part in self.parts]
        volumes = [float(part._solid.volume()) for part in self.parts]
        counted = float(np.dot(densities, volumes))
        overlap = sum(volumes) - signed_volume(self.mesh.vertices.view(np.ndarray), self.mesh.faces.view(np.ndarray))
        slack = 1e-3 * counted  # the surface is in single precision
        least, greatest = counted - max(densities) * overlap - slack, counted - min(densities) * overlap + slack
        if low <= least and greatest <= high:
            return True
        return greatest >= low and least <= high and low <= self.mass <= high

    @property
    def center_of_mass(self) -> Array:
        """(3,) [m], `tool` frame."""
        return self._mass_properties[1]

    @property
    def inertia(self) -> Array:
        """3x3 [kg m^2] about the centre of mass, tool axes."""
        return self._mass_properties[2]

    @cached_property
    def _mass_properties(self) -> tuple[float, Array, Array]:
        return mass_properties((part.mesh, part.density) for part in self.parts)

    def collision_parts(self) -> list[trimesh.Trimesh]:
        """Convex meshes whose union covers the tool, `tool` frame; `metadata["label"]` names each one's part.

        A hammer's striking face is exactly flat in them; holes are filled, slots and jaws are not.
        """
        return list(self._collision_parts)

    @cached_property
    def _collision_parts(self) -> tuple[trimesh.Trimesh, ...]:
        pieces = []
        for label, convex in self._convex:
            for points in convex.hulls():
                piece = hull(points)
                piece.metadata["label"] = label
                pieces.append(piece)
        return tuple(pieces)

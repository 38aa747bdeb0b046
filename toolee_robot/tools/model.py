"""Records of a tool: parts, end effectors, handle and, for a generated tool, mass properties.

`tool` frame: origin at the grip centre of the handle (the nominal position of the hand), z along the handle from the
butt to the working end, x to the working side (hammers: the normal of the striking face). The y axis of a wrench is
the normal of its flat sides.
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
from toolee_robot.tools.materials import Material
from toolee_robot.tools.solids import Convex, Piece, hull, mass_properties, signed_volume, to_trimesh, unite, without


class Family(StrEnum):
    """Families of tools; each has one generator."""

    HAMMERS = "hammers"
    SCREWDRIVERS = "screwdrivers"
    WRENCHES = "wrenches"


class ToolKind(StrEnum):
    """Kinds of tools that `make_tool` generates; `catalog.TOOL_SPECS` holds a record for each."""

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
    HANGING_CLAW_HAMMER = "hanging_claw_hammer"
    WOODEN_MALLET = "wooden_mallet"
    MEAT_TENDERISER = "meat_tenderiser"
    SLEDGE_HAMMER = "sledge_hammer"
    LONG_SLOTTED_SCREWDRIVER = "long_slotted_screwdriver"
    LONG_PHILLIPS_SCREWDRIVER = "long_phillips_screwdriver"
    PIPE_WRENCH = "pipe_wrench"
    MONKEY_WRENCH = "monkey_wrench"
    EYE_ADJUSTABLE_WRENCH = "eye_adjustable_wrench"


def tool_name(kind: ToolKind, seed: int) -> str:
    """Name of a generated tool.

    Args:
        kind: The kind.
        seed: The seed.

    Returns:
        Kind and four-digit seed, such as "claw_hammer-0007".
    """
    return f"{kind}-{seed:04d}"


@dataclass(frozen=True, eq=False)
class Part:
    """A labelled part of one material.

    Attributes:
        label: Name of the part, such as "handle" or "face".
        material: Its material.
    """

    label: str
    material: Material


@dataclass(frozen=True, eq=False)
class SolidPart(Part):
    """A part with its volume. Parts of a tool do not overlap: the eye for the handle is a hole in the head.

    Attributes:
        _solid: manifold3d solid before the overlap is removed, `tool` frame [m].
        _others: Solids that take precedence where they overlap this one.
    """

    _solid: Any
    _others: tuple[Any, ...]

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """Watertight mesh, `tool` frame [m].

        Computed on first access: it takes as long as the outer surface, and rendering does not need it.
        """
        return to_trimesh(without(self._solid, self._others))

    @property
    def density(self) -> float:
        """Density [kg/m^3]."""
        return self.material.density


@dataclass(frozen=True, eq=False)
class EndEffector:
    """An end effector of a tool. A tool with two equal ends has two of the same category.

    Attributes:
        category: Category, which defines the frame.
        X_tool_ee: Pose of the EE frame in the `tool` frame, 4x4 [m].
    """

    category: Category
    X_tool_ee: Array


@dataclass(frozen=True, eq=False)
class Handle:
    """The grippable section of a tool, from z_min (the butt) to z_max along tool z.

    Attributes:
        z: Heights of N sections (N,) [m], `tool` frame, increasing.
        radii_x: Half-widths of the sections along tool x (N,) [m].
        radii_y: Half-widths of the sections along tool y (N,) [m].
    """

    z: Array
    radii_x: Array
    radii_y: Array

    @property
    def z_min(self) -> float:
        """Lower end, the butt [m]."""
        return float(self.z[0])

    @property
    def z_max(self) -> float:
        """Upper end [m]."""
        return float(self.z[-1])

    @property
    def grip_radius(self) -> float:
        """Mean half-width at the grip centre [m], used as the radius of the handle in grasp planning."""
        return float(np.mean(self.radii_at(0.0)))

    def radii_at(self, z: float = 0.0) -> tuple[float, float]:
        """Half-widths [m] along tool x and y at height z [m], interpolated linearly; the grip centre is z = 0."""
        return float(np.interp(z, self.z, self.radii_x)), float(np.interp(z, self.z, self.radii_y))


@dataclass(frozen=True, eq=False, repr=False)
class ToolShape:
    """Geometry of a rigid tool in the `tool` frame, SI units.

    Attributes:
        name: Name of the instance.
        parts: Labelled parts.
        mesh: Outer surface of all parts [m].
        face_parts: Index into `parts` of each face of the mesh (F,).
        ees: End effectors; ees[0] is the working end.
        handle: Grippable section.
    """

    name: str
    parts: tuple[Part, ...]
    mesh: trimesh.Trimesh
    face_parts: NDArray[np.int64]
    ees: tuple[EndEffector, ...]
    handle: Handle

    @property
    def categories(self) -> tuple[Category, ...]:
        """Distinct categories of the end effectors, the working end first."""
        return tuple(dict.fromkeys(ee.category for ee in self.ees))

    def ee(self, category: Category) -> EndEffector:
        """The first EE of a category.

        Raises:
            UserError: The tool has no EE of this category.
        """
        for ee in self.ees:
            if ee.category == category:
                return ee
        raise UserError(f"{self.name} has no {category.label}; it has {', '.join(c.label for c in self.categories)}")

    def sample_surface(self, n: int, rng: np.random.Generator) -> tuple[Array, Array, NDArray[np.int64]]:
        """Sample the outer surface uniformly.

        Args:
            n: Number of points.
            rng: Random generator.

        Returns:
            Points (n, 3) [m], outward unit normals (n, 3), both in the `tool` frame, and indices into `parts` (n,).
        """
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
    """A generated tool; its mesh is watertight and has no inner surfaces.

    Attributes:
        kind: Kind of the tool.
        seed: Seed of the instance, 0 or more.
        parts: Parts with volume and density.
        _convex: Label and collision shape of each convex piece, `tool` frame [m].
    """

    kind: ToolKind
    seed: int
    parts: tuple[SolidPart, ...]
    _convex: tuple[tuple[str, Convex], ...]

    def __repr__(self) -> str:
        return f"<Tool {self.name}: {self.mass:.3f} kg, {', '.join(part.label for part in self.parts)}>"

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return self._mass_properties[0]

    def mass_within(self, low: float, high: float) -> bool:
        """Whether low <= mass <= high [kg].

        Bounds decide first, because the exact mass needs the parts without their overlap: the sum over the
        overlapping solids exceeds the mass by the overlap volume times a density between the least and the greatest.

        Args:
            low: Lower bound [kg].
            high: Upper bound [kg].
        """
        densities = [part.density for part in self.parts]
        volumes = [float(part._solid.volume()) for part in self.parts]
        counted = float(np.dot(densities, volumes))
        overlap = sum(volumes) - signed_volume(self.mesh.vertices.view(np.ndarray), self.mesh.faces.view(np.ndarray))
        slack = 1e-3 * counted  # single precision of the surface
        least, greatest = counted - max(densities) * overlap - slack, counted - min(densities) * overlap + slack
        if low <= least and greatest <= high:
            return True
        return greatest >= low and least <= high and low <= self.mass <= high

    @property
    def center_of_mass(self) -> Array:
        """Centre of mass (3,) [m], `tool` frame."""
        return self._mass_properties[1]

    @property
    def inertia(self) -> Array:
        """Inertia about the centre of mass (3, 3) [kg m^2], tool axes."""
        return self._mass_properties[2]

    @cached_property
    def _mass_properties(self) -> tuple[float, Array, Array]:
        return mass_properties((part.mesh, part.density) for part in self.parts)

    def collision_parts(self) -> list[trimesh.Trimesh]:
        """Convex collision meshes whose union covers the tool, `tool` frame [m].

        `metadata["label"]` of each mesh is the label of its part. The striking face of a hammer is exactly flat;
        holes are filled, slots and jaws are not.
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


def assemble(kind: ToolKind, seed: int, pieces: list[Piece], ees: tuple[EndEffector, ...], handle: Handle) -> Tool:
    """Unite overlapping pieces into a tool.

    Where two pieces overlap, the volume belongs to the later one: a handle fills the eye of its head.

    Args:
        kind: Kind of the tool.
        seed: Seed of the tool, 0 or more.
        pieces: Solids in the `tool` frame [m].
        ees: End effectors, the working end first.
        handle: Grippable section of the tool.

    Returns:
        The tool; its parts have the order of `pieces`.
    """
    mesh, owner = unite([piece.solid for piece in pieces])
    later = [tuple(piece.solid for piece in pieces[i + 1 :]) for i in range(len(pieces))]
    return Tool(
        name=tool_name(kind, seed),
        kind=kind,
        seed=seed,
        parts=tuple(SolidPart(p.label, p.material, p.solid, others) for p, others in zip(pieces, later, strict=True)),
        mesh=mesh,
        face_parts=owner,
        ees=ees,
        handle=handle,
        _convex=tuple((piece.label, convex) for piece in pieces for convex in piece.convex),
    )

"""The tree of a robot's links and joints, and the meshes of its links in metres, simplified for rendering."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh

from toolee_robot.errors import AssetError, words_of
from toolee_robot.frames import Array

MODELS = Path(__file__).parent / "models"
"""Model files and licences of arms and hands, one folder each."""
UR10_URDF = MODELS / "ur10" / "ur10_robot.urdf"
SHADOW_HAND_URDF = MODELS / "shadow_hand" / "shadow_hand.urdf"
INSPIRE_RH56_URDF = MODELS / "inspire_rh56" / "inspire_rh56.urdf"
ABILITY_HAND_URDF = MODELS / "ability_hand" / "ability_hand.urdf"


def cluster_vertices(mesh: trimesh.Trimesh, cell: float) -> trimesh.Trimesh:
    """Simplify a mesh by vertex clustering.

    Args:
        mesh: The mesh [m].
        cell: Edge of the cubes [m] whose vertices are merged into their mean.

    Returns:
        The mesh without degenerate and duplicate faces.
    """
    keys = np.floor(mesh.vertices / cell).astype(np.int64)
    _, index = np.unique(keys, axis=0, return_inverse=True)
    index = index.reshape(-1)
    count = np.bincount(index)
    vertices = np.column_stack([np.bincount(index, weights=mesh.vertices[:, k]) / count for k in range(3)])
    faces = index[mesh.faces]
    keep = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[keep]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return trimesh.Trimesh(vertices, faces[np.sort(first)], process=False)


def link_mesh(link: Link, cell: float | None) -> trimesh.Trimesh | None:
    """The visual mesh of a link.

    Args:
        link: The link.
        cell: Cell size [m] of `cluster_vertices`; None: no simplification.

    Returns:
        The mesh in the link frame [m]; None if the link has no visual.

    Raises:
        AssetError: A mesh file is missing or unreadable.
    """
    parts = []
    for shape in link.visuals:
        mesh = _shape_mesh(shape)
        mesh.merge_vertices()
        mesh.apply_transform(shape.X_link_shape)
        parts.append(mesh if cell is None else cluster_vertices(mesh, cell))
    if not parts:
        return None
    vertices = np.concatenate([part.vertices for part in parts])
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)])
    return trimesh.Trimesh(vertices, faces, process=False)


def _shape_mesh(shape: Shape) -> trimesh.Trimesh:
    """The mesh of a shape in its own frame [m]."""
    match shape.kind:
        case "box":
            return trimesh.creation.box(shape.size)
        case "cylinder":
            return trimesh.creation.cylinder(shape.size[0], shape.size[1])
        case "sphere":
            return trimesh.creation.icosphere(radius=shape.size[0])
    try:
        mesh: trimesh.Trimesh = trimesh.load_mesh(shape.mesh)
    except (OSError, ValueError) as error:
        raise AssetError(f"cannot read the mesh {shape.mesh}: {words_of(error)}; put the model's files back") from error
    mesh.vertices *= shape.scale
    return mesh


FLANGE_FRAME = "tool0"
"""Name of the arm's last link, which carries the hand."""


def _rotations(axes: Array, angles: Array) -> Array:
    """Rotation matrices (n, 3, 3) of unit axes (n, 3) and angles (n,) [rad] by Rodrigues' formula.

    scipy's Rotation takes ten times as long.
    """
    x, y, z = axes.T
    c, s = np.cos(angles), np.sin(angles)
    t = 1.0 - c
    rows = [
        [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
        [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
        [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
    ]
    return np.array(rows).transpose(2, 0, 1)


@dataclass(frozen=True)
class Shape:
    """A visual or collision shape of a link.

    Attributes:
        kind: "box", "cylinder" (along z), "sphere" or "mesh".
        size: Full extents of a box, radius and length of a cylinder, radius of a sphere [m]; empty for a mesh.
        X_link_shape: Pose of the shape in the link frame, 4x4 [m].
        mesh: STL file of a mesh; None for other kinds.
        scale: Factor from the unit of the STL file to metres.
    """

    kind: str
    size: tuple[float, ...]
    X_link_shape: Array
    mesh: Path | None = None
    scale: float = 1.0


@dataclass(frozen=True)
class Inertial:
    """Inertia of a link.

    Attributes:
        mass: Mass [kg].
        X_link_com: Pose of the principal axes at the centre of mass in the link frame, 4x4 [m].
        moments: Principal moments of inertia (3,) [kg m^2].
    """

    mass: float
    X_link_com: Array
    moments: tuple[float, float, float]


NEARLY_MASSLESS = Inertial(1e-3, np.eye(4), (1e-7, 1e-7, 1e-7))
"""Inertia of a link without mass: an engine assumes 1 kg where there is none."""


@dataclass(frozen=True)
class Link:
    """A link and the joint that connects it to its parent.

    Attributes:
        name: Name of the link.
        parent: Name of the parent link; None for the root.
        X_parent_joint: Pose of the joint frame, the link frame at q = 0, in the parent link, 4x4 [m].
        joint: Name of the joint.
        axis: Unit vector (3,) of a revolute joint in the joint frame; None for a fixed joint.
        lower: Lower position limit [rad].
        upper: Upper position limit [rad].
        effort: Torque limit [Nm].
        velocity: Velocity limit [rad/s].
        inertial: Inertia; None without mass.
        visuals: Shapes for rendering.
        collisions: Shapes for collision checks.
    """

    name: str
    parent: str | None
    X_parent_joint: Array
    joint: str
    axis: Array | None = None
    lower: float = 0.0
    upper: float = 0.0
    effort: float = 0.0
    velocity: float = 0.0
    inertial: Inertial | None = None
    visuals: tuple[Shape, ...] = ()
    collisions: tuple[Shape, ...] = ()


def _fixed(link: Link, position: float | None) -> Link:
    """The link, its joint fixed at a position [rad]; None for as it is."""
    if link.axis is None or position is None:
        return link
    X = link.X_parent_joint.copy()
    X[:3, :3] = X[:3, :3] @ _rotations(link.axis[None], np.array([position]))[0]
    return replace(link, X_parent_joint=X, axis=None)


class Tree:
    """A kinematic tree.

    Attributes:
        links: Links, parents before children.
        by_name: Link name -> link.
    """

    def __init__(self, links: tuple[Link, ...]) -> None:
        self.links = links
        self.by_name = {link.name: link for link in links}
        axes = [link.axis for link in links if link.axis is not None]
        self._axes: Array = np.reshape(axes, (-1, 3))
        # Rows are ordered by depth: links of equal depth (the joints of the fingers) are computed together.
        depth: dict[str, int] = {}
        for link in links:
            depth[link.name] = depth[link.parent] + 1 if link.parent in depth else 0
        ordered = sorted(links, key=lambda link: depth[link.name])
        rows = {link.name: i for i, link in enumerate(ordered)}
        ends = np.cumsum(np.bincount([*depth.values()])).tolist()
        self._levels = [
            (slice(first, end), np.array([rows[link.parent] for link in ordered[first:end] if link.parent]))
            for first, end in pairwise(ends)
        ]
        self._rows = {link.name: rows[link.name] for link in links}
        self._movable = np.array([rows[link.name] for link in links if link.axis is not None], np.int64)
        self._Xs_parent_joint = np.stack([link.X_parent_joint for link in ordered])

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the movable joints, in tree order."""
        return tuple(link.joint for link in self.links if link.axis is not None)

    def carried_by(self, joint: str) -> str:
        """Name of the child link of a joint."""
        return next(link.name for link in self.links if link.joint == joint)

    def ancestors(self, link: str) -> list[str]:
        """Names of the links from `link` (first) up to the root."""
        found = [link]
        while (parent := self.by_name[found[-1]].parent) in self.by_name:
            found.append(parent or "")
        return found

    def with_fixed(self, positions: Mapping[str, float]) -> Tree:
        """Fix some of the joints.

        Args:
            positions: Their names, and where they are fixed [rad].

        Returns:
            The tree with fixed joints in their places.
        """
        return Tree(tuple(_fixed(link, positions.get(link.joint)) for link in self.links))

    def limits(self) -> tuple[Array, Array]:
        """Lower and upper position limits [rad] of the movable joints, (n,) each."""
        movable = [link for link in self.links if link.axis is not None]
        return np.array([link.lower for link in movable]), np.array([link.upper for link in movable])

    def link_poses(self, q: Array) -> dict[str, Array]:
        """Forward kinematics of all links.

        Args:
            q: Joint positions (n,) [rad], in the order of `joints`.

        Returns:
            Link name -> pose (4x4) [m] in the parent frame of the root.

        Raises:
            ValueError: q has another shape.
        """
        q = np.asarray(q, dtype=np.float64)
        if q.shape != (len(self._axes),):
            raise ValueError(f"q must have shape ({len(self._axes)},), got {q.shape}")
        X = self._Xs_parent_joint.copy()
        X[self._movable, :3, :3] = X[self._movable, :3, :3] @ _rotations(self._axes, q)
        for level, parents in self._levels:
            X[level] = X[parents] @ X[level]
        return {name: X[row] for name, row in self._rows.items()}


FUSED = " fused"
"""End of the name of a link that replaces others, after that of its parent."""


@dataclass(frozen=True)
class FusedTree:
    """A tree some of whose links are one with others.

    Attributes:
        tree: The tree.
        places: For each link that is no longer in it, the link to which it is fixed, and its pose in that link, 4x4.
    """

    tree: Tree
    places: dict[str, tuple[str, Array]]


def fuse_links(tree: Tree, names: Collection[str]) -> FusedTree:
    """Make one link of all that are fixed to the same link.

    Their parent keeps its own mass, so that a force sensor in its joint measures along the same axes.

    Args:
        tree: The tree.
        names: Links to fuse; those whose joint moves stay.

    Returns:
        The tree, in which a link "PARENT fused", in the frame of its parent, replaces them.
    """
    places: dict[str, tuple[str, Array]] = {}
    kept: list[Link] = []
    for link in tree.links:
        if link.parent is not None and link.axis is None and link.name in names:
            at, X = places.get(link.parent, (link.parent, np.eye(4)))
            places[link.name] = at, X @ link.X_parent_joint
        else:
            kept.append(link)
    carried: list[Link] = []
    for link in kept:
        if link.parent in places:
            at, X = places[link.parent]
            link = replace(link, parent=at, X_parent_joint=X @ link.X_parent_joint)
        carried.append(link)
    for parent in dict.fromkeys(at for at, _ in places.values()):
        parts = [(tree.by_name[name], X) for name, (at, X) in places.items() if at == parent]
        inertials = [_moved(link.inertial, X) for link, X in parts if link.inertial is not None]
        carried.append(
            Link(
                f"{parent}{FUSED}",
                parent,
                np.eye(4),
                f"{parent}_fused",
                inertial=combined(inertials) if inertials else None,
                visuals=tuple(_placed(shape, X) for link, X in parts for shape in link.visuals),
                collisions=tuple(_placed(shape, X) for link, X in parts for shape in link.collisions),
            )
        )
    return FusedTree(Tree(tuple(carried)), places)


def combined(inertials: Sequence[Inertial]) -> Inertial:
    """Inertia of several bodies that do not move against each other.

    Args:
        inertials: Theirs, in one frame; at least one.

    Returns:
        That of all, in the same frame.
    """
    mass = sum(body.mass for body in inertials)
    centre = sum((body.mass * body.X_link_com[:3, 3] for body in inertials), np.zeros(3)) / mass
    tensor = np.zeros((3, 3))
    for body in inertials:
        R, p = body.X_link_com[:3, :3], body.X_link_com[:3, 3] - centre
        tensor += R @ np.diag(body.moments) @ R.T + body.mass * (p @ p * np.eye(3) - np.outer(p, p))  # Steiner
    moments, axes = np.linalg.eigh(tensor)
    X = np.eye(4)
    X[:3, :3] = axes * np.sign(np.linalg.det(axes))
    X[:3, 3] = centre
    return Inertial(mass, X, (float(moments[0]), float(moments[1]), float(moments[2])))


def _moved(inertial: Inertial, X: Array) -> Inertial:
    return replace(inertial, X_link_com=X @ inertial.X_link_com)


def _placed(shape: Shape, X: Array) -> Shape:
    return replace(shape, X_link_shape=X @ shape.X_link_shape)

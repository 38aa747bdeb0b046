"""Links that do not move against each other as one link: physics takes time for each link, whether it moves or not."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.robots.tree import Inertial, Link, Shape, Tree

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

"""Read the UR10's URDF into a `Tree`, and write a `Tree` as URDF."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.errors import AssetError
from toolee_robot.frames import Array, transform
from toolee_robot.robots.tree import Inertial, Link, Shape, Tree

UR10_FRAMES = (
    "base_link",
    "shoulder_link",
    "upper_arm_link",
    "forearm_link",
    "wrist_1_link",
    "wrist_2_link",
    "wrist_3_link",
    "tool0",
)

# Stands for the plate between the flange and the hand; pybullet would give a link without inertia 1 kg and 1 kg m^2.
_MOUNTING_PLATE = Inertial(0.1, transform(p=[0.0, 0.0, 0.005]), (5e-5, 5e-5, 1e-4))


def _numbers(text: str) -> Array:
    return np.array([float(v) for v in text.split()])


def _origin(parent: Element) -> Array:
    origin = parent.find("origin")
    if origin is None:
        return np.eye(4)
    R = Rotation.from_euler("xyz", _numbers(origin.get("rpy", "0 0 0")))
    return transform(R, _numbers(origin.get("xyz", "0 0 0")))


def _require(parent: Element, tag: str) -> Element:
    element = parent.find(tag)
    if element is None:
        raise AssetError(f"the UR10's URDF lacks <{tag}> in {parent.get('name')}")
    return element


def read_ur10(path: Path) -> Tree:
    """The UR10's links from `base_link` to `tool0`; the collision meshes serve as visuals too."""
    try:
        root = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise AssetError(f"cannot read {path}: {error}; pip install --force-reinstall example-robot-data") from error
    joints = {_require(j, "child").get("link"): j for j in root.findall("joint")}
    elements = {link.get("name"): link for link in root.findall("link")}
    links = []
    for i, name in enumerate(UR10_FRAMES):
        element = elements[name]
        shapes = []
        for collision in element.findall("collision"):
            mesh = _require(_require(collision, "geometry"), "mesh")
            file = path.parents[4] / mesh.get("filename", "").removeprefix("package://")
            shapes.append(Shape("mesh", (), _origin(collision), file))
        inertial = _MOUNTING_PLATE if name == "tool0" else None
        body = _require(element, "inertial")
        mass = float(_require(body, "mass").get("value", "0"))
        if mass > 0:
            moments = _require(body, "inertia")
            diagonal = tuple(float(moments.get(k, "0")) for k in ("ixx", "iyy", "izz"))
            inertial = Inertial(mass, _origin(body), (diagonal[0], diagonal[1], diagonal[2]))
        link = Link(name, None, np.eye(4), "", inertial=inertial, visuals=tuple(shapes), collisions=tuple(shapes))
        if i > 0:
            joint = joints[name]
            parent = _require(joint, "parent").get("link")
            link = replace(link, parent=parent, X_parent_joint=_origin(joint), joint=joint.get("name", ""))
            limit = joint.find("limit")
            if limit is not None:
                link = replace(
                    link,
                    axis=_numbers(_require(joint, "axis").get("xyz", "")),
                    lower=float(limit.get("lower", "0")),
                    upper=float(limit.get("upper", "0")),
                    effort=float(limit.get("effort", "0")),
                    velocity=float(limit.get("velocity", "0")),
                )
        links.append(link)
    return Tree(tuple(links))


def _add_origin(parent: Element, X: Array) -> None:
    SubElement(parent, "origin", xyz=_text(X[:3, 3]), rpy=_text(_rpy(X[:3, :3])))


def _rpy(R: Array) -> Array:
    """Fixed-axis roll, pitch, yaw [rad]; at a pitch of 90 deg the yaw is 0."""
    horizontal = np.hypot(R[0, 0], R[1, 0])
    pitch = np.arctan2(-R[2, 0], horizontal)
    if horizontal < 1e-9:
        return np.array([np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def _text(values: Array) -> str:
    return " ".join(f"{v:.12g}" for v in values)


def _add_shape(parent: Element, tag: str, shape: Shape, mesh_path: Callable[[Shape], Path]) -> None:
    element = SubElement(parent, tag)
    _add_origin(element, shape.X_link_shape)
    geometry = SubElement(element, "geometry")
    if shape.kind == "box":
        SubElement(geometry, "box", size=_text(np.array(shape.size)))
    elif shape.kind == "cylinder":
        SubElement(geometry, "cylinder", radius=f"{shape.size[0]:.12g}", length=f"{shape.size[1]:.12g}")
    elif shape.kind == "sphere":
        SubElement(geometry, "sphere", radius=f"{shape.size[0]:.12g}")
    else:
        SubElement(geometry, "mesh", filename=str(mesh_path(shape)), scale=" ".join([f"{shape.scale:g}"] * 3))


def _add_inertial(parent: Element, inertial: Inertial) -> None:
    element = SubElement(parent, "inertial")
    _add_origin(element, inertial.X_link_com)
    SubElement(element, "mass", value=f"{inertial.mass:.12g}")
    xx, yy, zz = (f"{m:.12g}" for m in inertial.moments)
    SubElement(element, "inertia", ixx=xx, ixy="0", ixz="0", iyy=yy, iyz="0", izz=zz)


def write_urdf(name: str, tree: Tree, mesh_path: Callable[[Shape], Path]) -> str:
    """URDF text of the tree; `mesh_path` gives the file to name for a mesh shape."""
    root = Element("robot", name=name)
    for link in tree.links:
        element = SubElement(root, "link", name=link.name)
        if link.inertial is not None:
            _add_inertial(element, link.inertial)
        for shape in link.visuals:
            _add_shape(element, "visual", shape, mesh_path)
        for shape in link.collisions:
            _add_shape(element, "collision", shape, mesh_path)
        if link.parent is None:
            continue
        joint = SubElement(root, "joint", name=link.joint, type="fixed" if link.axis is None else "revolute")
        SubElement(joint, "parent", link=link.parent)
        SubElement(joint, "child", link=link.name)
        _add_origin(joint, link.X_parent_joint)
        if link.axis is not None:
            SubElement(joint, "axis", xyz=_text(link.axis))
            limits = {"lower": link.lower, "upper": link.upper, "effort": link.effort, "velocity": link.velocity}
            SubElement(joint, "limit", {k: f"{v:.12g}" for k, v in limits.items()})
            SubElement(joint, "dynamics", damping="0", friction="0")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")

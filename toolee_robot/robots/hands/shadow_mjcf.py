"""Read the Shadow Hand (right) from its MJCF (`models/shadow_hand`) into a `Tree`.

Names become the maker's: the MJCF counts a finger's joints from 0, Shadow from 1 (`robot0:FFJ3` is `rh_FFJ4`).
Capsules become a cylinder and a sphere at the far end, because URDF has no capsule that all parsers read.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.errors import AssetError
from toolee_robot.frames import Array, transform
from toolee_robot.robots.tree import Inertial, Link, Shape, Tree

# The MJCF's forearm has its centre of mass at 0.29 m, beyond the wrist at 0.256 m, and the inertia of a smaller body.
# Here: a cylinder of the same 4 kg filling the mesh.
FOREARM_RADIUS, FOREARM_LENGTH = 0.068, 0.230  # [m]
FOREARM_CENTER = (0.0, 0.01, 0.155)  # [m] in the forearm's frame
FINGER_VELOCITY = 5.0  # [rad/s]


def _vector(element: ElementTree.Element, name: str, default: str) -> Array:
    return np.array([float(v) for v in element.get(name, default).split()])


def _pose(element: ElementTree.Element) -> Array:
    """Pose of a body, geom or inertial: pos and one of quat (wxyz), euler (intrinsic xyz), axisangle."""
    if element.get("quat"):
        w, x, y, z = _vector(element, "quat", "")
        R = Rotation.from_quat([x, y, z, w])
    elif element.get("axisangle"):
        v = _vector(element, "axisangle", "")
        R = Rotation.from_rotvec(v[:3] / np.linalg.norm(v[:3]) * v[3])
    else:
        R = Rotation.from_euler("XYZ", _vector(element, "euler", "0 0 0"))
    return transform(R, _vector(element, "pos", "0 0 0"))


def _link_name(name: str) -> str:
    return name.replace("robot0:", "rh_")


def _joint_name(name: str) -> str:
    match = re.fullmatch(r"robot0:([A-Z]+J)(\d)", name)
    if match is None:
        raise AssetError(f"unexpected joint {name!r} in the Shadow Hand's MJCF")
    return f"rh_{match[1]}{int(match[2]) + 1}"


def _capsule(X: Array, radius: float, half_length: float) -> tuple[Shape, Shape]:
    tip = X @ transform(p=[0.0, 0.0, half_length])
    return Shape("cylinder", (radius, 2 * half_length), X), Shape("sphere", (radius,), tip)


def _collisions(body: ElementTree.Element) -> tuple[Shape, ...]:
    shapes: list[Shape] = []
    for geom in body.findall("geom"):
        if geom.get("class") != "robot0:DC_Hand":
            continue
        size, X = _vector(geom, "size", "0"), _pose(geom)
        if geom.get("type") == "box":
            shapes.append(Shape("box", tuple((2 * size).tolist()), X))
        elif geom.get("type") == "capsule":
            shapes.extend(_capsule(X, float(size[0]), float(size[1])))
        else:
            shapes.append(Shape("cylinder", (FOREARM_RADIUS, FOREARM_LENGTH), transform(p=FOREARM_CENTER)))
    return tuple(shapes)


def _inertial(body: ElementTree.Element) -> Inertial:
    element = body.find("inertial")
    if element is None:
        raise AssetError(f"body {body.get('name')} has no inertia")
    mass = float(element.get("mass", "0"))
    if body.get("name") == "robot0:forearm":
        side = mass * (3 * FOREARM_RADIUS**2 + FOREARM_LENGTH**2) / 12
        return Inertial(mass, transform(p=FOREARM_CENTER), (side, side, mass * FOREARM_RADIUS**2 / 2))
    moments = _vector(element, "diaginertia", "0 0 0")
    return Inertial(mass, _pose(element), (float(moments[0]), float(moments[1]), float(moments[2])))


def _efforts(root: ElementTree.Element) -> dict[str, float]:
    """Torque limits [Nm] by MJCF joint; a finger's last joint hangs on the tendon of the one before."""
    efforts = {
        a.get("joint", ""): float(_vector(a, "forcerange", "0 0")[1]) for a in root.iter("position") if a.get("joint")
    }
    for finger in ("FF", "MF", "RF", "LF"):
        efforts[f"robot0:{finger}J0"] = efforts[f"robot0:{finger}J1"]
    return efforts


def read_shadow_hand(path: Path, parent: str, X_parent_forearm: Array) -> Tree:
    """The hand's links, its forearm fixed to link `parent`.

    Args:
        path: robot.xml; shared.xml, shared_asset.xml and the folder meshes lie beside it.
        parent: Name of the link that carries the forearm.
        X_parent_forearm: Pose of the forearm in it, 4x4.

    Returns:
        The links.

    Raises:
        AssetError: A file is missing or cannot be read.
    """
    try:
        robot, shared, meshes = (
            ElementTree.parse(path.with_name(name)).getroot() for name in (path.name, "shared.xml", "shared_asset.xml")
        )
    except (OSError, ElementTree.ParseError) as error:
        raise AssetError(f"cannot read the Shadow Hand: {error}; install toolee_robot again") from error
    files = {
        m.get("name", ""): (path.parent / "meshes" / m.get("file", ""), float(_vector(m, "scale", "1 1 1")[0]))
        for m in meshes.iter("mesh")
    }
    efforts = _efforts(shared)
    links: list[Link] = []

    def add(body: ElementTree.Element, parent: str, X: Array) -> None:
        name = _link_name(body.get("name", ""))
        joint = body.find("joint")
        visuals = tuple(
            Shape("mesh", (), _pose(g), *files[g.get("mesh", "")])
            for g in body.findall("geom")
            if g.get("class") == "robot0:D_Vizual"
        )
        link = Link(
            name, parent, X, f"{name}_mount", inertial=_inertial(body), visuals=visuals, collisions=_collisions(body)
        )
        if joint is not None:
            axis = _vector(joint, "axis", "0 0 1")
            lower, upper = _vector(joint, "range", "0 0")
            link = replace(
                link,
                joint=_joint_name(joint.get("name", "")),
                axis=axis / np.linalg.norm(axis),
                lower=float(lower),
                upper=float(upper),
                effort=efforts[joint.get("name", "")],
                velocity=FINGER_VELOCITY,
            )
        links.append(link)
        for child in body.findall("body"):
            add(child, name, _pose(child))

    forearm = robot.find(".//body[@name='robot0:forearm']")
    if forearm is None:
        raise AssetError(f"{path} has no forearm: install toolee_robot again")
    add(forearm, parent, X_parent_forearm)
    return Tree(tuple(links))

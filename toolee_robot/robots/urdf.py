"""Conversion between URDF and `Tree`, and the DH parameters of the UR arms with the URDF joint origins they give.

X_base_flange(q) = prod_i Rz(q_i + theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i), where `base` is the base frame of the UR
controller, `base_link` rotated by 180 degrees about z, and `flange` is `tool0`. A factory calibration adds a delta to
each parameter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.errors import AssetError, words_of
from toolee_robot.frames import HALF_TURN, Array, inverse, transform
from toolee_robot.robots.tree import NEARLY_MASSLESS, Inertial, Link, Shape, Tree
from toolee_robot.types import ArmModel, DhCalibration


def _numbers(text: str) -> Array:
    return np.array([float(v) for v in text.split()])


def _origin(parent: Element) -> Array:
    origin = parent.find("origin")
    if origin is None:
        return np.eye(4)
    if "quat_xyzw" in origin.keys():  # noqa: SIM118  (an XML element iterates over its children)
        R = Rotation.from_quat(_numbers(origin.get("quat_xyzw", "")))
    else:
        R = Rotation.from_euler("xyz", _numbers(origin.get("rpy", "0 0 0")))
    return transform(R, _numbers(origin.get("xyz", "0 0 0")))


def _require(parent: Element, tag: str) -> Element:
    element = parent.find(tag)
    if element is None:
        raise AssetError(f"the URDF lacks <{tag}> in {parent.get('name')}")
    return element


def _parse(path: Path) -> tuple[dict[str, Element], dict[str, Element]]:
    """Links by name, and joints by the name of their child link."""
    try:
        root = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise AssetError(f"cannot read {path}: {words_of(error)}; put the model's files back") from error
    links = {link.get("name", ""): link for link in root.findall("link")}
    return links, {_require(joint, "child").get("link", ""): joint for joint in root.findall("joint")}


def _inertial(element: Element) -> Inertial | None:
    """Inertia of a link element; None without mass."""
    body = element.find("inertial")
    mass = 0.0 if body is None else float(_require(body, "mass").get("value", "0"))
    if body is None or mass <= 0:
        return None
    entries = _require(body, "inertia")
    xx, xy, xz, yy, yz, zz = (float(entries.get(k, "0")) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    if xy == xz == yz == 0.0:
        return Inertial(mass, _origin(body), (xx, yy, zz))
    moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    return Inertial(mass, _origin(body) @ transform(axes), (float(moments[0]), float(moments[1]), float(moments[2])))


def _with_joint(link: Link, joint: Element) -> Link:
    link = replace(
        link,
        parent=_require(joint, "parent").get("link"),
        X_parent_joint=_origin(joint),
        joint=joint.get("name", ""),
    )
    if joint.get("type") not in ("revolute", "fixed"):
        raise AssetError(f"joint {link.joint} is {joint.get('type')}: only revolute and fixed joints are supported")
    if joint.get("type") == "fixed":
        return link
    limit, axis = _require(joint, "limit"), _numbers(_require(joint, "axis").get("xyz", ""))
    return replace(
        link,
        axis=axis / np.linalg.norm(axis),
        lower=float(limit.get("lower", "0")),
        upper=float(limit.get("upper", "0")),
        effort=float(limit.get("effort", "0")),
        velocity=float(limit.get("velocity", "0")),
    )


def read_urdf(
    path: Path,
    parent: str | None,
    X_parent_root: Array,
    *,
    substitute_shapes: bool = True,
    most_effort: float = np.inf,
) -> Tree:
    """Read the links of an arm or a hand from its URDF.

    Mesh paths, without `package://`, are resolved relative to the folder of the file and to each folder above it.
    Mimic joints are treated as independent joints.

    Args:
        path: The URDF file. Its joints must be revolute or fixed, its mesh files STL.
        parent: Name of the parent link of the root link; None: it has none.
        X_parent_root: Pose of the root link in the parent link, 4x4 [m].
        substitute_shapes: Whether a link without visuals uses its collision shapes as visuals, and vice versa.
        most_effort: Torque limit of each joint whose own one is larger [Nm].

    Returns:
        The links.

    Raises:
        AssetError: A file is missing or unreadable, or the URDF has no single root link or an unsupported joint.
    """
    elements, joints = _parse(path)
    children: dict[str, list[str]] = {}
    for child, joint in joints.items():
        children.setdefault(_require(joint, "parent").get("link", ""), []).append(child)
    links: list[Link] = []

    def add(name: str) -> None:
        visuals, collisions = (
            tuple(_shape(path, e) for e in elements[name].findall(tag)) for tag in ("visual", "collision")
        )
        if substitute_shapes:
            visuals, collisions = visuals or collisions, collisions or visuals
        link = Link(
            name, parent, X_parent_root, f"{name}_mount", inertial=_inertial(elements[name]) or NEARLY_MASSLESS,
            visuals=visuals, collisions=collisions,
        )  # fmt: skip
        if name in joints:
            link = _with_joint(link, joints[name])
        links.append(replace(link, effort=min(link.effort, most_effort)))
        for child in children.get(name, ()):
            add(child)

    roots = [name for name in elements if name not in joints]
    if len(roots) != 1:
        raise AssetError(f"{path} must have one root link, it has {roots}")
    add(roots[0])
    return Tree(tuple(links))


def _shape(path: Path, element: Element) -> Shape:
    """The shape of a <visual> or <collision> element."""
    X, geometry = _origin(element), _require(element, "geometry")
    for kind, keys in (("box", ("size",)), ("cylinder", ("radius", "length")), ("sphere", ("radius",))):
        found = geometry.find(kind)
        if found is not None:
            return Shape(kind, tuple(float(v) for key in keys for v in _numbers(found.get(key, ""))), X)
    mesh = _require(geometry, "mesh")
    name = mesh.get("filename", "").removeprefix("package://").removeprefix("file://")
    scale = float(_numbers(mesh.get("scale", "1 1 1"))[0])
    for folder in path.absolute().parents:
        if (folder / name).is_file():
            return Shape("mesh", (), X, folder / name, scale)
    raise AssetError(f"{path} names the mesh {name}, which is neither in its folder nor above it")


def _add_origin(parent: Element, X: Array) -> None:
    SubElement(parent, "origin", xyz=_text(X[:3, 3]), rpy=_text(_rpy(X[:3, :3])))


def _rpy(R: Array) -> Array:
    """Fixed-axis roll, pitch, yaw (3,) [rad] of a rotation matrix; at a pitch of +-90 degrees the yaw is 0."""
    horizontal = np.hypot(R[0, 0], R[1, 0])
    pitch = np.arctan2(-R[2, 0], horizontal)
    if horizontal < 1e-9:
        return np.array([np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def _text(values: Array) -> str:
    return " ".join(f"{v:.12g}" for v in values)


def _add_shape(parent: Element, tag: str, shape: Shape) -> None:
    element = SubElement(parent, tag)
    _add_origin(element, shape.X_link_shape)
    geometry = SubElement(element, "geometry")
    if shape.kind == "box":
        SubElement(geometry, "box", size=_text(np.array(shape.size)))
    elif shape.kind == "cylinder":
        SubElement(geometry, "cylinder", radius=f"{shape.size[0]:.12g}", length=f"{shape.size[1]:.12g}")
    elif shape.kind == "sphere":
        SubElement(geometry, "sphere", radius=f"{shape.size[0]:.12g}")
    elif shape.mesh is None:
        raise ValueError("a mesh shape without a file")
    else:
        SubElement(geometry, "mesh", filename=str(shape.mesh), scale=" ".join([f"{shape.scale:g}"] * 3))


def _add_inertial(parent: Element, inertial: Inertial) -> None:
    element = SubElement(parent, "inertial")
    _add_origin(element, inertial.X_link_com)
    SubElement(element, "mass", value=f"{inertial.mass:.12g}")
    xx, yy, zz = (f"{m:.12g}" for m in inertial.moments)
    SubElement(element, "inertia", ixx=xx, ixy="0", ixz="0", iyy=yy, iyz="0", izz=zz)


def write_urdf(name: str, tree: Tree) -> str:
    """Write a tree as URDF.

    Args:
        name: Name of the robot.
        tree: The tree.

    Returns:
        The URDF as text.
    """
    root = Element("robot", name=name)
    for link in tree.links:
        element = SubElement(root, "link", name=link.name)
        if link.inertial is not None:
            _add_inertial(element, link.inertial)
        for shape in link.visuals:
            _add_shape(element, "visual", shape)
        for shape in link.collisions:
            _add_shape(element, "collision", shape)
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


def dh_transform(theta: Array | float, d: float, a: float, alpha: float) -> Array:
    """Denavit-Hartenberg transforms.

    Args:
        theta: Joint angles (...,) [rad].
        d: Link offset [m].
        a: Link length [m].
        alpha: Link twist [rad].

    Returns:
        Poses (..., 4, 4) [m] of the next frame in this one.
    """
    theta = np.asarray(theta, dtype=np.float64)
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    X = np.zeros((*theta.shape, 4, 4))
    X[..., 0, 0], X[..., 0, 1], X[..., 0, 2], X[..., 0, 3] = c, -s * ca, s * sa, a * c
    X[..., 1, 0], X[..., 1, 1], X[..., 1, 2], X[..., 1, 3] = s, c * ca, -c * sa, a * s
    X[..., 2, 1], X[..., 2, 2], X[..., 2, 3] = sa, ca, d
    X[..., 3, 3] = 1.0
    return X


@dataclass(frozen=True)
class DhParameters:
    """DH parameters of the six joints, standard (distal) convention.

    Attributes:
        d: Link offsets (6,) [m].
        a: Link lengths (6,) [m].
        alpha: Link twists (6,) [rad].
        theta: Joint angle offsets (6,) [rad].
    """

    d: Array
    a: Array
    alpha: Array
    theta: Array

    @classmethod
    def of(cls, model: ArmModel, calibration: DhCalibration | None = None) -> DhParameters:
        """Parameters of an arm model.

        Args:
            model: The arm.
            calibration: Its factory calibration, whose deltas are added; None: nominal kinematics.

        Returns:
            The parameters.
        """
        data = ARM_DATA[model]
        nominal = cls(np.array(data.d), np.array(data.a), np.array(data.alpha), np.zeros(6))
        if calibration is None:
            return nominal
        c = calibration
        return cls(nominal.d + c.delta_d, nominal.a + c.delta_a, nominal.alpha + c.delta_alpha, np.array(c.delta_theta))

    def joint(self, i: int, q: float = 0.0) -> Array:
        """Pose of a DH frame in the one before, Rz(theta) Tz(d) Tx(a) Rx(alpha).

        Args:
            i: Index of the joint, 0 to 5.
            q: Angle of the joint [rad].

        Returns:
            Pose of DH frame i + 1 in frame i, (4, 4).
        """
        return dh_transform(q + self.theta[i], self.d[i], self.a[i], self.alpha[i])

    def fk(self, q: Array) -> Array:
        """Pose (4x4) [m] of the flange in the base frame of the controller at q (6,) [rad]."""
        X = np.eye(4)
        for i in range(6):
            X = X @ self.joint(i, float(q[i]))
        return X

    def zero_frames(self) -> list[Array]:
        """Frames of the arm at q = 0 in the base frame of the controller.

        Returns:
            7 poses, (4, 4) each: the six joint frames, joint axis along z, and the flange.
        """
        frames = [np.eye(4)]
        for i in range(6):
            frames.append(frames[-1] @ self.joint(i))
        return frames


def joint_origins(origins: list[Array], model: ArmModel, calibration: DhCalibration | None) -> list[Array]:
    """Joint origins from `base_link` to `tool0` for a model and a calibration.

    Each link frame, with the shapes and inertia of the link, stays fixed to the body that its joint moves. A
    calibration may shift the frames of parallel joints by metres along their axes and rotate them about these; each
    link frame is placed as close to its nominal pose as this freedom allows.

    Args:
        origins: Joint origins (7 of 4x4) of the URDF of a UR10, the flange last.
        model: The arm.
        calibration: Factory calibration of the arm; None: nominal kinematics.

    Returns:
        Joint origins (7 of 4x4) [m], the flange last.
    """
    ur10, nominal, own = DhParameters.of(ArmModel.UR10), DhParameters.of(model), DhParameters.of(model, calibration)
    X_dh_link = HALF_TURN
    placed = [HALF_TURN]
    for i, (was, wanted, will) in enumerate(zip(*(p.zero_frames() for p in (ur10, nominal, own)), strict=True)):
        X_dh_link = X_dh_link @ origins[i]
        X_turning_link = inverse(was) @ X_dh_link
        if i == 0:  # the shoulder geometry moves with the shoulder joint height d_1
            X_turning_link[2, 3] += nominal.d[0] - ur10.d[0]
        placed.append(will @ (_about_z(inverse(will) @ wanted) if i < 6 else np.eye(4)) @ X_turning_link)
    return [inverse(a) @ b for a, b in pairwise(placed)]


def _about_z(X: Array) -> Array:
    """The screw about z (rotation and translation) closest to X (4x4), which is nearly one."""
    turn = np.arctan2(X[1, 0] - X[0, 1], X[0, 0] + X[1, 1])
    screw = np.eye(4)
    screw[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    screw[2, 3] = X[2, 3]
    return screw

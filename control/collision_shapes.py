"""Convex collision shapes of arm links, hand, held tool and station."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import trimesh

from toolee_robot.control.robot_model import RobotModel
from toolee_robot.frames import Array, frame_from_axes, transform, transform_points
from toolee_robot.robots import SHAPE_MARGIN, HandModel
from toolee_robot.station import StationConfig, ToolEnvelope, WorkConfig

WORLD_JOINT = 0
"""Joint index of a body that stands still."""
TOOL_JOINT = 6
"""Joint index of a body on the flange."""
_RIM = 16
"""Corners of the polygon around a cylinder's rim."""


@dataclass(frozen=True)
class Body:
    """A convex shape that moves with one arm joint or stands still.

    Attributes:
        name: Name of the body.
        group: What it belongs to: "arm", "hand", "tool head", "block", ...
        joint: Joint that it moves with, 1 to 6; 0 if it stands still.
        geometry: The coal shape.
        X_joint_shape: Pose of the shape in the frame of its joint (in `base` for joint 0), (4, 4).
        spheres: Spheres that together cover the shape, (m, 4): centres in the joint's frame and radii [m]. They give a
            fast lower bound of a distance.
    """

    name: str
    group: str
    joint: int
    geometry: Any = field(repr=False)
    X_joint_shape: Array = field(repr=False)
    spheres: Array = field(repr=False)

    @property
    def points(self) -> Array:
        """Points whose convex hull encloses a carried body, (m, 3), in the frame of its joint [m]."""
        shape = self.geometry
        if isinstance(shape, coal.Convex):
            return transform_points(self.X_joint_shape, np.asarray(shape.points()))
        angle = np.linspace(0.0, 2.0 * np.pi, _RIM, endpoint=False)
        r = shape.radius / np.cos(np.pi / _RIM)
        rim = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(_RIM, shape.halfLength)])
        return transform_points(self.X_joint_shape, np.concatenate([rim, rim * [1.0, 1.0, -1.0]]))

    def moved(self, X: Array) -> Body:
        """Return the body transformed by X, (4, 4), in the frame of its joint."""
        spheres = np.column_stack([transform_points(X, self.spheres[:, :3]), self.spheres[:, 3]])
        return replace(self, X_joint_shape=X @ self.X_joint_shape, spheres=spheres)


def tool_bodies(envelope: ToolEnvelope, X_flange_ee: Array, X_joint6_flange: Array, margin: float = 0.0) -> list[Body]:
    """Build the bodies of the held tool, which move with the arm's last joint.

    Args:
        envelope: The tool's size.
        X_flange_ee: Pose of the end effector in the flange, (4, 4).
        X_joint6_flange: Pose of the flange in the last joint, (4, 4).
        margin: Distance by which each body is larger in every direction [m].

    Returns:
        Head, claw and handle.
    """
    e = envelope
    X = X_joint6_flange @ X_flange_ee
    x, z = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
    head = X @ transform(p=-0.5 * e.head_length * z)
    claw_length = e.head_length - e.handle_depth
    claw = X @ transform(p=0.5 * e.claw_radius * x - (e.head_length - 0.5 * claw_length) * z)
    handle = X @ frame_from_axes(z=x, x=z, p=0.5 * e.handle_length * x - e.handle_depth * z)
    return [
        _cylinder("tool head", e.head_radius + margin, e.head_length + 2.0 * margin, head),
        _cylinder("tool claw", e.claw_radius + margin, claw_length + 2.0 * margin, claw),
        _cylinder("tool handle", e.handle_radius + margin, e.handle_length + 2.0 * margin, handle),
    ]


@lru_cache(maxsize=2)
def arm_bodies(robot: RobotModel) -> tuple[Body, ...]:
    """Build the convex hulls of the arm's collision meshes, with the margin of the arm's model around them."""
    description = robot.description
    geometry = pin.buildGeomFromUrdfString(robot.model, description.urdf, pin.GeometryType.COLLISION)
    margin = SHAPE_MARGIN[description.model]
    joints: dict[str, int] = {}
    vertices: dict[str, list[Array]] = {}
    for item in geometry.geometryObjects:
        link = robot.model.frames[item.parentFrame].name
        if link in description.hand.tree.by_name:
            continue
        joints[link] = item.parentJoint
        points = transform_points(item.placement.homogeneous, np.asarray(item.geometry.vertices()))
        vertices.setdefault(link, []).append(points)
    return tuple(
        _hull(
            link.removesuffix("_link").replace("_", " "), "arm", joint, np.concatenate(vertices[link]),
            margin.get(link, 0.0),
        )
        for link, joint in joints.items()
    )  # fmt: skip


_HAND_CACHE: dict[tuple[HandModel, bytes], tuple[Body, ...]] = {}


def hand_bodies(robot: RobotModel, q_hand: Array) -> list[Body]:
    """Build the convex hulls of the hand's parts (forearm, palm, each finger).

    The hulls are cached for joint positions rounded to 0.01 rad (1 mm); their pose on the arm is exact.

    Args:
        robot: Kinematic model of arm and hand.
        q_hand: Joint positions at which the hand is locked, (n,) [rad].

    Returns:
        One body per part, on the arm's last joint.
    """
    hand = robot.description.hand
    key = (hand, np.round(q_hand, 2).tobytes())
    if key not in _HAND_CACHE:
        parts: dict[str, list[Array]] = {}
        poses = hand.link_poses(q_hand)
        for link, mesh in hand.meshes.items():
            part = "forearm of the hand" if link in hand.forearm else hand.part_of(link)
            part = hand.name if hand.clamps else part
            parts.setdefault(part, []).append(transform_points(poses[link], mesh.vertices))
        if len(_HAND_CACHE) > 32:
            _HAND_CACHE.clear()
        _HAND_CACHE[key] = tuple(
            _hull(name, "hand", TOOL_JOINT, np.concatenate(points)) for name, points in parts.items()
        )
    X = robot.arm.X_joint6_flange @ robot.X_flange_hand(q_hand)
    return [body.moved(X) for body in _HAND_CACHE[key]]


def station_bodies(config: StationConfig) -> list[Body]:
    """Build the boxes of table, stand, block, camera, person and the station's obstacles in `base`."""
    work, scene = config.work, config.scene
    return [
        box_body("table", (*scene.table_center, scene.table_height - 0.05), (*scene.table_size, 0.1)),
        rotated_box_body("stand", *work.stand_box(scene.table_height)),
        rotated_box_body("block", work.X_base_block, work.block_size),
        box_body("camera", config.camera.center, scene.camera_size),
        box_body("person", scene.person_center, scene.person_size),
        *(rotated_box_body(o.name, o.X_base_box, o.size) for o in scene.obstacles),
    ]


def nail_bodies(work: WorkConfig, names: Collection[str]) -> tuple[Body, ...]:
    """Build the boxes around nails as they stand before the first strike, in `base`.

    Args:
        work: The work.
        names: Names of the nails.

    Returns:
        A body each, of the group "nail".
    """
    found = []
    for name in names:
        nail = work.only(name)
        size = (nail.nail_head_diameter, nail.nail_head_diameter, nail.nail_protrusion)
        middle = nail.X_base_nail(nail.nail_protrusion / 2)
        found.append(replace(rotated_box_body(f"nail {name}", middle, size), group="nail"))
    return tuple(found)


def box_body(name: str, center: tuple[float, ...], size: tuple[float, ...]) -> Body:
    """Build an axis-aligned box in `base`.

    Args:
        name: Name and group of the body.
        center: Centre, (3,) [m].
        size: Edge lengths, (3,) [m].

    Returns:
        The body, fixed in `base`.
    """
    return rotated_box_body(name, transform(p=center), size)


def rotated_box_body(name: str, X_base_box: Array, size: tuple[float, ...]) -> Body:
    """Build a box in `base`.

    Args:
        name: Name and group of the body.
        X_base_box: Pose of its centre, (4, 4).
        size: Edge lengths, (3,) [m].

    Returns:
        The body, fixed in `base`.
    """
    radius = 0.5 * float(np.linalg.norm(size))
    covering = np.array([[*X_base_box[:3, 3], radius]], dtype=np.float64)
    return Body(name, name, WORLD_JOINT, coal.Box(*size), X_base_box, covering)


def _cylinder(name: str, radius: float, length: float, X: Array) -> Body:
    return Body(name, name, TOOL_JOINT, coal.Cylinder(radius, length), X, _cover(X, length, radius, 5))


def _cover(X: Array, length: float, radius: float, count: int) -> Array:
    """Spheres (count, 4) along the z axis of X that cover a cylinder, each a slice of it."""
    half = length / (2 * count)
    z = np.linspace(-0.5, 0.5, 2 * count + 1)[1::2] * length
    r = np.full(count, np.hypot(radius, half))
    return np.column_stack([transform_points(X, z[:, None] * np.array([[0, 0, 1.0]])), r])


def _hull(name: str, group: str, joint: int, vertices: Array, margin: float = 0.0) -> Body:
    """Build the convex hull of vertices (n, 3), with everything that is nearer to it than the margin [m]."""
    hull = trimesh.convex.convex_hull(vertices)
    points = coal.StdVec_Vec3s()
    for v in np.asarray(hull.vertices, dtype=np.float64):
        points.append(v)
    faces = coal.StdVec_Triangle()
    for f in hull.faces:
        faces.append(coal.Triangle(int(f[0]), int(f[1]), int(f[2])))
    # Spheres along the hull's longest axis: every slice of its bounding cylinder in one.
    center = hull.vertices.mean(axis=0)
    axis = np.linalg.svd(hull.vertices - center, full_matrices=False)[2][0]
    along = (hull.vertices - center) @ axis
    radius = float(np.max(np.linalg.norm(hull.vertices - center - along[:, None] * axis, axis=1)))
    length = float(np.ptp(along))
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    X = frame_from_axes(z=axis, x=other, p=center + axis * (along.min() + length / 2))
    count = max(1, round(length / radius))
    spheres = _cover(X, length, radius, count)
    spheres[:, 3] += margin
    convex = coal.Convex(points, faces)
    convex.setSweptSphereRadius(margin)
    return Body(name, group, joint, convex, np.eye(4), spheres)

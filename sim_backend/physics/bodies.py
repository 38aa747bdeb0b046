"""The passive bodies: table, stand, wooden block, and the tool as one free rigid body."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.config import StationConfig
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.sim_backend.physics.bullet import pb, rotation_matrix
from toolee_robot.sim_backend.physics.convex_margin import shrink_convex
from toolee_robot.tools import Tool

TABLE_THICKNESS = 0.04  # [m]
OBSTACLE_COLOR = (0.85, 0.65, 0.20)
"""Colour of a station's obstacles, RGB."""


def body_pose(client: int, body: int) -> Array:
    """Pose of a body's inertial frame.

    Args:
        client: pybullet's physics client.
        body: pybullet's id of the body.

    Returns:
        X_world_body, 4x4.
    """
    return _matrix(*pb.getBasePositionAndOrientation(body, physicsClientId=client))


def _matrix(p: tuple[float, ...], q: tuple[float, ...]) -> Array:
    X = np.eye(4)
    X[:3, :3] = rotation_matrix(q)
    X[:3, 3] = p
    return X


def set_body_pose(client: int, body: int, X_world_body: Array) -> None:
    """Move a body instantly, and set its velocity to zero.

    Args:
        client: pybullet's physics client.
        body: pybullet's id of the body.
        X_world_body: New pose of its inertial frame, 4x4.
    """
    q = Rotation.from_matrix(X_world_body[:3, :3]).as_quat()
    pb.resetBasePositionAndOrientation(body, X_world_body[:3, 3].tolist(), q.tolist(), physicsClientId=client)
    pb.resetBaseVelocity(body, [0, 0, 0], [0, 0, 0], physicsClientId=client)


def fixed_box(
    client: int,
    size: tuple[float, float, float],
    center: Array,
    color: tuple[float, float, float],
    rotation: Rotation | None = None,
) -> int:
    """Create a static box.

    Args:
        client: pybullet's physics client.
        size: Full extents [m].
        center: Position of its centre, (3,) [m].
        color: RGB in [0, 1].
        rotation: Rotation of its axes; None for those of the world.

    Returns:
        pybullet's id of the body.
    """
    half = [s / 2 for s in size]
    shape = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=half, physicsClientId=client)
    visual = pb.createVisualShape(pb.GEOM_BOX, halfExtents=half, rgbaColor=[*color, 1.0], physicsClientId=client)
    q = (Rotation.identity() if rotation is None else rotation).as_quat().tolist()
    return int(pb.createMultiBody(0.0, shape, visual, np.asarray(center).tolist(), q, physicsClientId=client))


@dataclass(frozen=True)
class Furniture:
    """The static bodies; the plane z = 0 of `base` is the table's top.

    Attributes:
        table: pybullet's id of the table.
        stand: pybullet's id of the stand.
        block: pybullet's id of the wooden block.
    """

    table: int
    stand: int
    block: int

    @classmethod
    def build(cls, client: int, config: StationConfig) -> Furniture:
        """Create the bodies of a station.

        Args:
            client: pybullet's physics client.
            config: The station.

        Returns:
            The bodies.
        """
        work = config.work
        x, y = work.block_center
        sx, sy = config.scene.table_size
        table = fixed_box(client, (sx, sy, TABLE_THICKNESS), np.array([0, 0, -TABLE_THICKNESS / 2]), (0.6, 0.58, 0.55))
        stand = fixed_box(
            client, (*work.stand_size, work.stand_height), np.array([x, y, work.stand_height / 2]), (0.35, 0.36, 0.4)
        )
        center = np.array([x, y, work.stand_height + work.block_size[2] / 2])
        block = fixed_box(client, work.block_size, center, (0.76, 0.6, 0.4))
        obstacles = [
            fixed_box(client, o.size, np.array(o.center), OBSTACLE_COLOR, Rotation.from_rotvec(o.rotation))
            for o in config.scene.obstacles
        ]
        for body in (table, stand, block, *obstacles):
            pb.changeDynamics(body, -1, restitution=0.0, lateralFriction=0.5, physicsClientId=client)
        return cls(table, stand, block)


class ToolBody:
    """A tool as a free rigid body of convex parts.

    Args:
        client: pybullet's physics client.
        tool: The tool.
        X_world_tool: Initial pose, 4x4.

    Attributes:
        tool: The tool.
        body: pybullet's id of the body.
        X_tool_inertial: Pose of the body's inertial frame, 4x4, which is the frame that pybullet reports.
    """

    def __init__(self, client: int, tool: Tool, X_world_tool: Array) -> None:
        self.tool = tool
        self._client = client
        moments, axes = np.linalg.eigh(tool.inertia)
        if np.linalg.det(axes) < 0:
            axes[:, 0] *= -1
        self.X_tool_inertial = transform(axes, tool.center_of_mass)
        self._X_inertial_tool = inverse(self.X_tool_inertial)
        self._place: tuple[object, object] | None = None
        self._pose = np.eye(4)
        self.body = self._load(self._X_inertial_tool, moments)
        pb.changeDynamics(
            self.body,
            -1,
            linearDamping=0.0,
            angularDamping=0.0,
            restitution=0.0,
            lateralFriction=0.5,
            physicsClientId=client,
        )
        self.place(X_world_tool)

    def _load(self, X_inertial_tool: Array, moments: Array) -> int:
        """Load the body from a temporary URDF: pybullet has no other way to make one body of several convex meshes."""
        robot = Element("robot", name="tool")
        link = SubElement(robot, "link", name="tool")
        inertial = SubElement(link, "inertial")
        SubElement(inertial, "mass", value=f"{self.tool.mass:.9g}")
        xx, yy, zz = (f"{m:.9g}" for m in moments)
        SubElement(inertial, "inertia", ixx=xx, ixy="0", ixz="0", iyy=yy, iyz="0", izz=zz)
        with tempfile.TemporaryDirectory() as folder:
            for i, mesh in enumerate(self.tool.collision_parts()):
                part = shrink_convex(mesh)  # pybullet adds the margin
                part.apply_transform(X_inertial_tool)
                file = Path(folder) / f"part{i}.obj"
                part.export(file)
                for kind in ("collision", "visual"):
                    geometry = SubElement(SubElement(link, kind), "geometry")
                    SubElement(geometry, "mesh", filename=str(file))
            urdf = Path(folder) / "tool.urdf"
            urdf.write_bytes(ElementTree.tostring(robot))
            flags = pb.URDF_USE_INERTIA_FROM_FILE
            return int(pb.loadURDF(str(urdf), flags=flags, physicsClientId=self._client))

    def place(self, X_world_tool: Array) -> None:
        """Move the tool instantly to a pose, at rest."""
        set_body_pose(self._client, self.body, X_world_tool @ self.X_tool_inertial)

    def pose(self) -> Array:
        """X_world_tool, 4x4."""
        # Called several times per step, so cached while the body does not move.
        p, q = pb.getBasePositionAndOrientation(self.body, physicsClientId=self._client)
        if (p, q) != self._place:
            self._place = (p, q)
            self._pose = _matrix(p, q) @ self._X_inertial_tool
        return self._pose.copy()

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
from toolee_robot.sim_backend.physics.bullet import pb
from toolee_robot.sim_backend.physics.convex_margin import shrink_convex
from toolee_robot.tools import Tool

TABLE_THICKNESS = 0.04  # [m]


def body_pose(client: int, body: int) -> Array:
    """X_world_body, 4x4, of the body's inertial frame."""
    p, q = pb.getBasePositionAndOrientation(body, physicsClientId=client)
    X = np.eye(4)
    X[:3, :3] = np.array(pb.getMatrixFromQuaternion(q)).reshape(3, 3)
    X[:3, 3] = p
    return X


def set_body_pose(client: int, body: int, X_world_body: Array) -> None:
    """Teleport a body, at rest."""
    q = Rotation.from_matrix(X_world_body[:3, :3]).as_quat()
    pb.resetBasePositionAndOrientation(body, X_world_body[:3, 3].tolist(), q.tolist(), physicsClientId=client)
    pb.resetBaseVelocity(body, [0, 0, 0], [0, 0, 0], physicsClientId=client)


def fixed_box(client: int, size: tuple[float, float, float], center: Array, color: tuple[float, float, float]) -> int:
    """A static box; size: full extents [m]."""
    half = [s / 2 for s in size]
    shape = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=half, physicsClientId=client)
    visual = pb.createVisualShape(pb.GEOM_BOX, halfExtents=half, rgbaColor=[*color, 1.0], physicsClientId=client)
    return int(pb.createMultiBody(0.0, shape, visual, np.asarray(center).tolist(), physicsClientId=client))


@dataclass(frozen=True)
class Furniture:
    """pybullet ids of the static bodies; the base plane is the table's top."""

    table: int
    stand: int
    block: int

    @classmethod
    def build(cls, client: int, config: StationConfig) -> Furniture:
        work = config.work
        x, y = work.nail_xy
        sx, sy = config.scene.table_size
        table = fixed_box(client, (sx, sy, TABLE_THICKNESS), np.array([0, 0, -TABLE_THICKNESS / 2]), (0.6, 0.58, 0.55))
        stand = fixed_box(
            client, (*work.stand_size, work.stand_height), np.array([x, y, work.stand_height / 2]), (0.35, 0.36, 0.4)
        )
        center = np.array([x, y, work.stand_height + work.block_size[2] / 2])
        block = fixed_box(client, work.block_size, center, (0.76, 0.6, 0.4))
        for body in (table, stand, block):
            pb.changeDynamics(body, -1, restitution=0.0, lateralFriction=0.5, physicsClientId=client)
        return cls(table, stand, block)


class ToolBody:
    """A tool as a free rigid body of convex parts. Its inertial frame is what pybullet moves."""

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
        """Only a URDF lets pybullet make one body of several convex meshes; it is read once and deleted."""
        robot = Element("robot", name="tool")
        link = SubElement(robot, "link", name="tool")
        inertial = SubElement(link, "inertial")
        SubElement(inertial, "mass", value=f"{self.tool.mass:.9g}")
        xx, yy, zz = (f"{m:.9g}" for m in moments)
        SubElement(inertial, "inertia", ixx=xx, ixy="0", ixz="0", iyy=yy, iyz="0", izz=zz)
        with tempfile.TemporaryDirectory() as folder:
            for i, mesh in enumerate(self.tool.collision_parts()):
                part = shrink_convex(mesh)  # pybullet grows it again
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
        """Teleport, at rest."""
        set_body_pose(self._client, self.body, X_world_tool @ self.X_tool_inertial)

    def pose(self) -> Array:
        """X_world_tool, 4x4."""
        # Asked for several times a step: computed once for a place.
        p, q = pb.getBasePositionAndOrientation(self.body, physicsClientId=self._client)
        if (p, q) != self._place:
            self._place = (p, q)
            self._pose = body_pose(self._client, self.body) @ self._X_inertial_tool
        return self._pose.copy()

"""The physics engine, and the bodies of the cell."""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import trimesh
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection
from scipy.spatial.transform import Rotation

from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.station import StationConfig
from toolee_robot.tools import Tool


@contextmanager
def quiet(descriptor: int) -> Iterator[None]:
    """Discard output to a file descriptor, including that of C libraries.

    Args:
        descriptor: 1 for standard output, 2 for standard error.
    """
    (sys.stdout if descriptor == 1 else sys.stderr).flush()
    c_library = ctypes.CDLL(None)  # C streams have their own buffers
    c_library.fflush(None)
    kept = os.dup(descriptor)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, descriptor)
        yield
    finally:
        c_library.fflush(None)
        os.dup2(kept, descriptor)
        os.close(kept)
        os.close(nowhere)


with quiet(2):
    import pybullet as pb

__all__ = ["pb", "pose_matrix", "quiet", "rotation_matrix"]


Vector = Sequence[float]
"""In Python's floats: numpy takes several times as long for three numbers."""


def rotation_matrix(quaternion: tuple[float, ...]) -> Array:
    """Rotation matrix (3, 3) of a quaternion (x, y, z, w)."""
    return np.array(pb.getMatrixFromQuaternion(quaternion)).reshape(3, 3)


def turned(R: Vector, v: Vector) -> tuple[float, float, float]:
    """Turn a vector, three of Python's floats, by a rotation matrix, given by its nine elements row by row."""
    x, y, z = v
    return R[0] * x + R[1] * y + R[2] * z, R[3] * x + R[4] * y + R[5] * z, R[6] * x + R[7] * y + R[8] * z


def pose_matrix(position: tuple[float, ...], quaternion: tuple[float, ...]) -> Array:
    """Build a pose from what pybullet reports.

    Args:
        position: Position [m].
        quaternion: Orientation (x, y, z, w).

    Returns:
        The pose, (4, 4).
    """
    xx, xy, xz, yx, yy, yz, zx, zy, zz = pb.getMatrixFromQuaternion(quaternion)
    x, y, z = position
    return np.array([[xx, xy, xz, x], [yx, yy, yz, y], [zx, zy, zz, z], [0.0, 0.0, 0.0, 1.0]])


MARGIN = 0.001  # [m] that pybullet adds to a convex mesh from a URDF
MIN_CORE = 1e-4  # [m] inscribed radius that remains of a part thinner than the margin


def shrink_convex(mesh: trimesh.Trimesh, margin: float = MARGIN) -> trimesh.Trimesh:
    """Shrink a convex mesh so that adding the margin restores its faces; the edges are then rounded.

    Args:
        mesh: Convex mesh [m].
        margin: The margin that pybullet adds [m].

    Returns:
        The shrunk mesh; of a mesh thinner than twice the margin, a core of inscribed radius MIN_CORE remains.
    """
    planes = ConvexHull(mesh.vertices).equations  # unit normals n and offsets b: n x + b <= 0 inside
    normals, offsets = planes[:, :3], planes[:, 3]
    # Largest inscribed ball: its centre lies inside the shrunk mesh, its radius limits the shrinking.
    columns = np.hstack([normals, np.ones((len(normals), 1))])
    ball = linprog([0, 0, 0, -1], A_ub=columns, b_ub=-offsets, bounds=[(None, None)] * 3 + [(0, None)])
    center, radius = ball.x[:3], ball.x[3]
    depth = min(margin, radius - min(MIN_CORE, radius / 2))
    shrunk = np.column_stack([normals, offsets + depth])
    corners = HalfspaceIntersection(shrunk, center).intersections
    return trimesh.Trimesh(corners).convex_hull


RESIDUAL = 1e-10
"""Squared velocity error at which the solver ends its iterations early [rad^2/s^2]. With pybullet's 1e-7 a resting arm
droops by 1e-6 rad."""


@dataclass(frozen=True)
class StepSettings:
    """Settings of the physics engine.

    Attributes:
        time_step: Length of a step [s].
        iterations: Solver iterations per step.
        contact_erp: Fraction of a penetration that is corrected per step.
    """

    time_step: float
    iterations: int
    contact_erp: float

    def apply(self, client: int) -> None:
        """Apply the settings to a physics client."""
        pb.setPhysicsEngineParameter(
            fixedTimeStep=self.time_step,
            numSolverIterations=self.iterations,
            contactERP=self.contact_erp,
            numSubSteps=0,
            solverResidualThreshold=RESIDUAL,
            physicsClientId=client,
        )


IMPACT = StepSettings(time_step=1 / 4000, iterations=100, contact_erp=0.0)


TABLE_THICKNESS = 0.04  # [m]
OBSTACLE_COLOR = (0.85, 0.65, 0.20)
"""Colour of a station's obstacles, RGB."""


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
    """The static bodies.

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
        work, scene = config.work, config.scene
        middle = np.array([*scene.table_center, scene.table_height - TABLE_THICKNESS / 2])
        table = fixed_box(client, (*scene.table_size, TABLE_THICKNESS), middle, (0.6, 0.58, 0.55))
        X, size = work.stand_box(scene.table_height)
        stand = fixed_box(client, size, X[:3, 3], (0.35, 0.36, 0.4), Rotation.from_matrix(X[:3, :3]))
        X = work.X_base_block
        block = fixed_box(client, work.block_size, X[:3, 3], (0.76, 0.6, 0.4), Rotation.from_matrix(X[:3, :3]))
        obstacles = [
            fixed_box(client, o.size, np.array(o.center), OBSTACLE_COLOR, Rotation.from_rotvec(o.rotation))
            for o in scene.obstacles
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
        self._X_tool_ee = (
            tool.ee(Category.HAMMER_HEAD).X_tool_ee if Category.HAMMER_HEAD in tool.categories else np.eye(4)
        )
        self._p_inertial_ee = (self._X_inertial_tool @ self._X_tool_ee)[:3, 3].tolist()
        self._place: tuple[object, object] | None = None
        self._pose = self._ee_pose = np.eye(4)
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
        self._update()
        return self._pose.copy()

    def ee_pose(self) -> Array:
        """X_world_ee, 4x4: the pose of a hammer's face; that of the tool if it is none."""
        self._update()
        return self._ee_pose.copy()

    def face(self) -> tuple[float, float, float]:
        """Position of the end effector in the world [m], asked for in every step."""
        (x, y, z), q = pb.getBasePositionAndOrientation(self.body, physicsClientId=self._client)
        ax, ay, az = self._arm(q)
        return x + ax, y + ay, z + az

    def face_velocity(self) -> tuple[float, float, float]:
        """Velocity of the end effector [m/s]."""
        (vx, vy, vz), (wx, wy, wz) = pb.getBaseVelocity(self.body, physicsClientId=self._client)
        ax, ay, az = self._arm(pb.getBasePositionAndOrientation(self.body, physicsClientId=self._client)[1])
        return vx + wy * az - wz * ay, vy + wz * ax - wx * az, vz + wx * ay - wy * ax

    def _arm(self, quaternion: tuple[float, ...]) -> tuple[float, float, float]:
        """From the centre of mass to the end effector, axes of the world [m]."""
        return turned(pb.getMatrixFromQuaternion(quaternion), self._p_inertial_ee)

    def _update(self) -> None:
        """Compute the poses anew if the body has moved: they are asked for several times per step."""
        place = pb.getBasePositionAndOrientation(self.body, physicsClientId=self._client)
        if place != self._place:
            self._place = place
            self._pose = pose_matrix(*place).dot(self._X_inertial_tool)
            self._ee_pose = self._pose.dot(self._X_tool_ee)

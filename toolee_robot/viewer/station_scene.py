"""What stands in a station, logged to Rerun: arm and hand, work, table, camera and its view."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.control import RobotModel
from toolee_robot.frames import Array, transform
from toolee_robot.sim_backend.physics.bodies import OBSTACLE_COLOR
from toolee_robot.sim_backend.visuals import BodyId, SceneState, SceneVisuals, VisualBody
from toolee_robot.station import StationConfig
from toolee_robot.tools import ToolKind, make_tool
from toolee_robot.types import CameraIntrinsics

CAMERA_BOX, TABLE = (220, 120, 40), (200, 200, 195)
"""Colours of the camera's box and of the table."""
AXES_COLORS = ((229, 56, 59), (42, 157, 63), (29, 111, 216))
"""Colours of the axes x, y and z."""
BACKGROUND = (235, 237, 240)
IMAGE_DISTANCE = 0.2
"""Distance from the camera at which its image hangs [m]."""
MOVING = frozenset({BodyId.ARM, BodyId.HAND, BodyId.NAIL})
"""What moves in a job."""
TIMELINE = "station clock"
"""Name of the timeline: seconds on the station's clock."""


def bodies(config: StationConfig) -> list[VisualBody]:
    """What stands in a station: arm and hand at home, the work, and where the person stands.

    Args:
        config: What the station file says.

    Returns:
        The bodies.
    """
    description = RobotModel.of_station(config).description
    state = SceneState(
        links=description.link_poses(np.array(config.scene.home), description.hand_open),
        X_base_tool=np.eye(4),
        Xs_base_nail={name: work.X_base_nail() for name, work in config.work.each()},
        person_center=np.array(config.scene.person_center),
        person_arm=None,
    )
    visuals = SceneVisuals(config, make_tool(ToolKind.CLAW_HAMMER, 0), 0, lambda: state)
    return [body for body in visuals.visual_bodies() if body.body_id is not BodyId.TOOL]


def log_station(stream: Any, config: StationConfig, shown: Iterable[VisualBody]) -> None:
    """Log what stands still in a station, and the shapes of what moves.

    Args:
        stream: The `rerun.RecordingStream`.
        config: What the station file says.
        shown: The bodies to show.
    """
    import rerun as rr

    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for body in shown:
        mesh = body.mesh
        r, g, b = rgb(body.color)
        path = body_path(body.name)
        alpha = 80 if body.body_id is BodyId.PERSON else 255
        corners = mesh.vertices[mesh.faces].reshape(-1, 3)  # apart, so that edges stay sharp
        sides = np.cross(corners[1::3] - corners[::3], corners[2::3] - corners[::3])
        normals = sides / np.maximum(np.linalg.norm(sides, axis=1, keepdims=True), 1e-12)
        stream.log(
            path,
            rr.Mesh3D(
                vertex_positions=corners, vertex_normals=np.repeat(normals, 3, axis=0), albedo_factor=(r, g, b, alpha)
            ),
            static=True,
        )
        stream.log(path, pose(body.X_base_body), static=body.body_id not in MOVING)
    scene, camera = config.scene, config.camera
    x, y = scene.table_size
    stream.log(
        "world/table",
        rr.Boxes3D(
            half_sizes=[(x / 2, y / 2, 0.005)], centers=[(*scene.table_center, scene.table_height - 0.006)],
            colors=[TABLE], fill_mode="solid",
        ),
        static=True,
    )  # fmt: skip
    stream.log("world/camera", pose(camera.X_base_camera), static=True)
    half = np.array([scene.camera_size]) / 2
    stream.log(
        "world/camera_box",
        rr.Boxes3D(half_sizes=half, colors=[CAMERA_BOX], fill_mode="solid"),
        pose(transform(p=camera.X_base_camera[:3, 3])),
        static=True,
    )
    log_lens(stream, camera.intrinsics)


def log_lens(stream: Any, k: CameraIntrinsics) -> None:
    """Log the camera's intrinsics, by which its image hangs in the scene."""
    import rerun as rr

    stream.log(
        "world/camera/image",
        rr.Pinhole(
            image_from_camera=k.matrix, width=k.width, height=k.height, image_plane_distance=IMAGE_DISTANCE,
            color=CAMERA_BOX,
        ),
        static=True,
    )  # fmt: skip


def body_path(name: str) -> str:
    """Where a body is logged."""
    return "world/bodies/" + "".join(c if c.isalnum() else "_" for c in name)


def pose(X: Array) -> Any:
    """A pose, (4, 4), as Rerun takes it."""
    import rerun as rr

    return rr.Transform3D(translation=X[:3, 3], quaternion=Rotation.from_matrix(X[:3, :3]).as_quat())


def send_poses(stream: Any, Xs: Mapping[str, Array], stamps: Array) -> None:
    """Log where things are by time.

    Args:
        stream: The `rerun.RecordingStream`.
        Xs: Poses of each thing by its path, (T, 4, 4).
        stamps: Their times, (T,) [s].
    """
    import rerun as rr

    at = [rr.TimeColumn(TIMELINE, duration=stamps)]
    for path, X in Xs.items():
        q = Rotation.from_matrix(X[:, :3, :3]).as_quat()
        rr.send_columns(path, at, rr.Transform3D.columns(translation=X[:, :3, 3], quaternion=q), recording=stream)


def rgb(color: tuple[float, float, float]) -> tuple[int, int, int]:
    """Colour of 0 to 1 as bytes."""
    r, g, b = (round(255 * channel) for channel in color)
    return r, g, b


def axes(Xs: Array, length: float) -> Any:
    """The axes of poses, (K, 4, 4), each of a length [m]."""
    import rerun as rr

    origins = np.repeat(Xs[:, :3, 3], 3, axis=0)
    ends = length * np.swapaxes(Xs[:, :3, :3], 1, 2).reshape(-1, 3)
    colors = np.tile(np.array(AXES_COLORS, np.uint8), (len(Xs), 1))
    return rr.Arrows3D(origins=origins, vectors=ends, colors=colors, radii=length / 30)


OBSTACLE = rgb(OBSTACLE_COLOR[:3])
"""Colour of the boxes that are kept clear of."""

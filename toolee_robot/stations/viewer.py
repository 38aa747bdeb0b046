"""A station file in three dimensions, in the browser: bodies, and frames with their names."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.config import StationConfig
from toolee_robot.control import RobotModel
from toolee_robot.errors import UserError
from toolee_robot.frames import Array, frame_from_axes, transform
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.sim_backend.visuals.scene import BodyId, SceneVisuals, scene_state
from toolee_robot.sim_backend.visuals.visual_body import VisualBody

WORKSPACE, CAMERA_BOX, TABLE = (60, 120, 200), (220, 120, 40), (200, 200, 195)
"""Colours of the workspace's edges, of the camera's box and of the table."""
AXES = 0.12
"""Length of a frame's axes [m]."""


def named_frames(config: StationConfig) -> dict[str, Array]:
    """The frames that a station file determines.

    Args:
        config: What the file says.

    Returns:
        Poses in `base` by name, (4, 4).
    """
    scene, robot = config.scene, RobotModel.of_station(config)
    palm = frame_from_axes(z=np.array([0.0, 0.0, 1.0]), x=np.asarray(scene.handover_facing), p=scene.handover_position)
    return {
        "base_link": np.eye(4),
        "pendant_base": transform(np.diag([-1.0, -1.0, 1.0])),
        "flange at home": robot.arm.fk(np.array(scene.home)),
        "camera": config.camera.X_base_camera,
        "nail": config.work.X_base_nail(),
        "handover, x faces the person": palm,
    }


def bodies(config: StationConfig) -> list[VisualBody]:
    """What stands in a station: arm and hand at home, the work, and where the person stands.

    Args:
        config: What the station file says.

    Returns:
        The bodies, with a hammer of the simulation beside the person.
    """
    with SimStation.build(config) as simulation:
        state = scene_state(simulation.world, simulation.person)
        visuals = SceneVisuals(config, simulation.tool, 0, lambda: state)
        return list(visuals.visual_bodies())


def open_viewer(config: StationConfig, port: int) -> Any:
    """Serve the picture on a loopback address; it is shown until the server is stopped.

    Args:
        config: What the station file says.
        port: Port of the page; the next free one is taken where it is in use.

    Returns:
        The `viser.ViserServer`.

    Raises:
        UserError: viser is not installed.
    """
    try:
        import viser
    except ImportError as error:
        raise UserError(
            f"the picture needs viser ({error}): run `python -m pip install -e '.[viewer]'`",
            code="user.missing_package",
        ) from error
    with contextlib.redirect_stdout(io.StringIO()):  # a banner of its own
        server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
    scene, cell = server.scene, config.scene
    scene.set_up_direction("+z")
    for body in bodies(config):
        position, wxyz = _pose(body.X_base_body)
        scene.add_mesh_simple(
            f"/bodies/{body.name}",
            body.mesh.vertices,
            body.mesh.faces,
            color=_rgb(body.color),
            opacity=0.3 if body.body_id == BodyId.PERSON else None,
            flat_shading=True,
            position=position,
            wxyz=wxyz,
        )
    x, y = cell.table_size
    scene.add_box("/bodies/table", color=TABLE, dimensions=(x, y, 0.01), position=(0.0, 0.0, -0.006))
    position, wxyz = _pose(config.camera.X_base_camera)
    scene.add_box("/bodies/camera", color=CAMERA_BOX, dimensions=cell.camera_size, position=position)
    k = config.camera.intrinsics
    scene.add_camera_frustum(
        "/camera's view",
        fov=float(2.0 * np.arctan2(k.height / 2.0, k.fy)),
        aspect=k.width / k.height,
        scale=0.12,
        color=CAMERA_BOX,
        position=position,
        wxyz=wxyz,
    )
    lower, upper = np.array(cell.workspace_lower), np.array(cell.workspace_upper)
    scene.add_box(
        "/workspace",
        color=WORKSPACE,
        dimensions=tuple(upper - lower),
        position=tuple((lower + upper) / 2.0),
        wireframe=True,
    )
    for name, X in named_frames(config).items():
        position, wxyz = _pose(X)
        scene.add_frame(f"/frames/{name}", position=position, wxyz=wxyz, axes_length=AXES, axes_radius=AXES / 30.0)
        scene.add_label(f"/frames/{name}/name", name, position=(AXES, 0.0, 0.0))  # of base_link and pendant_base apart
    server.initial_camera.position = (2.1, 1.3, 1.5)
    server.initial_camera.look_at = (0.4, -0.2, 0.4)
    return server


def _pose(X: Array) -> tuple[Array, Array]:
    """Position and quaternion, w first."""
    return X[:3, 3], np.asarray(Rotation.from_matrix(X[:3, :3]).as_quat(scalar_first=True))


def _rgb(color: tuple[float, float, float]) -> tuple[int, int, int]:
    r, g, b = (round(255 * channel) for channel in color)
    return r, g, b

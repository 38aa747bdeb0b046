"""A station file in three dimensions, in the browser: bodies, and frames with their names."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.sim_backend.physics.bodies import OBSTACLE_COLOR
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.sim_backend.visuals.scene import BodyId, SceneVisuals, scene_state
from toolee_robot.sim_backend.visuals.visual_body import VisualBody
from toolee_robot.station import StationConfig

CAMERA_BOX, TABLE = (220, 120, 40), (200, 200, 195)
"""Colours of the camera's box and of the table."""
AXES = 0.12
"""Length of a frame's axes [m]."""


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


class StationPicture:
    """The picture on a page of a loopback address, until it is closed.

    Args:
        config: What the station file says.
        port: Port of the page; the next free one is taken where it is in use.
        hidden: Bodies that are not drawn.

    Attributes:
        server: The `viser.ViserServer`.

    Raises:
        UserError: viser is not installed.
    """

    def __init__(self, config: StationConfig, port: int, hidden: Collection[BodyId] = ()) -> None:
        try:
            import viser
        except ImportError as error:
            raise UserError(
                f"the picture needs viser ({error}): run `python -m pip install -e '.[viewer]'`",
                code="user.missing_package",
            ) from error
        with contextlib.redirect_stdout(io.StringIO()):  # a banner of its own
            self.server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
        self._meshes: dict[str, Any] = {}
        self.server.scene.set_up_direction("+z")
        self._draw_bodies(config, hidden)
        self._draw_camera(config)
        self.server.initial_camera.position = (2.1, 1.3, 1.5)
        self.server.initial_camera.look_at = (0.4, -0.2, 0.4)

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://127.0.0.1:{self.server.get_port()}"

    def close(self) -> None:
        """Stop serving."""
        self.server.stop()

    def frame(self, name: str, X: Array, label: str, above: float = 0.0) -> None:
        """Draw a frame.

        Args:
            name: Its name.
            X: Its pose in `base`, (4, 4).
            label: What is written beside it.
            above: Height of the label over the frame's x axis [m].
        """
        position, wxyz = position_wxyz(X)
        scene, path = self.server.scene, f"/frames/{name}"
        scene.add_frame(path, position=position, wxyz=wxyz, axes_length=AXES, axes_radius=AXES / 30.0)
        scene.add_label(f"{path}/name", label, position=(AXES, 0.0, above))  # base_link's and pendant_base's apart

    def move(self, name: str, X: Array) -> None:
        """Move a body; one that is not drawn is left out.

        Args:
            name: Its name, such as that of a link.
            X: Its pose in `base`, (4, 4).
        """
        if name in self._meshes:
            self._meshes[name].position, self._meshes[name].wxyz = position_wxyz(X)

    def place(self, name: str) -> Array:
        """Where a body is drawn, (3,) in `base` [m]."""
        return np.array(self._meshes[name].position)

    def show_image(self, rgb: NDArray[np.uint8] | None) -> None:
        """Show an image, (H, W, 3), in the camera's frustum; None: no image."""
        self._frustum.image = rgb

    def _draw_bodies(self, config: StationConfig, hidden: Collection[BodyId]) -> None:
        for body in bodies(config):
            if body.body_id in hidden:
                continue
            position, wxyz = position_wxyz(body.X_base_body)
            self._meshes[body.name] = self.server.scene.add_mesh_simple(
                f"/bodies/{body.name}",
                body.mesh.vertices,
                body.mesh.faces,
                color=rgb(body.color),
                opacity=0.3 if body.body_id == BodyId.PERSON else None,
                flat_shading=True,
                position=position,
                wxyz=wxyz,
            )
        x, y = config.scene.table_size
        dimensions, middle = (x, y, 0.01), (*config.scene.table_center, config.scene.table_height - 0.006)
        self._meshes["table"] = self.server.scene.add_box(
            "/bodies/table", color=TABLE, dimensions=dimensions, position=middle
        )

    def _draw_camera(self, config: StationConfig) -> None:
        position, wxyz = position_wxyz(config.camera.X_base_camera)
        size, k = config.scene.camera_size, config.camera.intrinsics
        self.server.scene.add_box("/bodies/camera", color=CAMERA_BOX, dimensions=size, position=position)
        self._frustum = self.server.scene.add_camera_frustum(
            "/camera's view",
            fov=float(2.0 * np.arctan2(k.height / 2.0, k.fy)),
            aspect=k.width / k.height,
            scale=0.12,
            color=CAMERA_BOX,
            thickness=0.004,
            position=position,
            wxyz=wxyz,
        )


def position_wxyz(X: Array) -> tuple[Array, Array]:
    """Position (3,) and quaternion (4,), w first, of a pose (4, 4)."""
    return X[:3, 3], np.asarray(Rotation.from_matrix(X[:3, :3]).as_quat(scalar_first=True))


def rgb(color: tuple[float, float, float]) -> tuple[int, int, int]:
    """Colour of 0 to 1 as bytes."""
    r, g, b = (round(255 * channel) for channel in color)
    return r, g, b


OBSTACLE = rgb(OBSTACLE_COLOR[:3])
"""Colour of the boxes that are kept clear of."""

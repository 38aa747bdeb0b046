"""The page of a station file: its picture with named frames, and a panel of places, colours and what is missing."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np

from toolee_robot.control import RobotModel
from toolee_robot.frames import HALF_TURN, Array, BaseFrame, frame_from_axes, inverse, transform, transform_points
from toolee_robot.sim_backend.visuals.scene import PINE_COLOR, STAND_COLOR
from toolee_robot.station import StationConfig, given_by_nails, given_by_pose, read_station
from toolee_robot.station.station import to_station
from toolee_robot.stations.open_fields import open_fields
from toolee_robot.viewer.station_scene import CAMERA_BOX, OBSTACLE, StationPicture, rgb

WORKSPACE, VIEW = (60, 120, 200), (250, 190, 90)
"""Colours of the workspace's edges and of the camera's view."""
CELL, NAIL_LABELS = 0.5, 0.08
"""Edge of a square of the table's grid, and height of a nail's label over the one before it [m]."""
EYE, LOOK_AT = (2.5, 1.7, 1.7), (0.15, 0.1, 0.4)
"""The first view, in which the panel hides little of the station [m]."""
_SHOWN = {
    "camera": ("camera.position", "camera.target"),
    "nail": ("work.nail_xy", "work.stand_height", "work.block_size"),
    "handover": ("scene.handover_position", "scene.handover_facing"),
    "flange at home": ("arm.model", "scene.home"),
    "person": ("scene.person_center", "scene.person_size"),
    "workspace": ("scene.workspace_lower", "scene.workspace_upper"),
}
"""What is drawn, and the fields of which it is drawn."""


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
        "pendant_base": HALF_TURN.copy(),
        "flange at home": robot.arm.fk(np.array(scene.home)),
        "camera": config.camera.X_base_camera,
        **{name if len(work.names) == 1 else f"nail {name}": work.X_base_nail() for name, work in config.work.each()},
        "handover": palm,
    }


class StationPage:
    """The page of a station file on a loopback address, until it is closed.

    Args:
        path: The file.
        port: Port of the page; the next free one is taken where it is in use.

    Attributes:
        picture: The picture.

    Raises:
        ConfigError: The file is invalid.
        UserError: viser is not installed.
    """

    def __init__(self, path: Path, port: int) -> None:
        self._path, self._data = path, read_station(path)
        self._config = config = to_station(self._data, path)
        self._frames = named_frames(config)
        self.picture = StationPicture(config, port)
        server = self.picture.server
        scene = server.scene
        nails = 0
        for name, X in self._frames.items():
            self.picture.frame(name, X, self._named(name), above=nails * NAIL_LABELS)
            nails += name.startswith("nail")
        x, y = config.scene.table_size
        middle = (*config.scene.table_center, config.scene.table_height + 0.001)
        scene.add_grid("/table's grid", x, y, cell_size=CELL, section_size=CELL, position=middle)
        self._label("workspace", self._draw_workspace()[5])  # the corner that the panel does not hide
        self._label("person", np.add(config.scene.person_center, (0.0, 0.0, config.scene.person_size[2] / 2.0 + 0.25)))
        for obstacle in config.scene.obstacles:
            top = np.add(obstacle.center, (0.0, 0.0, obstacle.size[2] / 2.0))
            scene.add_label(f"/names/{obstacle.name}", obstacle.name, position=top, anchor="bottom-center")
        self._draw_view()
        server.initial_camera.position, server.initial_camera.look_at = EYE, LOOK_AT
        gui = server.gui
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        gui.set_panel_label(path.name)
        for text in self.texts():
            gui.add_markdown(text)

    @property
    def address(self) -> str:
        """Address of the page."""
        return self.picture.address

    def close(self) -> None:
        """Stop serving."""
        self.picture.close()

    def texts(self) -> list[str]:
        """The panel's parts, in Markdown: places, colours, the camera's calibration, and what is missing."""
        return [self._places(), _colours(self._config), f"**Camera**: {self._calibration()}", self._missing()]

    def _places(self) -> str:
        frame = BaseFrame((self._data or {}).get("frame", BaseFrame.BASE_LINK))
        X = inverse(frame.X_base_this)
        lines = [f"**Places in `{frame}`, in metres**", "", "| | x | y | z |", "|---|---|---|---|"]
        places = {**self._frames, "person": transform(np.eye(3), np.asarray(self._config.scene.person_center))}
        for name, place in places.items():
            if name not in list(BaseFrame):
                x, y, z = (X @ place[:, 3])[:3]
                lines.append(f"| {self._named(name)} | {x:.3f} | {y:.3f} | {z:.3f} |")
        return "\n".join(lines)

    def _calibration(self) -> str:
        calibration = self._config.calibration
        if not (self._data or {}).get("calibration") or calibration is None:
            return "not calibrated: it is drawn where `camera` says"
        by = "of another program" if calibration.record is None else f"record `{calibration.record}`"
        return f"calibrated on {calibration.measured_on}, {by}, residual {calibration.residual * 1e3:.1f} mm"

    def _missing(self) -> str:
        fields = open_fields(self._data or {}, self._path)
        if not fields:
            return "**Missing**: nothing"
        lines = ["**Missing**; what is drawn of it is the simulated station's:", ""]
        if all(entry.note for entry in fields):
            lines = ["**Missing**: nothing that a job needs. Not there, either:", ""]
        lines += [f"- {entry.fields}" + (f" ({entry.note})" if entry.note else "") for entry in fields]
        return "\n".join([*lines, "", f"`toolee station check {self._path}` says how each is measured."])

    def _named(self, name: str) -> str:
        """Name of what is drawn, and whether the simulated station's values stand in for what the file leaves out."""
        data = self._data or {}
        unneeded = given_by_nails((data.get("work") or {}).get("nails"))
        unneeded |= given_by_pose((data.get("camera") or {}).get("X_base_camera"))
        fields = _SHOWN.get("nail" if name.startswith("nail") else name, ())
        given = [
            field for field in fields
            if field in unneeded or (data.get(field.split(".")[0]) or {}).get(field.split(".")[1]) is not None
        ]  # fmt: skip
        if len(given) == len(fields):
            return name
        return f"{name} (not all given)" if given else f"{name} (not given)"

    def _label(self, name: str, position: Any) -> None:
        scene = self.picture.server.scene
        scene.add_label(f"/names/{name}", self._named(name), position=position, anchor="bottom-center")

    def _draw_workspace(self) -> Array:
        """Draw its edges; returns its corners, (8, 3)."""
        scene = self._config.scene
        corners = np.array(list(itertools.product(*zip(scene.workspace_lower, scene.workspace_upper, strict=True))))
        edges = np.array([(a, b) for a, b in itertools.combinations(corners, 2) if np.sum(a != b) == 1])
        self._lines("/workspace", edges, WORKSPACE)
        return corners

    def _draw_view(self) -> None:
        """Draw what the camera sees, as far as the point at which it looks; by a whole pose, as the first nail."""
        camera = self._config.camera
        X, k = camera.X_base_camera, camera.intrinsics
        depth = float(np.linalg.norm(np.subtract(camera.target, camera.position)))
        if camera.measured_pose is not None:
            depth = float(np.linalg.norm(self._config.work.X_base_nail()[:3, 3] - X[:3, 3]))
        pixels = np.array([(0, 0), (k.width, 0), (k.width, k.height), (0, k.height)])
        ends = list(transform_points(X, depth * k.rays(pixels)))
        rays = [(X[:3, 3], end) for end in ends]
        self._lines("/camera's view/edges", np.array([*rays, *zip(ends, [*ends[1:], ends[0]], strict=True)]), VIEW)
        faces = np.array([(0, i, i % 4 + 1) for i in range(1, 5)])
        self.picture.server.scene.add_mesh_simple(
            "/camera's view/cone", np.array([X[:3, 3], *ends]), faces, color=VIEW, opacity=0.15, side="double",
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _lines(self, name: str, points: Array, color: tuple[int, int, int]) -> None:
        scene = self.picture.server.scene
        scene.add_line_segments(name, points, color, thickness=2.0, thickness_units="screen")


def _colours(config: StationConfig) -> str:
    """What has which colour."""
    named = [
        (WORKSPACE, "workspace, which the arm does not leave"),
        (CAMERA_BOX, "camera, with the box that is kept clear around it"),
        (
            VIEW,
            f"what it sees, as far as {'`camera.target`' if config.camera.measured_pose is None else 'the nail is'}",
        ),
        (rgb(PINE_COLOR), "wood"),
        (rgb(STAND_COLOR), "stand, and hand or mount on the flange"),
    ]
    if config.scene.obstacles:
        named.append((OBSTACLE, "obstacles, which are kept clear of"))
    lines = [f"- `#{r:02x}{g:02x}{b:02x}` {what}" for (r, g, b), what in named]
    squares = f"Axes: `#ff0000` x, `#00cc00` y, `#0000ff` z. The table's squares are {CELL:g} m wide."
    person = "See-through: the person, with a hammer of the simulation held out."
    return "\n".join(["**Colours**", "", *lines, "", f"{squares} {person}"])

"""A station, logged to Rerun: arm and hand, work, table, camera and its view; and the page of a station file."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.control import RobotModel
from toolee_robot.frames import HALF_TURN, Array, BaseFrame, frame_from_axes, inverse, transform, transform_points
from toolee_robot.sim_backend.visuals import BodyId, SceneState, SceneVisuals, VisualBody
from toolee_robot.station import StationConfig, given_by_nails, given_by_pose, read_station
from toolee_robot.station.station import to_station
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


WORKSPACE, VIEW, LABEL = (60, 120, 200), (250, 190, 90), (20, 24, 30)
"""Colours of the workspace's edges, of the camera's view and of names."""
CELL, FRAME_AXES = 0.5, 0.12
"""Edge of a square of the table's grid, and length of a frame's axes [m]."""
EYE, LOOK_AT = (2.5, 1.7, 1.7), (0.15, 0.1, 0.4)
"""The first view [m]."""
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


class StationView:
    """What a station file says, logged to Rerun.

    Args:
        path: The file.

    Raises:
        ConfigError: The file is invalid.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._data = path, read_station(path)
        self._config = to_station(self._data, path)
        self._frames = named_frames(self._config)

    def blueprint(self) -> Any:
        """Layout of the page, a `rerun.blueprint.Blueprint`: the scene, and the text beside it."""
        import rerun as rr
        import rerun.blueprint as rrb

        plane = rr.components.Plane3D((0.0, 0.0, 1.0), self._config.scene.table_height + 0.001)
        grid = rrb.LineGrid3D(visible=True, spacing=CELL, plane=plane)
        eye = rrb.EyeControls3D(position=EYE, look_target=LOOK_AT, eye_up=(0, 0, 1))
        scene = rrb.Spatial3DView(
            origin="world", name="Station", eye_controls=eye, line_grid=grid, background=BACKGROUND
        )
        text = rrb.TextDocumentView(origin="text", name="What the file says")
        return rrb.Blueprint(
            rrb.Horizontal(scene, text, column_shares=[2, 1]),
            rrb.TimePanel(state="hidden"),
            rrb.BlueprintPanel(state="hidden"),
            rrb.SelectionPanel(state="hidden"),
            auto_views=False,
        )

    def log(self, stream: Any) -> None:
        """Log the station to a `rerun.RecordingStream`."""
        import rerun as rr

        config, scene = self._config, self._config.scene
        log_station(stream, config, bodies(config))
        Xs = np.array(list(self._frames.values()))
        stream.log("world/frames", axes(Xs, FRAME_AXES), static=True)
        labels = {self._named(name): X[:3, 3] + 0.5 * FRAME_AXES * X[:3, 0] for name, X in self._frames.items()}
        corners = np.array(list(itertools.product(*zip(scene.workspace_lower, scene.workspace_upper, strict=True))))
        labels[self._named("workspace")] = corners[5]  # a corner that nothing hides
        labels[self._named("person")] = np.add(scene.person_center, (0.0, 0.0, scene.person_size[2] / 2.0 + 0.25))
        for obstacle in scene.obstacles:
            labels[obstacle.name] = np.add(obstacle.center, (0.0, 0.0, obstacle.size[2] / 2.0))
        points = rr.Points3D(list(labels.values()), labels=list(labels), colors=[LABEL], radii=0.004, show_labels=True)
        stream.log("world/names", points, static=True)
        edges = [(a, b) for a, b in itertools.combinations(corners, 2) if np.sum(a != b) == 1]
        stream.log("world/workspace", rr.LineStrips3D(edges, colors=[WORKSPACE], radii=0.003), static=True)
        stream.log("world/view", rr.LineStrips3D(self._view(), colors=[VIEW], radii=0.003), static=True)
        text = rr.TextDocument("\n\n".join(self.texts()), media_type="text/markdown")
        stream.log("text", text, static=True)

    def texts(self) -> list[str]:
        """The panel's parts, in Markdown: places, colours, and which command says what is missing."""
        missing = f"`toolee station check {self._path}` says what is missing, and how each is measured."
        return [self._places(), _colours(self._config), missing]

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

    def _view(self) -> list[Any]:
        """Edges of what the camera sees, as far as the point at which it looks; by a whole pose, as the first nail."""
        camera = self._config.camera
        X, k = camera.X_base_camera, camera.intrinsics
        aimed = self._config.work.X_base_nail()[:3, 3] if camera.target is None else np.array(camera.target)
        depth = float(np.linalg.norm(aimed - X[:3, 3]))
        pixels = np.array([(0, 0), (k.width, 0), (k.width, k.height), (0, k.height)])
        ends = list(transform_points(X, depth * k.rays(pixels)))
        return [*((X[:3, 3], end) for end in ends), [*ends, ends[0]]]


def _colours(config: StationConfig) -> str:
    """What has which colour."""
    far = "`camera.target`" if config.camera.measured_pose is None else "the nail"
    lines = [
        "- blue lines: the workspace, which the arm does not leave",
        "- orange: the camera, with the box around it that the arm avoids",
        f"- yellow lines: what it sees, as far as {far}",
        "- dark grey: the stand, and the hand or mount on the flange",
        "- see-through: the person",
    ]
    if config.scene.obstacles:
        lines.append("- ochre: obstacles, which the arm avoids")
    return "\n".join(["**Colours**", "", *lines, "", f"Axes: red x, green y, blue z. The grid is {CELL:g} m wide."])

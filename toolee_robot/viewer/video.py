"""A video of a run: rendered without a screen or a browser."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from toolee_robot.errors import UserError
from toolee_robot.frames import Array, frame_from_axes
from toolee_robot.recording.history import RunHistory
from toolee_robot.recording.series import Series
from toolee_robot.recording.tool_file import read_tool_model
from toolee_robot.render.material import Material
from toolee_robot.render.mesh import Mesh, box
from toolee_robot.render.palette import finish, linear
from toolee_robot.render.renderer import render
from toolee_robot.render.scene import Body, Environment, Light, Scene
from toolee_robot.sim_backend.visuals.scene import BodyId
from toolee_robot.station import StationConfig
from toolee_robot.types import CameraIntrinsics
from toolee_robot.viewer.run_state import RunState, RunStates
from toolee_robot.viewer.station_scene import bodies

Picture = NDArray[np.uint8]
RATE = 25.0
"""Pictures a second."""
WIDTH, HEIGHT = 960, 544  # multiples of 16, as H.264 has them
_VIEW = CameraIntrinsics(800.0, 800.0, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5, WIDTH, HEIGHT)
_EYE, _TARGET = np.array([1.55, 0.85, 0.95]), np.array([0.40, -0.20, 0.30])
_INSET, _CURVE = 240, 90
"""Width of the camera's image, and height of the curve [px]."""
_LIGHTS = (Light((2.2, 2.15, 2.0), direction=(0.45, 0.35, 0.82), softness=0.1),)
_GREY, _WHITE, _RED, _YELLOW = (70, 70, 70), (255, 255, 255), (235, 80, 60), (250, 210, 60)


def write_video(path: Path, history: RunHistory, config: StationConfig, speed: float) -> int:
    """Write the video of a run, as H.264.

    Args:
        path: The file, which ends in .mp4.
        history: The recording of the run.
        config: Its station.
        speed: How much faster than the run it plays.

    Returns:
        Number of pictures.

    Raises:
        UserError: imageio-ffmpeg is not installed, or the file cannot be written.
    """
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise UserError(
            f"a video needs imageio-ffmpeg ({error}): run `python -m pip install -e '.[viewer]'`",
            code="user.missing_package",
        ) from error
    if path.suffix != ".mp4" or not path.parent.is_dir():
        raise UserError(f"cannot write the video {path}: name an .mp4 in a folder that exists", code="user.video")
    painter = _Painter(history, config)
    stamps = np.arange(history.start, history.end + speed / RATE, speed / RATE)
    writer: Any = imageio_ffmpeg.write_frames(
        str(path), (WIDTH, HEIGHT), fps=RATE, codec="libx264", output_params=["-crf", "24", "-preset", "veryfast"],
        ffmpeg_log_level="error",
    )  # fmt: skip
    writer.send(None)
    try:
        for stamp in stamps:
            writer.send(painter.picture(min(float(stamp), history.end)).tobytes())
    finally:
        writer.close()
    return len(stamps)


class _Painter:
    """Renders a run at a time; what has not moved since the last picture is not rendered again."""

    def __init__(self, history: RunHistory, config: StationConfig) -> None:
        self._history = history
        self._states = RunStates(history, config)
        hidden = (BodyId.TOOL, BodyId.PERSON)
        self._bodies = [body for body in bodies(config) if body.body_id not in hidden]
        self._materials = {
            b.name: finish(b.finish, b.color, b.roughness, b.metallic,
                           np.random.default_rng(zlib.crc32(b.name.encode())), axis=b.grain_axis)
            for b in self._bodies
        }  # fmt: skip
        self._table = Body(box((2.2, 2.2, 0.02)), _shifted(-0.011), Material(linear((0.72, 0.72, 0.70))))
        self._tool = self._tool_parts()
        self._X_world_camera = frame_from_axes(z=_TARGET - _EYE, x=np.cross(_TARGET - _EYE, [0.0, 0.0, 1.0]), p=_EYE)
        self._curve = thinned(history.wrenches, WIDTH)
        self._key: Any = None
        self._rendered: Picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        self._insets: dict[int, Picture] = {}

    def picture(self, stamp: float) -> Picture:
        """The picture at a time [s], (HEIGHT, WIDTH, 3)."""
        state = self._states.at(stamp)
        moving = np.concatenate([X.ravel() for X in state.links.values()])
        key = (
            np.round(moving, 4).tobytes(),
            state.X_base_tool is None,
            tuple(np.round(list(state.sunk.values()), 5)),
            state.in_hand is None,
        )
        if key != self._key:
            self._key, self._rendered = key, self._render(state)
        picture = self._rendered.copy()
        self._draw_over(picture, state)
        return picture

    def _render(self, state: RunState) -> Picture:
        shown = [self._table]
        for body in self._bodies:
            X = state.links.get(body.name, body.X_base_body)
            if body.body_id is BodyId.NAIL:
                X = self._states.X_base_nail_part(body.name, X, state.sunk)
            shown.append(Body(body.mesh, X, self._materials[body.name], int(body.body_id)))
        if state.X_base_tool is not None:
            shown += [Body(mesh, state.X_base_tool, material, int(BodyId.TOOL)) for mesh, material in self._tool]
        return render(Scene(shown, _LIGHTS, Environment()), _VIEW, self._X_world_camera, auto_exposure=0.7).rgb.copy()

    def _tool_parts(self) -> list[tuple[Mesh, Material]]:
        """The tool's parts by colour."""
        data = self._history.attachments.get("tool.glb")
        if data is None:
            return []
        mesh = read_tool_model(data)
        assert isinstance(mesh.visual, trimesh.visual.ColorVisuals)
        colors = np.asarray(mesh.visual.vertex_colors)[np.asarray(mesh.faces)[:, 0], :3]
        parts = []
        for color in np.unique(colors, axis=0):
            part = mesh.submesh([np.flatnonzero(np.all(colors == color, axis=1))], append=True)
            assert isinstance(part, trimesh.Trimesh)
            r, g, b = (float(c) / 255.0 for c in color)
            parts.append((Mesh.build(part.vertices, part.faces), Material(linear((r, g, b)))))
        return parts

    def _draw_over(self, picture: Picture, state: RunState) -> None:
        h = self._history
        if state.frame >= 0:
            inset = self._inset(state.frame)
            y, x = 12, WIDTH - _INSET - 12
            picture[y : y + inset.shape[0], x : x + _INSET] = inset
            cv2.rectangle(picture, (x, y), (x + _INSET, y + inset.shape[0]), _GREY, 1)
        top = HEIGHT - _CURVE
        picture[top:] = picture[top:] // 3
        stamps, force = self._curve
        span = max(h.end - h.start, 1e-3)
        if len(stamps) > 1:
            across = (stamps - h.start) / span * (WIDTH - 1)
            up = HEIGHT - 4 - force / max(float(force.max()), 1.0) * (_CURVE - 30)
            line = np.stack([across, up], axis=1).round().astype(np.int32)
            cv2.polylines(picture, [line], False, _RED, 1, cv2.LINE_AA)
            _text(picture, f"force, up to {force.max():.0f} N", (8, top + 16), 0.42, _RED)
        now = round((state.stamp - h.start) / span * (WIDTH - 1))
        cv2.line(picture, (now, top), (now, HEIGHT), _WHITE, 1)
        i = h.decisions.index(state.stamp)
        stage = state.stage.replace("_", " ")
        _text(picture, f"{state.stamp:6.1f} s   {stage}   nail {state.protrusion * 1e3:.1f} mm", (12, 28), 0.65)
        told = [d for d in h.decisions.values[: i + 1] if d.name not in ("stage", "stage_ended", "motion")]
        for row, decision in enumerate(told[-2:]):
            words = f"{decision.stamp:.1f} s {decision.name.replace('_', ' ')}: {decision.reason}"
            _text(picture, words[:88], (12, 54 + 22 * row), 0.48, _YELLOW)

    def _inset(self, frame: int) -> Picture:
        if frame not in self._insets:
            rgb = self._history.rgb(frame)
            height = round(_INSET * rgb.shape[0] / rgb.shape[1])
            self._insets = {
                frame: np.asarray(cv2.resize(rgb, (_INSET, height), interpolation=cv2.INTER_AREA), np.uint8)
            }
        return self._insets[frame]


def _text(picture: Picture, words: str, at: tuple[int, int], size: float, color: tuple[int, int, int] = _WHITE) -> None:
    plain = words.encode("ascii", "replace").decode()  # OpenCV's fonts know no other letters
    cv2.putText(picture, plain, at, cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(picture, plain, at, cv2.FONT_HERSHEY_SIMPLEX, size, color, 1, cv2.LINE_AA)


def _shifted(z: float) -> Array:
    X = np.eye(4)
    X[2, 3] = z
    return X


def thinned(series: Series[Array], count: int) -> tuple[Array, Array]:
    """Reduce a series to about `count` values, of each interval the one of the greatest force, so that peaks stay.

    Args:
        series: Wrenches, (6,) each.
        count: Number of values wanted.

    Returns:
        Their stamps [s] and norms of the force [N].
    """
    n = len(series)
    if n == 0:
        return np.zeros(0), np.zeros(0)
    stamps = np.array(series.stamps[:n])
    forces = np.linalg.norm(np.array(series.values[:n])[:, :3], axis=1)
    if n <= count:
        return stamps, forces
    edges = np.linspace(0, n, count + 1).astype(int)[:-1]
    peaks = [int(a + np.argmax(forces[a:b])) for a, b in zip(edges, [*edges[1:], n], strict=True) if b > a]
    return stamps[peaks], forces[peaks]

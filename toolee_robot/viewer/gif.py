"""A short GIF of a run, rendered without a screen or a browser."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from toolee_robot.frames import frame_from_axes, transform
from toolee_robot.recording.history import RunHistory
from toolee_robot.recording.mcap_file import read_tool_model
from toolee_robot.render.material import Body, Environment, Light, Material, Scene, finish, linear
from toolee_robot.render.mesh import Mesh, box
from toolee_robot.render.renderer import render
from toolee_robot.runtime.files import written_whole
from toolee_robot.sim_backend.visuals import BodyId
from toolee_robot.station import StationConfig
from toolee_robot.types import CameraIntrinsics
from toolee_robot.viewer.run_view import RunState, RunStates
from toolee_robot.viewer.station_view import bodies

Picture = NDArray[np.uint8]
LENGTH_S, RATE = 10.0, 10.0
"""Length of the GIF [s], and pictures a second."""
WIDTH, HEIGHT = 640, 360
INSET = 170
"""Width of the camera's image in the corner [px]."""
_VIEW = CameraIntrinsics(530.0, 530.0, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5, WIDTH, HEIGHT)
_EYE, _TARGET = np.array([1.55, 0.85, 0.95]), np.array([0.40, -0.20, 0.30])
_LIGHTS = (Light((2.2, 2.15, 2.0), direction=(0.45, 0.35, 0.82), softness=0.1),)


def pictures(history: RunHistory, config: StationConfig) -> tuple[int, Iterator[Picture]]:
    """Draw a run, faster than it was, so that it takes LENGTH_S.

    Args:
        history: The recording of the run.
        config: Its station.

    Returns:
        Number of pictures, and the pictures, (HEIGHT, WIDTH, 3) each.
    """
    stamps = np.linspace(history.start, history.end, round(LENGTH_S * RATE))
    states = RunStates(history, config)
    return len(stamps), _drawn(history, config, [states.at(float(stamp)) for stamp in stamps], states)


def write_gif(path: Path, drawn: Iterable[Picture]) -> None:
    """Write pictures as a GIF, beside it first.

    Args:
        path: The file.
        drawn: The pictures.

    Raises:
        UserError: The file cannot be written.
    """
    with written_whole(path) as beside:
        beside.touch()  # before the drawing, which takes a while
        first, *others = [Image.fromarray(picture).quantize(128) for picture in drawn]
        first.save(beside, "GIF", save_all=True, append_images=others, duration=round(1e3 / RATE), loop=0)


def _drawn(
    history: RunHistory, config: StationConfig, timeline: list[RunState], states: RunStates
) -> Iterator[Picture]:
    shown = [body for body in bodies(config) if body.body_id is not BodyId.PERSON]
    materials = {
        b.name: finish(b.finish, b.color, b.roughness, b.metallic,
                       np.random.default_rng(zlib.crc32(b.name.encode())), axis=b.grain_axis)
        for b in shown
    }  # fmt: skip
    table = Body(box((2.2, 2.2, 0.02)), transform(p=[0.0, 0.0, -0.011]), Material(linear((0.72, 0.72, 0.70))))
    tool = _tool_parts(history)
    X_world_camera = frame_from_axes(z=_TARGET - _EYE, x=np.cross(_TARGET - _EYE, [0.0, 0.0, 1.0]), p=_EYE)
    for state in timeline:
        scene = [table]
        for body in shown:
            X = state.links.get(body.name, body.X_base_body)
            if body.body_id is BodyId.NAIL:
                X = states.X_base_nail_part(body.name, X, state.sunk)
            scene.append(Body(body.mesh, X, materials[body.name], int(body.body_id)))
        if state.X_base_tool is not None:
            scene += [Body(mesh, state.X_base_tool, material, int(BodyId.TOOL)) for mesh, material in tool]
        picture = render(Scene(scene, _LIGHTS, Environment()), _VIEW, X_world_camera, auto_exposure=0.7).rgb.copy()
        if state.frame >= 0:
            rgb = history.rgb(state.frame)
            size = INSET, round(INSET * rgb.shape[0] / rgb.shape[1])
            inset = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
            picture[8 : 8 + size[1], -8 - INSET : -8] = inset
        _caption(picture, state)
        yield picture


def _tool_parts(history: RunHistory) -> list[tuple[Mesh, Material]]:
    """The tool's parts by colour."""
    data = history.attachments.get("tool.glb")
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


def _caption(picture: Picture, state: RunState) -> None:
    text = f"{state.stamp:5.1f} s  {state.stage.replace('_', ' ')}  nail {state.protrusion * 1e3:.1f} mm"
    for color, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(picture, text, (10, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.5, color, width, cv2.LINE_AA)

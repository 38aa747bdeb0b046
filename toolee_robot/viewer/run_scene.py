"""A run in three dimensions: robot, tool, nail, and what the robot saw and believed."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from toolee_robot.frames import Array
from toolee_robot.recording.history import RunHistory
from toolee_robot.recording.series import SeenEstimate, Series
from toolee_robot.recording.tool_file import read_tool_model
from toolee_robot.sim_backend.visuals.scene import BodyId
from toolee_robot.station import StationConfig
from toolee_robot.viewer.run_state import RunState, RunStates
from toolee_robot.viewer.station_scene import StationPicture, bodies, position_wxyz

CLOUD, HYPOTHESIS, SEEN, FUSED, FACE = (30, 160, 220), 0.012, (240, 160, 30), (60, 200, 90), 0.05
"""Colour of the cloud, length of a hypothesis' axes [m], colours of the ellipsoids, length of the face's axes [m]."""
SIGMAS = 10.0
"""Size of the ellipsoids at the beginning, in standard deviations: at three they are too small to see."""
_TOOL, _EE = "/run/tool", "/run/believed face"
_HAND, _SEEN = "/run/hand", "/run/hand/seen"


class RunScene:
    """Draws a run at a time.

    What a frame showed is drawn fixed to the hand, where it stays comparable while the hand moves on.

    Args:
        history: What was recorded; it may grow.
        config: The station.
        port: Port of the page; the next free one is taken where it is in use.

    Attributes:
        picture: The station's picture.
        states: The states of the run.

    Raises:
        UserError: viser is not installed.
    """

    def __init__(self, history: RunHistory, config: StationConfig, port: int) -> None:
        self._history, self._config = history, config
        self.states = RunStates(history, config)
        self.picture = StationPicture(config, port, (BodyId.TOOL, BodyId.PERSON))
        self._scene = self.picture.server.scene
        self._nail = {body.name: body.X_base_body for body in bodies(config) if body.body_id is BodyId.NAIL}
        self._tool: Any = None
        self._face = self._scene.add_frame(_EE, axes_length=FACE, axes_radius=FACE / 25.0, visible=False)
        self._hand = self._scene.add_frame(_HAND, show_axes=False)
        self._camera = self._scene.add_frame(_SEEN, show_axes=False, visible=False)
        self._frame, self._image, self._sigmas = -1, -1, SIGMAS
        self._fused: SeenEstimate | None = None
        self._fused_ellipsoid: Any = None
        self._again: Series[tuple[Any, ...]] = Series()
        self.picture.server.initial_camera.position = (1.25, 0.75, 0.85)
        self.picture.server.initial_camera.look_at = (0.45, -0.25, 0.3)

    @property
    def sigmas(self) -> float:
        """Size of the ellipsoids in standard deviations."""
        return self._sigmas

    @sigmas.setter
    def sigmas(self, value: float) -> None:
        self._sigmas, self._frame, self._fused = value, -1, None

    def follow(self) -> None:
        """Take what identifies the run anew from its history, which has just learnt it."""
        self.states = RunStates(self._history, self._config)

    def show(self, stamp: float) -> RunState:
        """Draw the run at a time [s]; returns its state."""
        state = self.states.at(stamp)
        with self.picture.server.atomic():
            for name, X in state.links.items():
                self.picture.move(name, X)
            for name, X in self._nail.items():
                self.picture.move(name, self.states.X_base_nail_part(name, X, state.sunk))
            _move(self._hand, state.X_base_hand)
            self._show_tool(state)
            if state.frame != self._frame:
                self._frame = state.frame
                self._show_frame(state.frame)
            shown = self._again.at(stamp)
            for _, nodes in self._again:
                for node in nodes:
                    if node is not None and node.visible != (nodes is shown):
                        node.visible = nodes is shown
            if state.in_hand is not self._fused:
                self._fused = state.in_hand
                self._show_fused(state.in_hand)
        return state

    def show_again(self, stamp: float, X_hand_ee: Array, covariance: Array, color: tuple[int, int, int]) -> None:
        """Draw another estimate in the hand, as of today's networks, from its time to that of the next.

        Args:
            stamp: Its time [s].
            X_hand_ee: Its pose in the hand, (4, 4).
            covariance: Its covariance in the hand's axes, (6, 6).
            color: Its colour.
        """
        position, wxyz = position_wxyz(X_hand_ee)
        name = f"today {len(self._again) + 1}"
        frame = self._scene.add_frame(
            f"{_HAND}/{name}", axes_length=0.8 * FACE, axes_radius=FACE / 40.0, position=position, wxyz=wxyz,
            origin_color=color, origin_radius=FACE / 12.0,
        )  # fmt: skip
        self._again.add(
            stamp, (frame, self._ellipsoid(f"{_HAND}/{name} covariance", X_hand_ee[:3, 3], covariance, color))
        )

    def _show_tool(self, state: RunState) -> None:
        if self._tool is None and "tool.glb" in self._history.attachments:
            mesh = read_tool_model(self._history.attachments["tool.glb"])
            self._tool = self._scene.add_mesh_trimesh(_TOOL, mesh, visible=False)
        held = state.X_base_tool is not None
        for node, X in ((self._tool, state.X_base_tool), (self._face, state.X_base_ee)):
            if node is None:
                continue
            if node.visible != held:
                node.visible = held
            if X is not None:
                _move(node, X)

    def _show_frame(self, frame: int) -> None:
        X_hand_camera = None if frame < 0 else self.states.X_hand_camera(frame)
        self._camera.visible = X_hand_camera is not None
        if X_hand_camera is None:
            self._image = -1
            self.picture.show_image(None)
            return
        _move(self._camera, X_hand_camera)
        h, stamp = self._history, self._history.images.stamps[frame]
        if frame != self._image:
            self._image = frame
            self.picture.show_image(h.rgb(frame))
        cloud, Xs = h.clouds.at(stamp), h.hypotheses.at(stamp)
        if cloud is not None and Xs is not None:
            self._scene.add_point_cloud(
                f"{_SEEN}/cloud", cloud.astype(np.float32), CLOUD, point_size=0.0012, precision="float32"
            )
            poses = [position_wxyz(X) for X in Xs]
            self._scene.add_batched_axes(
                f"{_SEEN}/hypotheses", np.array([q for _, q in poses]), np.array([p for p, _ in poses]),
                axes_length=HYPOTHESIS, axes_radius=HYPOTHESIS / 25.0,
            )  # fmt: skip
        seen = [e for t, e in h.estimates if t == stamp and e.X is not None]
        if seen:
            best = max(seen, key=lambda e: (e.usable, e.trust))
            assert best.X is not None
            position, wxyz = position_wxyz(best.X)
            self._scene.add_frame(
                f"{_SEEN}/estimate", axes_length=0.6 * FACE, axes_radius=FACE / 40.0, position=position, wxyz=wxyz
            )
            self._ellipsoid(f"{_SEEN}/covariance", best.X[:3, 3], best.covariance, SEEN)

    def _show_fused(self, fused: SeenEstimate | None) -> None:
        if fused is not None and fused.X is not None:
            name = f"{_HAND}/fused covariance"
            self._fused_ellipsoid = self._ellipsoid(name, fused.X[:3, 3], fused.covariance, FUSED)
        elif self._fused_ellipsoid is not None:
            self._fused_ellipsoid.visible = False

    def _ellipsoid(self, name: str, center: Array, covariance: Array, color: tuple[int, int, int]) -> Any:
        if not np.all(np.isfinite(covariance[:3, :3])):
            return None
        variances, axes = np.linalg.eigh(covariance[:3, :3])
        sphere = trimesh.creation.icosphere(subdivisions=2)
        radii = self._sigmas * np.sqrt(np.maximum(variances, 0.0))
        vertices = center + (sphere.vertices * radii) @ axes.T
        return self._scene.add_mesh_simple(name, vertices, sphere.faces, color=color, opacity=0.35, side="double")


def _move(node: Any, X: Array) -> None:
    node.position, node.wxyz = position_wxyz(X)

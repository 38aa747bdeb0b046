"""A run, logged to Rerun: one function for a run that is over and one that goes on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.control import RobotModel
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.recording.history import RunHistory, SeenDecision, Series
from toolee_robot.sim_backend.visuals import BodyId, nail_of
from toolee_robot.station import StationConfig
from toolee_robot.viewer.station_view import (
    BACKGROUND,
    TIMELINE,
    axes,
    bodies,
    body_path,
    log_lens,
    log_station,
    pose,
    send_poses,
)

GAP = 0.1
"""Time without a sample after which a motion is over [s]."""

ON_NAIL, ON_WOOD = 0.025, 0.06
"""Distances from a nail's axis at which a face is on the nail, and on the wood beside it [m]."""
DEEP = 0.02
"""A face that is believed so deep in the wood has struck the nail: touches of the wood are slow [m]."""


@dataclass(frozen=True, eq=False)
class _Nail:
    """A nail: its height over the wood before the run [m], where it enters the wood, and its axis out of the wood."""

    begin: float
    entry: Array
    axis: Array


@dataclass(frozen=True, eq=False)
class RunState:
    """The state of a run at one time.

    Attributes:
        stamp: The time [s].
        links: Pose of every link in `base`, (4, 4), by name.
        X_base_hand: Pose of the hand, (4, 4).
        X_base_tool: Believed pose of the tool, (4, 4); None while the hand does not hold it.
        X_base_ee: Believed pose of its end effector, (4, 4); None likewise.
        sunk: How far each nail has been driven, by its name [m].
        protrusion: Height over the wood of the head of the nail begun last [m].
        frame: Index of the newest frame; -1 before the first.
        stage: Stage of the job.
    """

    stamp: float
    links: dict[str, Array]
    X_base_hand: Array
    X_base_tool: Array | None
    X_base_ee: Array | None
    sunk: Mapping[str, float]
    protrusion: float
    frame: int
    stage: str


class RunStates:
    """The states of a run.

    Args:
        history: What was recorded; it may grow.
        config: The station.
    """

    def __init__(self, history: RunHistory, config: StationConfig) -> None:
        self._history, self._config = history, config
        self._robot = RobotModel.of_station(config)
        self._nails = {name: _Nail(w.nail_protrusion, w.p_base_entry, w.nail_axis) for name, w in config.work.each()}

    def at(self, stamp: float) -> RunState:
        """The state at a time [s]."""
        h = self._history
        q_arm = _between(h.joints, stamp, np.array(self._config.scene.home))
        q_hand = _between(h.hand, stamp, self._robot.description.hand_open)
        links = self._robot.description.link_poses(q_arm, q_hand)
        X_base_hand = links[self._robot.description.hand_frame]
        stage, held = "", False
        for decision in h.decisions.values[: h.decisions.index(stamp) + 1]:
            if decision.name == "stage":
                stage = str(decision.data["stage"])
            elif decision.name == "stage_ended" and decision.data["stage"] == "grip":
                held = True
            elif decision.name == "ended":
                stage = str(decision.data["outcome"])
                held = held and stage != "tool_lost"
        in_hand = next((e for e in reversed(h.in_hand.values[: h.in_hand.index(stamp) + 1]) if e.usable), None)
        X_hand_ee = self._told("X_hand_ee") if in_hand is None or in_hand.X is None else in_hand.X
        protrusion = h.protrusions.at(stamp)
        protrusion = self._config.work.nail_protrusion if protrusion is None else protrusion
        sunk = {}
        for name, nail in self._nails.items():
            height = h.nails[name].at(stamp) if name in h.nails else None
            sunk[name] = 0.0 if height is None else nail.begin - height
        X_base_ee = None
        if held:
            X_hand_tool = X_hand_ee @ inverse(self._told("X_tool_ee"))
            grip = X_hand_tool[:3, 3] - (X_hand_tool[:3, 3] @ X_hand_tool[:3, 2]) * X_hand_tool[:3, 2]
            X_base_ee = self._given_way((X_base_hand @ [*grip, 1.0])[:3], X_base_hand @ X_hand_ee, sunk)
        X_base_tool = None if X_base_ee is None else X_base_ee @ inverse(self._told("X_tool_ee"))
        return RunState(
            stamp, links, X_base_hand, X_base_tool, X_base_ee,
            sunk, protrusion, h.images.index(stamp), stage,
        )  # fmt: skip

    def _told(self, name: str) -> Array:
        """A pose from the run's metadata, (4, 4)."""
        text = self._history.metadata.get(name)
        return np.eye(4) if text is None else np.array(json.loads(text))

    def X_hand_camera(self, frame: int) -> Array | None:
        """Pose of the camera in the hand at the exposure of a frame, (4, 4); None where it was not recorded."""
        X = self._history.Xs_camera_hand.at(self._history.images.stamps[frame])
        return None if X is None else inverse(X)

    def X_base_nail_part(self, body: str, X: Array, sunk: Mapping[str, float]) -> Array:
        """Pose of a part of a nail after it was driven.

        Args:
            body: Name of the part's visual body.
            X: Its pose before, (4, 4).
            sunk: How far each nail was driven, by its name [m].

        Returns:
            Its pose, (4, 4).
        """
        name = nail_of(body)
        return transform(p=-sunk[name] * self._nails[name].axis) @ X

    def _given_way(self, p_grip: Array, X_base_ee: Array, sunk: Mapping[str, float]) -> Array:
        """Turn the tool about the grip until its face is on the nail or the wood, as the grip lets it.

        In a strike the arm goes on behind the contact, and the handle turns in the fingers by 40 to 100 mm at the face.
        No sensor sees that; that the face is not in the wood is certain.
        """
        for name, nail in self._nails.items():
            p = X_base_ee[:3, 3] - nail.entry
            height = float(p @ nail.axis)
            beside = float(np.linalg.norm(p - height * nail.axis))
            struck = beside < ON_NAIL or height < -DEEP
            least = nail.begin - sunk[name] if struck else 0.0
            if beside > ON_WOOD or height >= least:
                continue
            v = X_base_ee[:3, 3] - p_grip
            length, up = float(np.linalg.norm(v)), float(v @ nail.axis)
            angle = np.arcsin(np.clip((up + least - height) / length, -1.0, 1.0)) - np.arcsin(up / length)
            about = np.cross(v, nail.axis)
            R = Rotation.from_rotvec(angle * about / max(float(np.linalg.norm(about)), 1e-9))
            return transform(p=p_grip) @ transform(R) @ transform(p=-p_grip) @ X_base_ee
        return X_base_ee


def _between(series: Series[Array], stamp: float, before: Array) -> Array:
    """Joint positions at a time [s], (n,) [rad], interpolated within a motion; before the first those of then.

    Args:
        series: Joint positions by time.
        stamp: The time [s].
        before: What holds if there are none.
    """
    i = series.index(stamp)
    if i < 0:
        return series.values[0] if len(series) else before
    if i + 1 >= len(series):
        return series.values[i]
    t0, t1 = series.stamps[i], series.stamps[i + 1]
    if t1 - t0 > GAP:  # between two motions nothing moves
        return series.values[i]
    share = (stamp - t0) / (t1 - t0) if t1 > t0 else 0.0
    return np.asarray((1.0 - share) * series.values[i] + share * series.values[i + 1])


PERIOD_S = 1.0 / 30.0
"""Least time between two poses that are drawn [s]."""
SIGMAS = 10.0
"""Size of the ellipsoids in standard deviations: at three they are too small to see."""
FACE_AXES, CANDIDATE_AXES = 0.05, 0.012
"""Lengths of drawn axes [m]."""
CLOUD, SEEN, FUSED = (30, 160, 220), (240, 160, 30), (60, 200, 90)
"""Colours of the cloud and of the ellipsoids."""
FORCE, NAIL = (192, 57, 43), (36, 113, 163)
"""Colours of the curves."""
HAND, TOOL, FACE = "world/hand", "world/tool", "world/believed_face"
WORDS = {
    "": "Connecting",
    "handover": "Handover: waiting for the hammer",
    "grip": "Grip",
    "view": "Look: bringing the hammer into the camera's view",
    "perceive": "Look: finding its face",
    "plan": "Planning the strike",
    "touch": "Measuring the nail with a slow touch",
    "strike": "Striking: keep out of reach",
    "park": "Parking",
}
"""What the panel says of each stage."""


def blueprint(*, live: bool = False) -> Any:
    """Layout of a run's page: the scene; beside it what goes on, the camera's image, curves and decisions.

    Args:
        live: Whether the page follows a job that runs.

    Returns:
        The `rerun.blueprint.Blueprint`.
    """
    import rerun.blueprint as rrb

    eye = rrb.EyeControls3D(position=(1.25, 0.75, 0.85), look_target=(0.45, -0.25, 0.3), eye_up=(0, 0, 1))
    scene = rrb.Spatial3DView(origin="world", name="Scene", eye_controls=eye, background=BACKGROUND, line_grid=False)
    image = rrb.Spatial2DView(origin="world/camera/image", name="Camera")
    text = rrb.TextDocumentView(origin="now", name="Now")
    force = rrb.TimeSeriesView(origin="force", name="Force at the flange [N]")
    nail = rrb.TimeSeriesView(origin="nail", name="Nail over the wood [mm]")
    decisions = rrb.TextLogView(origin="decisions", name="Decisions")
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(scene, decisions, row_shares=[3, 1]),
            rrb.Vertical(text, image, force, nail, row_shares=[3, 4, 2, 2]),
            column_shares=[2, 1],
        ),
        rrb.TimePanel(
            state="collapsed", timeline=TIMELINE, play_state="following" if live else "paused", loop_mode="off"
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
    )


class RunView:
    """Logs a run to Rerun, as far as it has been recorded.

    What a frame showed is drawn fixed to the hand, where it stays comparable while the hand moves on.

    Args:
        stream: The `rerun.RecordingStream`.
        history: What was recorded; it may grow.
        config: The station.
        live: Whether the run goes on.

    Attributes:
        states: The states of the run.
    """

    def __init__(self, stream: Any, history: RunHistory, config: StationConfig, *, live: bool = False) -> None:
        import rerun as rr

        self.states = RunStates(history, config)
        self._prompt, self._prompted = "", 0
        self._rr, self._stream, self._history, self._live = rr, stream, history, live
        self._logged: dict[int, int] = {}
        self._frames: list[tuple[float, Any]] = []
        self._drawn, self._held = -np.inf, False
        shown = [body for body in bodies(config) if body.body_id is not BodyId.PERSON]
        self._nails = {body.name: body.X_base_body for body in shown if body.body_id is BodyId.NAIL}
        self._links = {body.name for body in shown if body.body_id in (BodyId.ARM, BodyId.HAND)}
        log_station(stream, config, shown)
        stream.log("force", rr.SeriesLines(colors=[FORCE], names=["force"]), static=True)
        stream.log("nail", rr.SeriesLines(colors=[NAIL], names=["nail"], interpolation_mode="StepAfter"), static=True)
        stream.log(FACE, rr.TransformAxes3D(FACE_AXES), static=True)
        self._log_poses([history.start])
        self._log(history.start, "nail", rr.Scalars(1e3 * self.states.at(history.start).protrusion))
        self.log_now(history.start)

    def update(self) -> None:
        """Log what has been recorded since the last call."""
        h, rr = self._history, self._rr
        with h.lock:
            joints, wrenches, decisions = self._new(h.joints), self._new(h.wrenches), self._new(h.decisions)
            logs, status, heights = self._new(h.logs), self._new(h.status), self._new(h.protrusions)
            frames, fused = self._new(h.images), self._new(h.in_hand)
        self._log_poses(self._thinned(joints) + [t for t, _ in decisions])
        if self._live:  # what was found in a frame is recorded just after it
            frames, self._frames = self._frames, frames
        if wrenches:
            at = [rr.TimeColumn(TIMELINE, duration=[t for t, _ in wrenches])]
            forces = np.linalg.norm([w[:3] for _, w in wrenches], axis=1)
            rr.send_columns("force", at, rr.Scalars.columns(scalars=forces), recording=self._stream)
        for stamp, height in heights:
            self._log(stamp, "nail", rr.Scalars(1e3 * height))
        for stamp, _ in frames:
            self._log_frame(stamp)
        for stamp, estimate in fused:
            if estimate.X is not None and estimate.usable:
                self._log_ellipsoid(stamp, f"{HAND}/fused", estimate.X, estimate.covariance, FUSED)
        lines = [(t, f"{d.name.replace('_', ' ')}: {d.reason}") for t, d in decisions if worth_telling(d)]
        for stamp, text in sorted([*lines, *logs]):
            self._log(stamp, "decisions", rr.TextLog(text, level="INFO"))
        for stamp in sorted({t for series in (decisions, logs, status) for t, _ in series}):
            self.log_now(stamp)
        if not h.complete and not self._live:
            self.log_now(h.end)

    def prompt(self, text: str) -> None:
        """Log what a person is to do now; it stays until the job goes on.

        Args:
            text: The prompt.
        """
        self._prompt, self._prompted = text, len(self._history.decisions)
        self.log_now(self._history.end)

    def log_now(self, stamp: float) -> None:
        """Log what goes on at a time [s]: stage, prompt, nail, robot, the last strikes and messages."""
        h, state = self._history, self.states.at(stamp)
        ended = next((d for _, d in h.decisions if d.name == "ended" and d.stamp <= stamp), None)
        title = WORDS.get(state.stage, state.stage.replace("_", " ").capitalize())
        parts = [f"# {title.upper() if ended else title}"]
        if ended is not None:
            parts.append(f"## {ended.reason}")
        elif self._prompt and len(h.decisions) <= self._prompted:
            parts.append(f"## ➤ {self._prompt}")
        parts.append(f"**Nail**: {state.protrusion * 1e3:.1f} mm over the wood, last measured")
        seen = h.status.at(stamp)
        if seen is not None:
            code = "" if seen.error_code is None else f", {seen.error_code}"
            parts.append(f"**Robot**: {seen.status.replace('_', ' ')}{code}")
        if not h.complete and stamp >= h.end and not self._live:
            parts.append(f"*{h.damage or 'The run was killed: the recording ends where it was last written.'}*")
        strikes = [d.reason for t, d in h.decisions if d.name == "strike" and t <= stamp]
        messages = [text for t, text in h.logs if t <= stamp][-2:]
        parts += [f"- {line}" for line in [*strikes[-3:], *messages]]
        self._log(stamp, "now", self._rr.TextDocument("\n\n".join(parts), media_type="text/markdown"))

    def _new(self, series: Series[Any]) -> list[tuple[float, Any]]:
        """What was added to a series since the last call."""
        begin = self._logged.get(id(series), 0)
        self._logged[id(series)] = len(series)
        return list(zip(series.stamps[begin:], series.values[begin:], strict=True))

    def _thinned(self, samples: list[tuple[float, Any]]) -> list[float]:
        """Times at which the robot is drawn: at least PERIOD_S apart, and the end."""
        stamps = []
        for stamp, _ in samples:
            if stamp - self._drawn >= PERIOD_S:
                self._drawn = stamp
                stamps.append(stamp)
        return [*stamps, samples[-1][0]] if samples else []

    def _log(self, stamp: float, path: str, what: Any) -> None:
        self._stream.set_time(TIMELINE, duration=stamp)
        self._stream.log(path, what)

    def _log_poses(self, stamps: list[float]) -> None:
        """Log where robot, tool and nails are at some times."""
        states = [self.states.at(stamp) for stamp in sorted(set(stamps))]
        if not states:
            return
        at = np.array([state.stamp for state in states])
        links = self._links & states[0].links.keys()
        Xs = {body_path(name): np.array([state.links[name] for state in states]) for name in links}
        Xs[HAND] = np.array([state.X_base_hand for state in states])
        for name, X in self._nails.items():
            Xs[body_path(name)] = np.array([self.states.X_base_nail_part(name, X, state.sunk) for state in states])
        send_poses(self._stream, Xs, at)
        for state in states:
            if (state.X_base_tool is not None) != self._held:
                self._held = not self._held
                self._log(state.stamp, TOOL, self._tool() if self._held else self._rr.Clear(recursive=True))
        held = [state for state in states if state.X_base_tool is not None]
        if held:
            at = np.array([state.stamp for state in held])
            tools, faces = np.array([s.X_base_tool for s in held]), np.array([s.X_base_ee for s in held])
            send_poses(self._stream, {TOOL: tools, FACE: faces}, at)

    def _tool(self) -> Any:
        data = self._history.attachments.get("tool.glb")
        return None if data is None else self._rr.Asset3D(contents=data, media_type="model/gltf-binary")

    def _log_frame(self, stamp: float) -> None:
        """Log an image and what was found in it."""
        h, rr = self._history, self._rr
        if h.intrinsics is not None:
            log_lens(self._stream, h.intrinsics)
        image = h.images.at(stamp)
        self._log(stamp, "world/camera/image", rr.EncodedImage(contents=image, media_type="image/png"))
        X_hand_camera = self.states.X_hand_camera(h.images.index(stamp))
        if X_hand_camera is None:
            return
        self._log(stamp, f"{HAND}/seen", pose(X_hand_camera))
        cloud, Xs = h.clouds.at(stamp), h.hypotheses.at(stamp)
        if cloud is not None and Xs is not None:
            self._log(stamp, f"{HAND}/seen/cloud", rr.Points3D(cloud, colors=[CLOUD], radii=0.0006))
            self._log(stamp, f"{HAND}/seen/candidates", axes(np.array(Xs), CANDIDATE_AXES))
        seen = [e for t, e in h.estimates if t == stamp and e.X is not None]
        if seen:
            best = max(seen, key=lambda e: (e.usable, e.trust))
            self._log_ellipsoid(stamp, f"{HAND}/seen/estimate", best.X, best.covariance, SEEN)

    def _log_ellipsoid(
        self, stamp: float, path: str, X: Array | None, covariance: Array, color: tuple[int, int, int]
    ) -> None:
        if X is None or not np.all(np.isfinite(covariance[:3, :3])):
            return
        variances, R = np.linalg.eigh(covariance[:3, :3])
        R[:, 2] *= np.linalg.det(R)
        radii = SIGMAS * np.sqrt(np.maximum(variances, 0.0))
        ellipsoid = self._rr.Ellipsoids3D(
            half_sizes=[radii], centers=[X[:3, 3]], quaternions=[Rotation.from_matrix(R).as_quat()],
            colors=[(*color, 110)], fill_mode="solid",
        )  # fmt: skip
        self._log(stamp, path, ellipsoid)


def worth_telling(decision: SeenDecision) -> bool:
    """Whether a decision is listed: all are but ends of stages, and motions that went as planned."""
    return decision.name not in ("stage_ended", "motion") or decision.data.get("outcome") not in (None, "completed")

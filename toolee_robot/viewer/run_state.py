"""Where everything was at one time of a run, as far as the robot knew."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.control import RobotModel
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.recording.history import RunHistory, Series
from toolee_robot.sim_backend.visuals import nail_of
from toolee_robot.station import StationConfig

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

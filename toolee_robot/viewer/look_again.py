"""Today's networks on the frames of a run, and what they find differently."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from toolee_robot.control import RobotModel
from toolee_robot.end_effectors import Category
from toolee_robot.errors import DeviceError, PerceptionError
from toolee_robot.frames import Array
from toolee_robot.perception import ToolPerception
from toolee_robot.recording.history import RunHistory, SeenEstimate
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.look import Views
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.types import InHandEstimate, Payload

_AXIS = Category.HAMMER_HEAD.symmetry


class _Fused(TaskObserver):
    """Keeps the last fused estimate."""

    def __init__(self) -> None:
        self.estimate: InHandEstimate | None = None

    def in_hand(self, stamp: float, estimate: InHandEstimate) -> None:  # noqa: ARG002
        self.estimate = estimate


@dataclass(frozen=True, eq=False)
class LookAgain:
    """One look of the run, evaluated again.

    Attributes:
        stamp: When its frames were fused [s].
        frames: Number of its frames.
        recorded: The estimate of then; None where it failed.
        today: The estimate of today's networks; None where they find nothing.
        reason: Why today's is not to be believed; empty if it is.
    """

    stamp: float
    frames: int
    recorded: SeenEstimate | None
    today: InHandEstimate | None
    reason: str

    @property
    def moved(self) -> float | None:
        """Distance of the two faces' centres [m]; None where one is missing."""
        if self.today is None or self.recorded is None or self.recorded.X is None:
            return None
        return float(np.linalg.norm(self.today.X_hand_ee[:3, 3] - self.recorded.X[:3, 3]))

    @property
    def turned(self) -> float | None:
        """Angle between the two poses, modulo the end effector's symmetry [rad]; None likewise."""
        if self.today is None or self.recorded is None or self.recorded.X is None:
            return None
        return float(_AXIS.rotation_error(self.today.X_hand_ee[:3, :3], self.recorded.X[:3, :3]))

    def figures(self) -> dict[str, Any]:
        """The comparison as JSON values: lengths in mm, angles in degrees."""
        moved, turned = self.moved, self.turned
        return {
            "stamp": self.stamp,
            "frames": self.frames,
            "recorded_usable": self.recorded is not None and self.recorded.usable,
            "today_usable": self.today is not None and not self.reason,
            "reason": self.reason,
            "moved_mm": None if moved is None else 1e3 * moved,
            "turned_deg": None if turned is None else float(np.rad2deg(turned)),
            "recorded_sigma_mm": None if self.recorded is None else 1e3 * _sigma(self.recorded.covariance),
            "today_sigma_mm": None if self.today is None else 1e3 * _sigma(self.today.covariance),
        }

    def row(self) -> tuple[str, ...]:
        """The comparison as cells of a table: frames, recorded, today, moved, turned, sigma."""
        f = self.figures()
        recorded = "none" if self.recorded is None else ("usable" if self.recorded.usable else "not usable")
        today = self.reason or "usable"
        sigma = f"{_cell(f['recorded_sigma_mm'])} / {_cell(f['today_sigma_mm'])}"
        return str(self.frames), recorded, today, _cell(f["moved_mm"]), _cell(f["turned_deg"]), sigma


def look_again(history: RunHistory, config: StationConfig, perception: ToolPerception | None = None) -> list[LookAgain]:
    """Evaluate the looks of a run again, as the task does: the same frames, the same prior of the hand.

    Args:
        history: The recording of the run.
        config: Its station.
        perception: The networks; None: the shipped ones.

    Returns:
        The looks, in order.
    """
    perception = perception or ToolPerception.load()
    robot = RobotModel.of_station(config)
    nominal = np.array(json.loads(history.metadata["X_hand_ee"]))
    looks, begin = [], 0
    held = HeldTool.nominally(nominal, Payload(0.0, np.zeros(3)))
    ends = history.in_hand.stamps or ([history.end] if len(history.images) else [])
    for stamp in ends:
        end = history.images.index(stamp) + 1
        fused = _Fused()
        look = Views(config, robot, perception, fused, held)
        reason = ""
        try:
            for i in range(begin, end):
                X = history.Xs_camera_hand.at(history.images.stamps[i])
                assert X is not None
                look.add(history.frame(i), X)
            look.fuse(stamp)
        except (PerceptionError, DeviceError) as error:
            reason = str(error)
        if fused.estimate is not None and not reason:
            held = replace(held, seen=fused.estimate)
        recorded = history.in_hand.at(stamp) if len(history.in_hand) else None
        looks.append(LookAgain(stamp, end - begin, recorded, fused.estimate, reason))
        begin = end
    return looks


def _sigma(covariance: Array) -> float:
    """Standard deviation of the position along its worst axis [m]."""
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"

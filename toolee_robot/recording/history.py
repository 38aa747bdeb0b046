"""What a recording says, by time: what the page shows of a run, whether that is over or goes on."""

from __future__ import annotations

import json
import threading
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.recording.messages import matrix, plain
from toolee_robot.runtime.images import decode_image
from toolee_robot.runtime.yaml_files import to_record
from toolee_robot.station import ONLY_NAIL, StationConfig, for_each_joint, sim_station
from toolee_robot.types import CameraIntrinsics

T = TypeVar("T")


class Series(Generic[T]):
    """Values by time, in the order of their stamps."""

    def __init__(self) -> None:
        self.stamps: list[float] = []
        self.values: list[T] = []

    def __len__(self) -> int:
        return len(self.stamps)

    def __iter__(self) -> Iterator[tuple[float, T]]:
        return iter(list(zip(self.stamps, self.values, strict=False)))

    def add(self, stamp: float, value: T) -> None:
        """Insert a value; most come in order.

        Args:
            stamp: Time [s].
            value: The value.
        """
        i = len(self.stamps) if not self.stamps or stamp >= self.stamps[-1] else bisect_right(self.stamps, stamp)
        self.values.insert(i, value)
        self.stamps.insert(i, stamp)

    def index(self, stamp: float) -> int:
        """Index of the newest value at a time [s]; -1 before the first."""
        return bisect_right(self.stamps, stamp) - 1

    def at(self, stamp: float) -> T | None:
        """The newest value at a time [s]; None before the first."""
        i = self.index(stamp)
        return None if i < 0 else self.values[i]


@dataclass(frozen=True, eq=False)
class SeenEstimate:
    """An estimate of an end effector's pose.

    Attributes:
        category: Category of the end effector.
        X: Its pose, (4, 4), in the camera's frame, or in the hand's after fusion; None where there is none.
        covariance: Covariance of position [m] and rotation vector [rad], (6, 6).
        trust: Probability that it is right, 0 to 1.
        usable: Whether it may be acted on.
        reason: Why not, or "ok".
        frames_used: Number of frames that it rests on.
        frames_seen: Number of frames that were looked at.
    """

    category: str
    X: Array | None
    covariance: Array
    trust: float
    usable: bool
    reason: str
    frames_used: int
    frames_seen: int


@dataclass(frozen=True)
class SeenStatus:
    """State of the robot's own safety system.

    Attributes:
        status: The state, a `hal.ArmStatus` in words.
        safety_bits: The controller's own bits; None where it has none, or the recording.
        error_code: Code that explains the last stop, such as C157A4; None where none is known, and likewise.
    """

    status: str
    safety_bits: int | None
    error_code: str | None


@dataclass(frozen=True)
class SeenDecision:
    """A decision.

    Attributes:
        stamp: Time [s].
        name: Its kind.
        reason: The reason, for a person.
        data: Its data, JSON values.
    """

    stamp: float
    name: str
    reason: str
    data: dict[str, Any]


@dataclass(eq=False)
class RunHistory:
    """What a run recorded, by topic. Messages may be added while others read."""

    metadata: dict[str, str] = field(default_factory=dict)
    """What identifies the run."""
    attachments: dict[str, bytes] = field(default_factory=dict)
    """Attached files by name."""
    complete: bool = True
    """Whether the file was finished: a killed run's is not."""
    damage: str = ""
    """What is wrong with the file; empty if nothing is, other than that it was not finished."""
    joints: Series[Array] = field(default_factory=Series)
    """Measured joint positions of the arm, (6,) [rad]."""
    commanded: Series[Array] = field(default_factory=Series)
    """Commanded joint positions of the arm, (6,) [rad]."""
    velocities: Series[Array] = field(default_factory=Series)
    """Measured joint velocities of the arm, (6,) [rad/s]; empty where they were not recorded."""
    torques: Series[Array] = field(default_factory=Series)
    """Joint torques of the commanded motion as the controller computed them, (6,) [Nm]; likewise."""
    currents: Series[Array] = field(default_factory=Series)
    """Measured motor currents of the arm, (6,) [A]; likewise."""
    safety_bits: Series[int] = field(default_factory=Series)
    """The controller's own safety status, at the begin of each motion and where it changed in one; likewise."""
    hand: Series[Array] = field(default_factory=Series)
    """Measured joint positions of the hand, (n,) [rad]."""
    wrenches: Series[Array] = field(default_factory=Series)
    """Force [N] and torque [Nm] on the flange, (6,)."""
    status: Series[SeenStatus] = field(default_factory=Series)
    """State of the robot's own safety system."""
    images: Series[bytes] = field(default_factory=Series)
    """Colour images, PNG."""
    depths: Series[NDArray[np.float32]] = field(default_factory=Series)
    """Depth images [m]."""
    intrinsics: CameraIntrinsics | None = None
    """Intrinsics of both images."""
    Xs_camera_hand: Series[Array] = field(default_factory=Series)
    """Pose of the hand in the camera's frame at each frame, (4, 4)."""
    estimates: Series[SeenEstimate] = field(default_factory=Series)
    """Estimates from one frame each."""
    in_hand: Series[SeenEstimate] = field(default_factory=Series)
    """Fused estimates."""
    clouds: Series[Array] = field(default_factory=Series)
    """Points of the end effector, (N, 3) [m], camera frame."""
    hypotheses: Series[list[Array]] = field(default_factory=Series)
    """Candidate poses, (4, 4) each, camera frame."""
    decisions: Series[SeenDecision] = field(default_factory=Series)
    """All decisions."""
    protrusions: Series[float] = field(default_factory=Series)
    """Height of the nail over the wood, of the one begun last: at its beginning, and as measured after strikes [m]."""
    nails: dict[str, Series[float]] = field(default_factory=dict)
    """The same of each nail, by its name; from when it was begun [m]."""
    logs: Series[str] = field(default_factory=Series)
    """Messages for a person."""
    lock: threading.Lock = field(default_factory=threading.Lock)
    """Held while a message is added."""

    @property
    def start(self) -> float:
        """Time of the first decision or sample [s]."""
        return min((s.stamps[0] for s in (self.decisions, self.joints) if len(s)), default=0.0)

    @property
    def end(self) -> float:
        """Time of the last decision or sample [s]."""
        return max((s.stamps[-1] for s in (self.decisions, self.joints) if len(s)), default=0.0)

    def station(self) -> StationConfig:
        """The station of the run.

        Raises:
            UserError: The recording holds none: it is not a job's.
            ConfigError: This version cannot read it.
        """
        if "station.json" not in self.attachments:
            raise UserError("the recording holds no station: only a job's recording can be shown")
        recorded = _completed(json.loads(self.attachments["station.json"]), plain(asdict(sim_station())))
        if isinstance(strike := recorded.get("strike"), dict) and strike.get("deepest") is None:
            del strike["deepest"]  # of a straight strike, which older versions had
        return to_record(for_each_joint(recorded), Path("station.json"), StationConfig, "station")

    def rgb(self, index: int) -> NDArray[np.uint8]:
        """A colour image, (H, W, 3), by its index.

        Raises:
            UserError: It cannot be decoded (`user.recording_unreadable`).
        """
        try:
            bgr, why = decode_image(self.images.values[index], cv2.IMREAD_COLOR), ""
        except ValueError as error:
            bgr, why = None, f": {error}"
        if bgr is None:
            raise UserError(
                f"image {index + 1} of the recording cannot be decoded{why}", code="user.recording_unreadable"
            )
        return np.ascontiguousarray(bgr[..., ::-1], dtype=np.uint8)

    def add(self, topic: str, stamp: float, message: Any) -> None:
        """Add a message of a recording; one of an unknown topic is left out.

        Args:
            topic: Its topic.
            stamp: Its time [s].
            message: The message.
        """
        handler = _HANDLERS.get(topic)
        if handler is not None:
            with self.lock:
                handler(self, stamp, message)


def _completed(recorded: Any, default: Any) -> Any:
    """A recorded section of a station file, as this version has it: what older ones lacked was the simulation's."""
    if not (isinstance(recorded, dict) and isinstance(default, dict)):
        return recorded
    return {k: _completed(recorded[k], value) if k in recorded else value for k, value in default.items()}


def _positions(message: Any) -> Array:
    return np.array([joint.position for joint in message.joints])


def _measured(history: RunHistory, stamp: float, message: Any) -> None:
    history.joints.add(stamp, _positions(message))
    _add_known(history.velocities, stamp, message, "velocity")


def _commanded(history: RunHistory, stamp: float, message: Any) -> None:
    history.commanded.add(stamp, _positions(message))
    _add_known(history.torques, stamp, message, "effort")


def _add_known(series: Series[Array], stamp: float, message: Any, name: str) -> None:
    if all(joint.HasField(name) for joint in message.joints):
        series.add(stamp, np.array([getattr(joint, name) for joint in message.joints]))


def _status(history: RunHistory, stamp: float, m: Any) -> None:
    known = m.DESCRIPTOR.fields_by_name  # as the recording describes them
    bits, code = (
        getattr(m, name) if name in known and m.HasField(name) else None for name in ("safety_bits", "error_code")
    )
    history.status.add(stamp, SeenStatus(m.status, bits, code))


def _tf(history: RunHistory, stamp: float, message: Any) -> None:
    for t in message.transforms:
        if (t.parent_frame_id, t.child_frame_id) == ("camera", "hand"):
            history.Xs_camera_hand.add(stamp, matrix(t.translation, t.rotation))


def _depth(history: RunHistory, stamp: float, message: Any) -> None:
    history.depths.add(stamp, np.frombuffer(message.data, "<f4").reshape(message.height, message.width))


def _intrinsics(history: RunHistory, _stamp: float, message: Any) -> None:
    fx, _, cx, _, fy, cy, *_ = message.K
    history.intrinsics = CameraIntrinsics(fx, fy, cx, cy, message.width, message.height)


def _estimate(series: Callable[[RunHistory], Series[SeenEstimate]]) -> Callable[[RunHistory, float, Any], None]:
    def add(history: RunHistory, stamp: float, m: Any) -> None:
        X = matrix(m.pose.position, m.pose.orientation) if m.HasField("pose") else None
        covariance = np.array(m.covariance).reshape(6, 6)
        seen = SeenEstimate(m.category, X, covariance, m.trust, m.usable, m.reason, m.frames_used, m.frames_seen)
        series(history).add(stamp, seen)

    return add


def _decision(history: RunHistory, stamp: float, message: Any) -> None:
    data = json.loads(message.data)
    history.decisions.add(stamp, SeenDecision(stamp, message.name, message.reason, data))
    if message.name in ("nail", "strike") and data.get("protrusion") is not None:
        height = float(data["protrusion"])
        history.protrusions.add(stamp, height)
        history.nails.setdefault(data.get("nail", ONLY_NAIL), Series()).add(stamp, height)


def _wrench(history: RunHistory, stamp: float, m: Any) -> None:
    history.wrenches.add(stamp, np.array([m.force.x, m.force.y, m.force.z, m.torque.x, m.torque.y, m.torque.z]))


def _cloud(history: RunHistory, stamp: float, m: Any) -> None:
    history.clouds.add(stamp, np.frombuffer(m.data, "<f4").reshape(-1, 3).astype(float))


_HANDLERS: dict[str, Callable[[RunHistory, float, Any], None]] = {
    "/arm/measured": _measured,
    "/arm/commanded": _commanded,
    "/arm/currents": lambda h, t, m: h.currents.add(t, np.array(m.currents)),
    "/arm/safety_bits": lambda h, t, m: h.safety_bits.add(t, m.bits),
    "/arm/wrench": _wrench,
    "/arm/status": _status,
    "/hand/measured": lambda h, t, m: h.hand.add(t, _positions(m)),
    "/camera/rgb": lambda h, t, m: h.images.add(t, m.data),
    "/camera/depth": _depth,
    "/camera/calibration": _intrinsics,
    "/tf": _tf,
    "/perception/cloud": _cloud,
    "/perception/hypotheses": lambda h, t, m: h.hypotheses.add(t, [matrix(p.position, p.orientation) for p in m.poses]),
    "/perception/estimates": _estimate(lambda h: h.estimates),
    "/perception/in_hand": _estimate(lambda h: h.in_hand),
    "/decisions": _decision,
    "/log": lambda h, t, m: h.logs.add(t, m.message),
}

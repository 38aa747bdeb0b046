"""Every reading of the robot's state, none left out.

ur_rtde's receiver keeps the newest of what has come and drops the rest: of two readings that a busy network delivers
at once it shows one, and a strike, or a reading that makes no sense, may be in the other. So the state comes over a
connection of our own, which only reads, and on which readings wait in the order in which they were sent.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from toolee_robot.errors import NoAnswerError, NotReadyError, ProtocolError
from toolee_robot.frames import Array
from toolee_robot.hardware.ur.protocols.rtde import RtdeReader, RtdeSample, Value
from toolee_robot.runtime.clock import HostClock

_ALWAYS = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "target_q",
    "actual_TCP_force",
    "safety_status_bits",
    "robot_mode",
    "runtime_state",
)
_WHERE_KNOWN = ("payload", "payload_cog")  # since 3.11 and 5.5.1

_IMPLAUSIBLE = 100.0
"""[rad], [rad/s] No joint of a robot reads so much, nor what is not a number."""
_IMPLAUSIBLE_WRENCH = 1e4
"""[N, Nm]"""

# The controller's base is our base_link turned by pi about z: forces and torques change sign in x and y.
_TURN = np.array([-1.0, -1.0, 1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Reading:
    """timestamp: the controller's [s]. q, qd, target: (6,) joints, and where the controller holds them [rad, rad/s].
    wrench: (6,) [N, Nm] at the flange, in `base`. safety_bits, robot_mode, runtime_state: RTDE's numbers. payload: mass
    and centre of gravity in the flange [kg, m], None from a controller that does not report them."""

    timestamp: float
    q: Array
    qd: Array
    target: Array
    wrench: Array
    safety_bits: int
    robot_mode: int
    runtime_state: int
    payload: tuple[float, float, float, float] | None


class StateStream:
    """newest: the reading that came last; arrived: when it came, seen: when it was taken in [s]. lost: True for good
    once the connection is gone. sane: False for good once data made no sense; they are never taken in."""

    def __init__(self, host: str, rate: float, timeout: float, clock: HostClock) -> None:
        """Connect, and wait for the first reading; timeout [s] of the wall. Raises NoAnswerError, ProtocolError, and
        NotReadyError for a controller that does not report what is needed."""
        deadline = time.monotonic() + timeout
        self._clock = clock
        self.lost, self.plausible = False, True
        self._reader = RtdeReader.connect(host, deadline)
        if self._reader.subscribe(_ALWAYS + _WHERE_KNOWN, rate, deadline):
            self._reader.close()
            self._reader = RtdeReader.connect(host, deadline)
            if unknown := self._reader.subscribe(_ALWAYS, rate, deadline):
                raise NotReadyError(f"the controller does not report {', '.join(unknown)}: update PolyScope")
        first = self._reader.read(deadline)
        self.newest, self.seen = _reading(first), clock.now()
        self.arrived = first.received * clock.real_time_factor

    def take(self) -> list[Reading]:
        """Those that have come since, the oldest first; none of them once the stream is lost or not sane. Never
        waits."""
        if self.lost or not self.plausible:
            return []
        try:
            return list(self._advance(self._reader.arrived()))
        except ProtocolError:
            self.plausible = False
        except NoAnswerError:
            self.lost = True
        return []

    def _advance(self, samples: Iterable[RtdeSample]) -> Iterable[Reading]:
        for sample in samples:
            reading = _reading(sample)
            if reading.timestamp == self.newest.timestamp:
                continue
            if reading.timestamp < self.newest.timestamp:
                raise ProtocolError("the robot's time goes back")
            self.newest, self.seen = reading, self._clock.now()
            self.arrived = sample.received * self._clock.real_time_factor
            yield reading


def _reading(sample: RtdeSample) -> Reading:
    """Raises ProtocolError for what no robot measures."""
    values = sample.values
    timestamp, wrench = _numbers(values["timestamp"]), _numbers(values["actual_TCP_force"])
    q, qd, target = (_numbers(values[name]) for name in ("actual_q", "actual_qd", "target_q"))
    # NaN fails every comparison.
    if timestamp.shape != (1,) or not abs(timestamp[0]) < np.inf:
        raise ProtocolError("the robot's time is no number")
    if not all(joints.shape == (6,) and np.all(np.abs(joints) < _IMPLAUSIBLE) for joints in (q, qd, target)):
        raise ProtocolError("the robot's joints are no joints")
    if not (wrench.shape == (6,) and np.all(np.abs(wrench) < _IMPLAUSIBLE_WRENCH)):
        raise ProtocolError("the robot's forces are no forces")
    safety, mode, runtime = (int(_numbers(values[name])[0]) for name in _ALWAYS[-3:])
    payload = None
    if _WHERE_KNOWN[0] in values:
        mass, x, y, z = np.hstack([_numbers(values[name]) for name in _WHERE_KNOWN]).tolist()
        payload = (mass, x, y, z)
    return Reading(float(timestamp[0]), q, qd, target, wrench * _TURN, safety, mode, runtime, payload)


def _numbers(value: Value) -> Array:
    return np.atleast_1d(np.asarray(value, dtype=np.float64))

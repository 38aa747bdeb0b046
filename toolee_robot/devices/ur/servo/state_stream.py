"""A gap-free stream of the robot's state.

ur_rtde's receiver keeps only the newest reading: of two that the network delivers at once it drops one, which may
contain a strike's force or an implausible value. The state is therefore read over a separate read-only connection, on
which readings queue in the order in which they were sent.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from toolee_robot.devices.ur.protocols.rtde import RtdeReader, RtdeSample, Value
from toolee_robot.errors import NoAnswerError, NotReadyError, ProtocolError
from toolee_robot.frames import Array
from toolee_robot.runtime.clock import HostClock

_ALWAYS = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "target_q",
    "actual_TCP_force",
    "target_speed_fraction",
    "speed_scaling",
    "safety_status_bits",
    "robot_mode",
    "runtime_state",
    "actual_digital_input_bits",
)
_TCP = "tcp_offset"
_PAYLOAD = ("payload", "payload_cog")  # since 3.11 and 5.5.1
_RATIOS = ("joint_position_deviation_ratio", "collision_detection_ratio")  # newer e-Series versions only
_DRIVES = ("target_moment", "actual_current")
_OPTIONAL = (_TCP, *_PAYLOAD, *_RATIOS, *_DRIVES)

_IMPLAUSIBLE = 100.0
"""[rad], [rad/s] Bound of plausible joint readings."""
_IMPLAUSIBLE_WRENCH = 1e4
"""[N, Nm] Bound of plausible wrench readings."""

# The controller's base is `base` rotated by pi about z: forces and torques change sign in x and y.
_TURN = np.array([-1.0, -1.0, 1.0, -1.0, -1.0, 1.0])
_UNKNOWN = np.full(6, np.nan)


@dataclass(frozen=True)
class Reading:
    """One reading of the robot's state.

    Attributes:
        timestamp: The controller's time [s].
        q: Measured joint positions, (6,) [rad].
        qd: Measured joint velocities, (6,) [rad/s].
        target: Joint positions at which the controller holds the arm, (6,) [rad].
        wrench: Wrench at the flange, less the stream's offset, (6,) [N, Nm], axes of `base`.
        speed_slider: Position of the speed slider, 0 to 1.
        speed_scaling: Speed of the motion as a fraction of the commanded one.
        safety_bits: RTDE's safety_status_bits.
        robot_mode: RTDE's robot_mode.
        runtime_state: RTDE's runtime_state.
        digital_inputs: RTDE's actual_digital_input_bits.
        payload: Mass [kg] and centre of gravity x, y, z [m] in the flange frame; None from a controller that does not
            report them.
        tcp: TCP in the flange frame, (6,): position [m], rotation vector [rad]; None likewise.
        position_deviation_ratio: How near the joints' deviation from their path is to a protective stop (UR's codes
            C153, C159), which comes at 1; NaN likewise.
        collision_ratio: How near the collision detection is to a protective stop (C157, C158), which comes at 1; NaN
            likewise.
        torques: Joint torques of the commanded motion, as the controller computes them, (6,) [Nm]; NaN likewise.
        currents: Measured motor currents, (6,) [A]; NaN likewise.
    """

    timestamp: float
    q: Array
    qd: Array
    target: Array
    wrench: Array
    speed_slider: float
    speed_scaling: float
    safety_bits: int
    robot_mode: int
    runtime_state: int
    digital_inputs: int
    payload: tuple[float, float, float, float] | None
    tcp: Array | None
    position_deviation_ratio: float
    collision_ratio: float
    torques: Array
    currents: Array


class StateStream:
    """A connection on which the controller sends its state at its rate.

    Args:
        host: Address of the controller.
        rate: Rate of the readings [Hz].
        timeout: Timeout of connecting and of the first reading [s] on the wall clock.
        clock: The station's clock.

    Attributes:
        newest: The last reading.
        arrived: When it arrived at this machine [s] on the station's clock.
        seen: When it was read [s] on the station's clock.
        lost: Whether the connection is lost; stays True.
        plausible: Whether all data were plausible; stays False. Implausible data are discarded.
        wrench_offset: What is subtracted from the wrench of the readings to come, (6,) [N, Nm], axes of `base`.

    Raises:
        NoAnswerError: The controller does not answer in time.
        ProtocolError: It sends what RTDE does not allow, or implausible data.
        NotReadyError: It does not report an output that is needed.
    """

    def __init__(self, host: str, rate: float, timeout: float, clock: HostClock) -> None:
        deadline = time.monotonic() + timeout
        self._clock = clock
        self.lost, self.plausible = False, True
        self.wrench_offset: Array = np.zeros(6)
        self._reader = RtdeReader.connect(host, deadline)
        if unknown := self._reader.subscribe(_ALWAYS + _OPTIONAL, rate, deadline):
            # A recipe cannot be corrected: leave out what this version does not have, on a new connection.
            self._reader.close()
            known = [name for name in _ALWAYS + _OPTIONAL if name not in unknown]
            self._reader = RtdeReader.connect(host, deadline)
            if missing := {*_ALWAYS}.intersection(unknown).union(self._reader.subscribe(known, rate, deadline)):
                message = f"the controller does not report {', '.join(sorted(missing))}: update PolyScope"
                raise NotReadyError(message)
        first = self._reader.read(deadline)
        self.newest, self.seen = _reading(first), clock.now()
        self.arrived = first.received * clock.real_time_factor

    def fileno(self) -> int:
        """The connection's file descriptor."""
        return self._reader.fileno()

    def take(self) -> list[Reading]:
        """The readings that have arrived since the last call, the oldest first; never waits.

        Returns:
            The readings; none once the stream is lost or implausible.
        """
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
                raise ProtocolError("the robot's time runs backwards", code="protocol.implausible")
            reading = replace(reading, wrench=reading.wrench - self.wrench_offset)
            self.newest, self.seen = reading, self._clock.now()
            self.arrived = sample.received * self._clock.real_time_factor
            yield reading


def _reading(sample: RtdeSample) -> Reading:
    """Convert a sample. Raises ProtocolError for implausible values."""
    values = sample.values
    timestamp, wrench = _numbers(values["timestamp"]), _numbers(values["actual_TCP_force"])
    q, qd, target = (_numbers(values[name]) for name in ("actual_q", "actual_qd", "target_q"))
    # NaN fails every comparison.
    if timestamp.shape != (1,) or not abs(timestamp[0]) < np.inf:
        raise ProtocolError("the robot's time is not a finite number", code="protocol.implausible")
    if not all(joints.shape == (6,) and np.all(np.abs(joints) < _IMPLAUSIBLE) for joints in (q, qd, target)):
        raise ProtocolError("the robot's joint readings are implausible", code="protocol.implausible")
    if not (wrench.shape == (6,) and np.all(np.abs(wrench) < _IMPLAUSIBLE_WRENCH)):
        raise ProtocolError("the robot's wrench readings are implausible", code="protocol.implausible")
    speeds = _numbers([values["target_speed_fraction"], values["speed_scaling"]])
    if not (speeds.shape == (2,) and np.all(np.abs(speeds) < _IMPLAUSIBLE)):
        raise ProtocolError("the robot's speed slider or scaling is implausible", code="protocol.implausible")
    slider, scaling = speeds.tolist()
    safety, mode, runtime, inputs = (int(_numbers(values[name])[0]) for name in _ALWAYS[-4:])
    payload = None
    if all(name in values for name in _PAYLOAD):
        mass, x, y, z = np.hstack([_numbers(values[name]) for name in _PAYLOAD]).tolist()
        payload = (mass, x, y, z)
    deviation, collision = (_ratio(values[name]) if name in values else np.nan for name in _RATIOS)
    return Reading(
        float(timestamp[0]),
        q,
        qd,
        target,
        wrench * _TURN,
        slider,
        scaling,
        safety,
        mode,
        runtime,
        inputs,
        payload,
        _numbers(values[_TCP]) if _TCP in values else None,
        deviation,
        collision,
        *(_drives(values.get(name)) for name in _DRIVES),
    )


def _ratio(value: Value) -> float:
    """Convert a ratio to a protective stop. Raises ProtocolError for an impossible value."""
    (ratio,) = _numbers(value).tolist()
    if not 0.0 <= ratio < np.inf:
        raise ProtocolError("a ratio to a protective stop is negative or no number", code="protocol.implausible")
    return float(ratio)


def _drives(value: Value | None) -> Array:
    """Convert torques or currents of the six joints, which are recorded only: implausible ones stop no arm."""
    numbers = _UNKNOWN if value is None else _numbers(value)
    return numbers if numbers.shape == (6,) else _UNKNOWN


def _numbers(value: Value | list[Value]) -> Array:
    return np.atleast_1d(np.asarray(value, dtype=np.float64))

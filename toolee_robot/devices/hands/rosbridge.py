"""A Shadow Hand's ROS messages by rosbridge v2.0 (RobotWebTools/rosbridge_suite, branch ros1, ROSBRIDGE_PROTOCOL.md).

`roslibpy` is not used: it connects anew and subscribes anew by itself, logs and drops what it cannot decode, and its
event loop starts once in a process, so that neither a lost hand nor a damaged message would reach the job.
"""

from __future__ import annotations

import json
import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI
from websockets.sync.client import connect

from toolee_robot.devices.hands.polled import UNPLUGGED
from toolee_robot.devices.hands.ports import LineCounts
from toolee_robot.errors import ConfigError, DeviceError, NoAnswerError, ProtocolError, words_of
from toolee_robot.frames import Array
from toolee_robot.hal import Clock
from toolee_robot.robots import SHADOW_HAND
from toolee_robot.robots.hands.shadow import MOTORS

OPEN_S = 3.0
"""Longest time for connecting."""
ANSWER_S = 0.03
"""Longest wait for a reading; one comes every 8 ms (user guide: 125 Hz)."""
FIND_S = 3.0
"""Longest wait for the first message of every topic; diagnostics come twice a second."""
STEP_NS = 20_000_000
"""Time in which the controllers go to a commanded position; a point in the past is dropped."""
LARGEST = 2**20
"""Size of the largest message that is taken [bytes]."""
DRIFT = 5e-4
"""By how much the two computers' clocks may drift apart [s/s]: ten times what quartz crystals do."""
TOLERANCE_RAD = 0.02
"""Largest distance of a desired position from a commanded one that counts as the same."""
HALTS_AT = 60.0
"""Temperature at which the firmware halts a motor [deg C] (user guide, *Firmware*, Safety)."""
JOINTS = SHADOW_HAND.joints
"""The joints in the order of all arrays here, wrist first."""
CONTROLLERS = {"/rh_wr_trajectory_controller": slice(0, 2), "/rh_trajectory_controller": slice(2, len(JOINTS))}
"""Controller -> its joints among JOINTS: it takes all of them or none."""
JOINT_STATES, DIAGNOSTICS, MOTOR = "/joint_states", "/diagnostics", "rh SRDMotor "
"""Topics, and the beginning of the names of the motors' statuses (`sr_motor_robot_lib.cpp`)."""
TYPES = {
    JOINT_STATES: "sensor_msgs/JointState", DIAGNOSTICS: "diagnostic_msgs/DiagnosticArray",
    **{f"{name}/state": "control_msgs/JointTrajectoryControllerState" for name in CONTROLLERS},
}  # fmt: skip
"""Topics that are read -> their types."""


@dataclass(frozen=True)
class MotorStatus:
    """State of one motor, twice a second."""

    hot: bool
    """Whether its firmware halts it because of heat."""
    trouble: str
    """What is wrong with it, for people; empty for nothing. A limited current is nothing."""
    temperature: float | None
    """Temperature near the motor [deg C]; None if the hand does not tell."""


def motor_status(motor: str, status: Mapping[str, Any]) -> MotorStatus:
    """Read a diagnostic_msgs/DiagnosticStatus; ValueError, KeyError or TypeError for what is no status."""
    said = {pair["key"]: pair["value"] for pair in status["values"]}
    temperature = _finite([said["Temperature"]])[0] if "Temperature" in said else None
    hot = "Motor over temperature" in said.get("Motor Flags", "") or (temperature or 0.0) > HALTS_AT
    wrong = "too hot" if hot else status["message"] if int(status["level"]) >= 2 else ""
    return MotorStatus(hot, f"{motor}: {wrong}" if wrong else "", temperature)


def in_order(names: Sequence[str], values: Sequence[float], joints: Sequence[str]) -> Array:
    """Bring values into the order of joints; ValueError or TypeError if one is missing or no finite number."""
    by_name = dict(zip(names, _finite(values), strict=True))
    if lacking := ", ".join(joint for joint in joints if joint not in by_name):
        raise ValueError(f"{lacking} missing")
    return np.array([by_name[joint] for joint in joints])


def _finite(values: Sequence[Any]) -> list[float]:
    numbers = np.array(values, float)  # of a null NaN
    if not np.isfinite(numbers).all():
        raise ValueError("a number is not finite")
    return [float(number) for number in numbers]


class Acknowledgement:
    """Whether one controller has got its commands: rosbridge acknowledges none, the controller's states show them.

    Attributes:
        since: Time of the oldest command that no state has shown yet [s]; None if all were shown.
    """

    def __init__(self) -> None:
        self.since: float | None = None
        self._sent: deque[tuple[float, Array]] = deque(maxlen=100)

    def sent(self, now: float, positions: Array) -> None:
        """Take a command that went out at a time [s], positions (n,) [rad]."""
        self._sent.append((now, positions))
        self.since = now if self.since is None else self.since

    def shown(self, stamp: float, desired: Array) -> None:
        """Take what the controller wants at a time [s], (n,) [rad]."""
        found = [i for i, (_, at) in enumerate(self._sent) if np.abs(at - desired).max() <= TOLERANCE_RAD]
        if found:
            for _ in range(found[-1]):
                self._sent.popleft()
            self.since = self._sent[1][0] if len(self._sent) > 1 else None
        elif self._sent and self.since is None and stamp > self._sent[-1][0]:  # another program has commanded it
            self.since = stamp


class HandClock:
    """Converts times of the hand's computer to the station's; nobody sets the two clocks by each other.

    The reading that came fastest is taken for one that took no time: what the fastest way takes is not known, and not
    counted. Every other reading is as old as it came later than that.
    """

    def __init__(self) -> None:
        self._offset, self._at = math.inf, 0.0

    def station_time(self, stamp: float, received: float) -> float:
        """Time of the station [s] for a time of the hand's computer, of a message received at a station's time."""
        drifted = self._offset + DRIFT * max(0.0, received - self._at)
        self._offset, self._at = min(drifted, received - stamp), max(self._at, received)
        return min(stamp + self._offset, received)


@dataclass(frozen=True)
class Told:
    """What the hand has said."""

    stamp: float
    """Time at which the joints were read, by the station's clock [s]."""
    position: Array
    """Positions of JOINTS as the maker counts them, (24,) [rad]."""
    effort: Array
    """Their efforts, (24,) [the difference of the motor's strain gauges, in counts]."""
    motors: Mapping[str, MotorStatus]
    """Newest state of each motor that the hand speaks of."""
    motors_age: float
    """Time since the hand has spoken of its motors [s]."""
    unshown: float | None
    """Time before `stamp` since which a command is not shown by the controllers' states [s]; None if all are."""


class RosbridgeLine:
    """The hand behind a rosbridge; one thread may use it.

    Args:
        url: Address of the rosbridge, such as `ws://127.0.0.1:9090`.
        clock: The station's clock.

    Attributes:
        counts: What happened on the line: requests are commands, and unanswered are the readings that did not come.

    Raises:
        ConfigError: It is no such address.
        NoAnswerError: Nobody answers there.
    """

    def __init__(self, url: str, clock: Clock) -> None:
        self.counts = LineCounts()
        self._url, self._clock = url, clock
        self._newest, self._hand_clock = -math.inf, HandClock()
        self._acknowledged = {controller: Acknowledgement() for controller in CONTROLLERS}
        self._heard: set[str] = set()
        self._motors: dict[str, MotorStatus] = {}
        self._motors_at, self._notice = -math.inf, ""
        self._problem: ProtocolError | None = None
        try:
            self._socket = connect(
                url, open_timeout=OPEN_S, close_timeout=0.2, ping_interval=None, compression=None, proxy=None,
                max_size=LARGEST,
            )  # fmt: skip
        except InvalidURI as error:
            message = f"hand.port is {url!r}: give the address of a rosbridge, ws://HOST:9090"
            raise ConfigError(message, code="config.hand_port") from error
        except (OSError, InvalidHandshake, EOFError) as error:
            message = f"no rosbridge answers at {url}: {words_of(error)}; check hand.port, the network, and that"
            message += " rosbridge_websocket runs beside the hand"
            raise NoAnswerError(message) from error
        try:
            for controller in CONTROLLERS:
                self._send(op="advertise", topic=f"{controller}/command", type="trajectory_msgs/JointTrajectory")
            for topic, kind in TYPES.items():  # a queue of one, so that a slow line brings no old messages
                self._send(op="subscribe", topic=topic, type=kind, throttle_rate=0, queue_length=1)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Take leave; the hand stays as it is."""
        with suppress(OSError):
            self._socket.close()

    def find(self) -> Told:
        """Wait until every topic has said something, and return what.

        Raises:
            NoAnswerError: A topic says nothing, or the connection is gone.
            ProtocolError: What answers is no Shadow Hand.
        """
        end, late = time.monotonic() + FIND_S, False
        while not late:
            late = time.monotonic() >= end  # asked first, so that a process that was held up looks once more
            told = self._take(ANSWER_S)
            if told is not None and self._heard.issuperset(TYPES):
                return told
        if self._problem is not None and not self._heard.issuperset(TYPES):
            raise self._problem
        lacking = ", ".join(sorted(set(TYPES) - self._heard)) or "new joint states"
        said = f"; rosbridge says: {self._notice}" if self._notice else ""
        message = f"no right Shadow Hand answers at {self._url}: there is no {lacking}{said}; see that the"
        raise NoAnswerError(f"{message} hand is on and its trajectory controllers run", code="no_answer.hand_silent")

    def read(self) -> Told:
        """Wait for the next reading, for ANSWER_S at most.

        Raises:
            NoAnswerError: None came, or the connection is gone.
        """
        end = time.monotonic() + ANSWER_S
        left = ANSWER_S
        while left > 0.0:
            left = end - time.monotonic()
            if (told := self._take(max(left, 0.0))) is not None:
                return told
        self.counts.unanswered += 1
        message = f"the hand behind {self._url} says nothing new: check its power and the network"
        raise NoAnswerError(message, code="no_answer.hand_silent")

    def command(self, positions: Array) -> None:
        """Send the joints to positions, (24,) as the maker counts them [rad], from where the controllers want them.

        Raises:
            NoAnswerError: The connection is gone.
        """
        now = self._clock.now()
        for controller, part in CONTROLLERS.items():
            # Without velocities the controller goes there on a straight line.
            point = {
                "positions": positions[part].round(6).tolist(), "velocities": [], "accelerations": [], "effort": [],
                "time_from_start": {"secs": 0, "nsecs": STEP_NS},
            }  # fmt: skip
            header = {"stamp": {"secs": 0, "nsecs": 0}, "frame_id": ""}
            message = {"header": header, "joint_names": JOINTS[part], "points": [point]}
            self._send(op="publish", topic=f"{controller}/command", msg=message)
            self._acknowledged[controller].sent(now, positions[part])
            self.counts.requests += 1

    def _send(self, **operation: object) -> None:
        try:
            self._socket.send(json.dumps(operation, allow_nan=False))
        except (ConnectionClosed, OSError) as error:
            raise self._gone(error) from error

    def _take(self, within: float) -> Told | None:
        """What came; the newest reading in it, or None if there was none."""
        found: tuple[float, Array, Array] | None = None
        try:
            while True:
                found = self._hear(self._socket.recv(timeout=within, decode=False)) or found
                within = 0.0
        except TimeoutError:
            pass
        except (ConnectionClosed, OSError) as error:
            if found is None:
                raise self._gone(error) from error
        if found is None:
            return None
        taken, position, effort = found
        now = self._clock.now()
        stamp = self._hand_clock.station_time(taken, now)
        waiting = [acknowledged.since for acknowledged in self._acknowledged.values() if acknowledged.since is not None]
        unshown = max(0.0, stamp - min(waiting)) if waiting else None
        return Told(stamp, position, effort, dict(self._motors), now - self._motors_at, unshown)

    def _hear(self, data: str | bytes) -> tuple[float, Array, Array] | None:
        """Stamp, positions and efforts of a message with the joints' newest state."""
        try:
            said = json.loads(data)
            if said["op"] == "status":
                self._notice = str(said.get("msg"))
            return self._read(said["topic"], said["msg"]) if said["op"] == "publish" else None
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            message = f"rosbridge sent what no right Shadow Hand of ROS 1 says: {words_of(error)}"
            self._problem = ProtocolError(message, code="protocol.rosbridge")
            self.counts.corrupt += 1
            return None

    def _read(self, topic: str, message: dict[str, Any]) -> tuple[float, Array, Array] | None:
        controller = topic.removesuffix("/state")
        if topic == JOINT_STATES:
            if set(JOINTS).isdisjoint(message["name"]):  # another robot's
                return None
            position, effort = (in_order(message["name"], message[kind], JOINTS) for kind in ("position", "effort"))
            at = message["header"]["stamp"]  # of ROS 1: ROS 2 calls the fields sec and nanosec
            stamp = float(at["secs"] + 1e-9 * at["nsecs"])
            if stamp <= self._newest:
                self.counts.late += 1
                return None
            self._newest = stamp
            self._heard.add(topic)
            return stamp, position, effort
        if topic == DIAGNOSTICS:
            named = {status["name"].removeprefix(MOTOR): status for status in message["status"]}
            if motors := {name: motor_status(name, status) for name, status in named.items() if name in MOTORS}:
                self._motors |= motors
                self._motors_at = self._clock.now()
                self._heard.add(topic)
        elif controller in CONTROLLERS and controller != topic:
            joints = JOINTS[CONTROLLERS[controller]]
            desired = in_order(message["joint_names"], message["desired"]["positions"], joints)
            self._acknowledged[controller].shown(self._clock.now(), desired)
            self._heard.add(topic)
        return None

    def _gone(self, error: Exception) -> DeviceError:
        message = f"the connection to the hand at {self._url} is gone ({words_of(error)}): see that rosbridge and"
        return NoAnswerError(f"{message} the hand run, then start again", code=UNPLUGGED)

"""The line to the hand: what its topics say, put together, and commands to its controllers."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from toolee_robot.devices.hands.shadow import messages, rosbridge
from toolee_robot.devices.hands.shadow.acknowledgement import Acknowledgement
from toolee_robot.devices.hands.shadow.connection import Connection
from toolee_robot.devices.hands.shadow.freshness import Freshness, HandClock
from toolee_robot.devices.hands.shadow.messages import JointStates
from toolee_robot.devices.hands.shadow.motors import MotorStatus
from toolee_robot.devices.hands.wire.counts import LineCounts
from toolee_robot.errors import NoAnswerError, ProtocolError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock
from toolee_robot.robots import SHADOW_HAND

ANSWER_TIME = 0.03
"""Longest wait for a reading [s]; one comes every 8 ms (user guide: 125 Hz)."""
FIND_TIME = 3.0
"""Longest wait for the first message of every topic [s]; diagnostics come twice a second."""
STEP = 0.02
"""Time in which the controllers go to a commanded position [s]."""
JOINTS = SHADOW_HAND.joints
"""The joints in the order of all arrays here, wrist first."""
CONTROLLERS = {messages.WRIST: slice(0, 2), messages.FINGERS: slice(2, len(JOINTS))}
"""Controller -> its joints among JOINTS."""


@dataclass(frozen=True)
class Told:
    """What the hand has said."""

    stamp: float
    """Time at which the joints were read, by the station's clock [s]."""
    joints: JointStates
    """The joints' states in the order of JOINTS, as the maker counts them."""
    motors: Mapping[str, MotorStatus]
    """Newest state of each motor that the hand speaks of."""
    motors_age: float
    """Time since the hand has spoken of its motors [s]."""
    unshown: float | None
    """Time before `stamp` since which a command is not shown by the controllers' states [s]; None if all are."""


class HandLine:
    """The hand behind a rosbridge; one thread may use it.

    Args:
        url: Address of the rosbridge.
        clock: The station's clock.

    Attributes:
        counts: What happened on the line: requests are commands, and unanswered are the readings that did not come.

    Raises:
        ConfigError: It is no such address.
        NoAnswerError: Nobody answers there.
    """

    def __init__(self, url: str, clock: Clock) -> None:
        self.counts = LineCounts()
        self._clock = clock
        self._fresh, self._hand_clock = Freshness(self.counts), HandClock()
        self._acknowledged = {controller: Acknowledgement() for controller in CONTROLLERS}
        self._heard: set[str] = set()
        self._motors: dict[str, MotorStatus] = {}
        self._motors_at = -np.inf
        self._problem: ProtocolError | None = None
        self._notice = ""
        self._connection = Connection(url)
        try:
            for controller in CONTROLLERS:
                self._connection.send(rosbridge.advertise(f"{controller}/command", messages.COMMAND))
                self._connection.send(rosbridge.subscribe(f"{controller}/state", messages.STATE))
            self._connection.send(rosbridge.subscribe(messages.JOINT_STATES, messages.JOINT_STATE))
            self._connection.send(rosbridge.subscribe(messages.DIAGNOSTICS, messages.DIAGNOSTIC))
        except BaseException:
            self._connection.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Take leave; the hand stays as it is."""
        self._connection.close()

    def find(self) -> Told:
        """Wait until every topic has said something.

        Returns:
            What they say.

        Raises:
            NoAnswerError: A topic says nothing, or the connection is gone.
            ProtocolError: What answers is no Shadow Hand.
        """
        end = time.monotonic() + FIND_TIME
        wanted = {messages.JOINT_STATES, messages.DIAGNOSTICS, *(f"{controller}/state" for controller in CONTROLLERS)}
        while time.monotonic() < end:
            told = self._take(ANSWER_TIME)
            if told is not None and wanted <= self._heard:
                return told
        if self._problem is not None and not wanted <= self._heard:
            raise self._problem
        lacking = ", ".join(sorted(wanted - self._heard)) or "new joint states"
        said = f"; rosbridge says: {self._notice}" if self._notice else ""
        message = f"no right Shadow Hand answers at {self._connection.url}: there is no {lacking}{said}; see that the"
        raise NoAnswerError(f"{message} hand is on and its trajectory controllers run", code="no_answer.hand_silent")

    def read(self) -> Told:
        """Wait for the next reading, for ANSWER_TIME at most.

        Returns:
            The newest one.

        Raises:
            NoAnswerError: None came, or the connection is gone.
        """
        end = time.monotonic() + ANSWER_TIME
        while True:
            told = self._take(max(0.0, end - time.monotonic()))
            if told is not None:
                return told
            if time.monotonic() >= end:
                self.counts.unanswered += 1
                message = f"the hand behind {self._connection.url} says nothing new: check its power and the network"
                raise NoAnswerError(message, code="no_answer.hand_silent")

    def command(self, positions: Array) -> None:
        """Send the joints to positions, from where the controllers want them to be, in STEP.

        Args:
            positions: In the order of JOINTS as the maker counts them, (24,) [rad].

        Raises:
            NoAnswerError: The connection is gone.
        """
        now = self._clock.now()
        for controller, part in CONTROLLERS.items():
            message = messages.trajectory(JOINTS[part], positions[part], STEP)
            self._connection.send(rosbridge.publish(f"{controller}/command", message))
            self._acknowledged[controller].sent(now, positions[part])
            self.counts.requests += 1

    def _take(self, within: float) -> Told | None:
        """What came; the newest reading in it, or None if there was none."""
        found: JointStates | None = None
        for data in self._connection.receive(within):
            try:
                found = self._hear(data) or found
            except ProtocolError as error:
                self._problem = error
                self.counts.corrupt += 1
        if found is None:
            return None
        now = self._clock.now()
        stamp = self._hand_clock.station_time(found.stamp, now)
        waiting = [acknowledged.since for acknowledged in self._acknowledged.values() if acknowledged.since is not None]
        unshown = max(0.0, stamp - min(waiting)) if waiting else None
        return Told(stamp, found, dict(self._motors), now - self._motors_at, unshown)

    def _hear(self, data: bytes) -> JointStates | None:
        said = rosbridge.decode(data)
        if isinstance(said, rosbridge.Notice):
            self._notice = said.text
        elif isinstance(said, rosbridge.Publication):
            return self._read(said)
        return None

    def _read(self, said: rosbridge.Publication) -> JointStates | None:
        controller = said.topic.removesuffix("/state")
        if said.topic == messages.JOINT_STATES:
            states = messages.joint_states(said.message, JOINTS)
            if states is None or not self._fresh.admit(states):
                return None
            self._heard.add(said.topic)
            return states
        if said.topic == messages.DIAGNOSTICS:
            motors = messages.motor_statuses(said.message)
            if motors:
                self._motors |= motors
                self._motors_at = self._clock.now()
                self._heard.add(said.topic)
        elif controller != said.topic and controller in CONTROLLERS:
            state = messages.controller_state(said.message, JOINTS[CONTROLLERS[controller]])
            self._acknowledged[controller].shown(self._clock.now(), state.desired)
            self._heard.add(said.topic)
        return None

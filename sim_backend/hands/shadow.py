"""Emulator of a right Shadow Dexterous Hand and of the rosbridge beside it, for drivers that speak rosbridge v2.0.

    with ShadowEmulator() as emulator:
        emulator.hold(55)                               # a handle, met by the knuckles at 55 deg
        websockets.sync.client.connect(emulator.port)   # a driver's side

It is written from the rosbridge protocol, from the maker's documentation and source code for ROS 1, and from that of
ros_controllers, not from the project's driver, with which it shares no code. What it does is

- published: the operations with their fields, that text which is no JSON is passed over in silence, errors as `status`;
  topics, types, names and rates of the messages (125, 50 and 2 Hz), their fields and values, the ranges of the joints
  and the speeds of the maker's description, that joints 1 and 2 of a finger have one motor and report its effort each,
  that a controller takes trajectories of all its joints only and drops points in the past, that an empty one stops it,
  the largest force demand of 1023, the halt of a motor above 60 deg C and by a broken bridge, the names of the flags;
- assumed: how stiff what it holds is, the gain between a position's error and the effort, friction, noise, currents,
  20 ms until a motor follows, that two coupled joints bend alike, that a halted motor lets go of its force and has
  cooled at 55 deg C, that velocities in a trajectory make no difference, the efforts' offsets, the clock's offset, how
  the hand stands when it is switched on.

Not there: services, actions, fragments, PNG and CBOR, `throttle_rate`; several points in a trajectory; the tactile
sensors; the other modes of control.
"""

from __future__ import annotations

import heapq
import json
import math
import random
import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from toolee_robot.robots.hands.shadow import joints_of_motors
from toolee_robot.sim_backend.hands.kit import (
    Address,
    EmulatedHand,
    HandEmulator,
    HandTime,
    LineFaults,
    Motor,
    listener,
)
from toolee_robot.station import HandConfig

_FINGERS = ("FF", "MF", "RF", "LF")
JOINTS = (
    *(f"{finger}J{joint}" for finger in _FINGERS for joint in ((1, 2, 3, 4, 5) if finger == "LF" else (1, 2, 3, 4))),
    *("THJ1", "THJ2", "THJ3", "THJ4", "THJ5", "WRJ1", "WRJ2"),
)
"""The joints; joints 1 and 2 of a finger hang on motor 0."""
_RANGES = {"J3": (-15.0, 90.0), "J0": (0.0, 180.0), "J4": (-20.0, 20.0)}
RANGES = {f"{finger}{joint}": ends for finger in _FINGERS for joint, ends in _RANGES.items()} | {
    "LFJ5": (0.0, 45.0), "THJ5": (-60.0, 60.0), "THJ4": (0.0, 70.0), "THJ3": (-12.0, 12.0), "THJ2": (-40.0, 40.0),
    "THJ1": (-15.0, 90.0), "WRJ2": (-30.0, 10.0), "WRJ1": (-40.0, 28.0),
}  # fmt: skip
"""The motors, the joint that meets a handle first before the others, and the ends of their ranges [deg]: published."""
NAMES = tuple(RANGES)
FASTEST = math.degrees(2.0)
"""Fastest speed of a finger's joint [deg/s]: of the maker's description; the thumb's are twice as fast, and a motor of
two joints moves both."""
FINGERS = {
    **{
        finger: (f"{prefix}J3", f"{prefix}J0")
        for finger, prefix in zip(("index", "middle", "ring", "little"), _FINGERS, strict=True)
    },
    "thumb": ("THJ5", "THJ2", "THJ1"),
}  # fmt: skip
"""Finger -> motors that close it."""
NOISE, EFFORT_NOISE = 2e-4, 1.5
"""Standard deviations of a position [rad] and of an effort [counts]: assumed, of the order of the maker's examples."""
OFFSET = 4.0
"""Largest effort that a motor reports at rest [counts]: assumed."""
GAIN = 25.0
"""Speed by the way that is left [1/s]: assumed."""
PULL = 40.0
"""Effort by the way that is left [counts/deg]: assumed; the tuning of every hand is its own."""
MOST = 1023.0
"""Largest force demand [counts]: published, the default of `max_force`."""
STIFFNESS = 400.0
"""Effort by the way that a finger has pressed into what it holds [counts/deg]: assumed."""
FRICTION = 12.0
"""Effort of a finger that moves freely [counts]: assumed."""
HOT, COOL = 60.0, 55.0
"""Temperatures at which the firmware halts a motor: published; and at which it works again: assumed [deg C]."""
EPOCH = 1528812878.0
"""Time of the hand's computer when it began [s]: that of the maker's example."""
BURST = 24
"""Bytes that a damaged message has others of: where TCP fails, it fails for a stretch."""
FINGERS_TOPIC, WRIST_TOPIC = "/rh_trajectory_controller", "/rh_wr_trajectory_controller"
JOINT_STATES, DIAGNOSTICS = "/joint_states", "/diagnostics"
TYPES = {
    JOINT_STATES: "sensor_msgs/JointState",
    DIAGNOSTICS: "diagnostic_msgs/DiagnosticArray",
    **{f"{name}/state": "control_msgs/JointTrajectoryControllerState" for name in (FINGERS_TOPIC, WRIST_TOPIC)},
    **{f"{name}/command": "trajectory_msgs/JointTrajectory" for name in (FINGERS_TOPIC, WRIST_TOPIC)},
}
"""Topic -> its type."""
PERIODS_S = {JOINT_STATES: 1 / 125, f"{FINGERS_TOPIC}/state": 1 / 50, f"{WRIST_TOPIC}/state": 1 / 50, DIAGNOSTICS: 0.5}
"""Topic that the hand publishes -> time between two messages: published."""


@dataclass
class ShadowMotor(Motor):
    """One of the twenty motors: a position controller that pulls on tendons [deg].

    Attributes:
        reaction: See `Motor`: assumed.
        target: See `Motor`.
        temperature: See `Motor`.
        name: Its joint's name, such as "FFJ0".
        low: Lower end of its range.
        high: Upper end.
        fastest: Its fastest speed [deg/s].
        halted: Whether its firmware has halted it.
        velocity: How fast it moves [deg/s].
    """

    reaction: ClassVar[float] = 0.02
    target: float | None = 0.0
    temperature: float = 32.0
    name: str = ""
    low: float = 0.0
    high: float = 0.0
    fastest: float = FASTEST
    bridge_fault: bool = False
    """Fault of its electronics: it is halted."""
    halted: bool = False
    velocity: float = 0.0

    @property
    def pressed(self) -> float:
        """Effort with which its finger presses on what it holds [counts]."""
        return 0.0 if self.met_at is None else max(0.0, STIFFNESS * (self.position - self.met_at))

    @property
    def effort(self) -> float:
        """What its strain gauges say, without offset and noise [counts]."""
        if self.halted:
            return 0.0
        if self.jammed:
            return min(max(PULL * ((self.target or 0.0) - self.position), -MOST), MOST)
        return self.pressed or FRICTION * ((self.velocity > 0.0) - (self.velocity < 0.0))

    def demand(self, position: float, now: float) -> None:
        """Take a position demand at a time [s], which the motor heeds later."""
        if not self.orders or self.orders[-1][1] != position:
            self.go(min(max(position, self.low), self.high), now)

    def move(self, now: float, step: float) -> None:  # noqa: ARG002
        """Pull towards the demand, as far as what it holds lets it."""
        self.halted = self.bridge_fault or self.temperature > HOT or (self.halted and self.temperature > COOL)
        self.velocity = 0.0
        if self.jammed:
            return
        target = self.position if self.halted or self.target is None else self.target
        if self.met_at is not None and max(target, self.position) > self.met_at:
            if self.halted:  # nothing pulls: what it holds pushes it back
                target = self.met_at
            elif target > self.met_at:
                target = (PULL * target + STIFFNESS * self.met_at) / (PULL + STIFFNESS)
                target = min(target, self.met_at + MOST / STIFFNESS)
        way = target - self.position
        if abs(way) >= 1e-3:
            self.velocity = min(max(GAIN * way, -self.fastest), self.fastest)
            self.position += max(min(self.velocity * step, abs(way)), -abs(way))


class Controller:
    """A joint trajectory controller of ros_controllers, as far as its topics `command` and `state` go.

    Args:
        joints: Its joints, in its own order.

    Attributes:
        joints: Its joints.
        running: Whether it runs: one that is stopped publishes its state and takes no commands.
        refused: Commands that it has refused; nobody is told but the log of the hand's computer.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        self.joints, self.running, self.refused = tuple(joints), True, 0
        self._from = self._to = (0.0, (0.0,) * len(joints))

    def desired(self, now: float) -> tuple[float, ...]:
        """Where it wants its joints to be at a time [s], in the order of `joints` [rad]: on a straight line."""
        (began, a), (end, b) = self._from, self._to
        share = 1.0 if now >= end else max(0.0, now - began) / (end - began)
        return tuple(x + share * (y - x) for x, y in zip(a, b, strict=True))

    def command(self, message: dict[str, Any], now: float) -> None:
        """Take a trajectory_msgs/JointTrajectory at a time [s], with one point or none."""
        points, names = message.get("points") or [], message.get("joint_names") or []
        if not self.running or (points and sorted(names) != sorted(self.joints)):
            self.refused += 1
            return
        goal = (now, self.desired(now))
        if points:
            after, positions = points[-1]["time_from_start"], dict(zip(names, points[-1]["positions"], strict=True))
            end = now + after["secs"] + 1e-9 * after["nsecs"]
            goal = (end, tuple(float(positions[joint]) for joint in self.joints))
            if end <= now:
                self.refused += 1
                return
        self._from, self._to = (now, self.desired(now)), goal


class Hand(EmulatedHand[ShadowMotor]):
    """The hand beside the rosbridge, on the clock of its computer [s]; noise is of the seed."""

    def __init__(self, clock: Callable[[], float], seed: int = 0) -> None:
        twice = {name for name in NAMES if name.endswith("J0") or name.startswith("TH")}
        motors = [
            ShadowMotor(name=name, low=low, high=high, fastest=(1.0 + (name in twice)) * FASTEST)
            for name, (low, high) in RANGES.items()
        ]
        super().__init__(clock, motors, [NAMES.index(name) for names in FINGERS.values() for name in names])
        self._chance = random.Random(seed)
        self._rest = {name: self._chance.uniform(-OFFSET, OFFSET) for name in NAMES}
        fingers = [f"rh_{joint}" for joint in JOINTS if not joint.startswith("WR")]
        self.controllers = {FINGERS_TOPIC: Controller(fingers), WRIST_TOPIC: Controller(["rh_WRJ1", "rh_WRJ2"])}

    @property
    def told(self) -> tuple[float, ...]:
        """Where its controllers were told last to bring their joints [rad]."""
        return tuple(angle for one in self.controllers.values() for angle in one.desired(math.inf))

    def motor(self, name: str) -> ShadowMotor:
        """One of the motors."""
        return self.motors[NAMES.index(name)]

    def hold(self, met_at: float | None) -> None:
        """Put something into the hand that the knuckles meet at this angle [deg], 0 to 90, or take it out.

        Every other motor that closes a finger meets it at the same share of its range.
        """
        self.run()
        for motor in (self.motors[index] for index in self._pressing):
            low = motor.low if motor.name == "THJ5" else 0.0
            motor.met_at = None if met_at is None else low + (motor.high - low) * met_at / 90.0

    def before_step(self) -> None:
        """The controllers' demands."""
        wanted: dict[str, float] = {}
        for controller in self.controllers.values():
            if controller.running:
                for joint, angle in zip(controller.joints, controller.desired(self.now), strict=True):
                    name = _motor_of(joint)
                    wanted[name] = wanted.get(name, 0.0) + math.degrees(angle)
        for name, angle in wanted.items():
            self.motor(name).demand(angle, self.now)

    def command(self, controller: str, message: dict[str, Any]) -> None:
        """Let a controller take a trajectory."""
        self.run()
        self.controllers[controller].command(message, self.now)

    def message(self, topic: str, sequence: int) -> dict[str, Any]:
        """The message of a topic that the hand publishes, as it is now."""
        self.run()
        secs, nsecs = divmod(round((EPOCH + self.now) * 1e9), 10**9)
        header = {"seq": sequence, "stamp": {"secs": secs, "nsecs": nsecs}, "frame_id": ""}
        if topic == JOINT_STATES:
            names, positions, velocities, efforts = zip(*map(self._joint, JOINTS), strict=True)
            return {"header": header, "name": names, "position": positions, "velocity": velocities, "effort": efforts}
        if topic == DIAGNOSTICS:
            palm = {"level": 0, "name": "rh EtherCAT Dual CAN Palm", "message": "OK", "hardware_id": "", "values": []}
            return {"header": header, "status": [palm, *map(_status, self.motors)]}
        controller = self.controllers[topic.removesuffix("/state")]
        desired = controller.desired(self.now)
        actual = [self._joint(joint.removeprefix("rh_"))[1] for joint in controller.joints]
        errors = [a - b for a, b in zip(desired, actual, strict=True)]
        points = {"desired": _point(desired), "actual": _point(actual), "error": _point(errors)}
        return {"header": header, "joint_names": controller.joints} | points

    def _joint(self, joint: str) -> tuple[str, float, float, float]:
        """Name, position [rad], velocity [rad/s] and effort [counts] of a joint, with noise."""
        motor, noise = self.motor(_motor_of(joint)), self._chance.gauss
        share = math.radians(0.5 if motor.name.endswith("J0") else 1.0)
        effort = motor.effort + self._rest[motor.name] + noise(0.0, EFFORT_NOISE)
        position, velocity = share * motor.position + noise(0.0, NOISE), share * motor.velocity + noise(0.0, 10 * NOISE)
        return f"rh_{joint}", position, velocity, effort


def _motor_of(joint: str) -> str:
    name = joint.removeprefix("rh_")
    return f"{name[:2]}J0" if name[2:] in ("J1", "J2") and name[:2] in _FINGERS else name


def _point(positions: Sequence[float]) -> dict[str, Any]:
    zeros = [0.0] * len(positions)
    time_from_start = {"secs": 0, "nsecs": 0}
    return {"positions": positions, "velocities": zeros, "accelerations": zeros, "effort": [],
            "time_from_start": time_from_start}  # fmt: skip


def _status(motor: ShadowMotor) -> dict[str, Any]:
    """A motor's status, as `add_diagnostics` in `sr_motor_robot_lib.cpp` writes it."""
    flags = ["A3950 H-bridge nFault asserted"] if motor.bridge_fault else []
    if motor.halted and motor.temperature > COOL:
        flags.append("Motor over temperature")
    said = "".join(f"{flag} | " for flag in flags)
    values = {"Motor ID": f"{NAMES.index(motor.name)}", "Motor Flags": said or " None",
              "Measured Current": f"{abs(motor.effort) * 0.0004:f}", "Measured Effort": f"{motor.effort:f}",
              "Temperature": f"{motor.temperature:f}"}  # fmt: skip
    return {
        "level": 2 if flags else 0, "name": f"rh SRDMotor {motor.name}", "message": said or "OK", "hardware_id": "",
        "values": [{"key": key, "value": value} for key, value in values.items()],
    }  # fmt: skip


class ShadowEmulator(HandEmulator[Hand]):
    """A right Shadow Hand that a driver finds at `port`, the address of a rosbridge.

    Args:
        seed: Seed of the noise.
        pace: Rate of the hand's time relative to the host's, its clock included; messages come at the host's.
        address: Host and port at which the rosbridge listens; port 0 for a free one.

    Raises:
        UserError: It cannot listen there.
    """

    label = "Shadow Dexterous Hand (right) behind a rosbridge"
    most = 90.0
    motors, fingers = NAMES, FINGERS
    joints = staticmethod(joints_of_motors)
    events = (
        "heat MOTOR DEGREES, heat DEGREES, jam MOTOR, free MOTOR, break MOTOR, repair MOTOR, "
        "controllers off, controllers on, diagnostics off, diagnostics on"
    )

    def __init__(self, seed: int = 0, pace: float = 1.0, address: Address = ("127.0.0.1", 0)) -> None:
        clock = HandTime(pace)
        super().__init__(Hand(clock, seed), LineFaults(_of_the_left_hand, seed, burst=BURST), clock)
        bound = listener(address)
        host, port = bound.getsockname()[:2]
        self.port = f"ws://{host}:{port}"
        self._clients: dict[ServerConnection, set[str]] = {}
        self._diagnoses = True
        self._server = serve(self._converse, sock=bound, compression=None, ping_interval=None, close_timeout=0.1)

    def happen(self, event: str, motor: int | None, *words: str) -> None:
        """See `HandEmulator.happen`."""
        if event in ("break", "repair") and motor is not None and not words:
            self.change(motor, "bridge_fault", event == "break")
        elif event in ("controllers", "diagnostics") and motor is None and words in (("on",), ("off",)):
            if event == "diagnostics":
                self._diagnoses = words == ("on",)
            else:
                for controller in self._hand.controllers.values():
                    controller.running = words == ("on",)
        else:
            super().happen(event, motor, *words)

    def take(self, data: str | bytes, subscribed: set[str]) -> dict[str, Any] | None:
        """Carry out a client's operation; return the one that answers it. Text that is no JSON is passed over."""
        try:
            said = json.loads(data)
        except (ValueError, RecursionError):
            return None
        try:
            problem = self._carry_out(said, subscribed)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            problem = f"{said}: {error!r}"
        if not problem:
            return None
        identity = {"id": said["id"]} if isinstance(said, dict) and "id" in said else {}
        return {"op": "status", "level": "error", "msg": problem} | identity

    def _carry_out(self, said: dict[str, Any], subscribed: set[str]) -> str:
        op, topic = said["op"], said.get("topic", "")
        if op in ("subscribe", "advertise") and topic in TYPES and said.get("type", TYPES[topic]) != TYPES[topic]:
            return f"{op}: {topic} has the type {TYPES[topic]}, not {said['type']}"
        if op == "subscribe":
            subscribed.add(topic)
        elif op == "publish" and topic not in TYPES:
            return f"publish: cannot infer topic type for topic {topic} as it is not yet advertised"
        elif op == "publish" and topic.endswith("/command"):
            self.tell(lambda hand: hand.command(topic.removesuffix("/command"), said["msg"]))
        elif op not in ("advertise", "publish", "set_level"):
            return f"Unknown operation: {op}."
        return ""

    def _converse(self, client: ServerConnection) -> None:
        """Carry out what a client asks for; in a thread of its own."""
        subscribed = self._clients[client] = set()
        try:
            for data in client:
                answer = self.take(data, subscribed)
                if answer is not None:
                    client.send(json.dumps(answer))
                if self.faults.echo:
                    client.send(data)
        except ConnectionClosed:
            pass
        finally:
            self._clients.pop(client, None)

    def _run(self) -> None:
        serving = threading.Thread(target=self._server.serve_forever, name="rosbridge", daemon=True)
        serving.start()
        due, number = dict.fromkeys(PERIODS_S, time.monotonic()), 0
        late: list[tuple[float, int, ServerConnection, bytes]] = []
        while not self._over:
            now = time.monotonic()
            for topic in [topic for topic, at in due.items() if at <= now]:
                due[topic] = max(due[topic] + PERIODS_S[topic], now - PERIODS_S[topic])
                clients = [client for client, topics in [*self._clients.items()] if topic in topics]
                if not clients or (topic == DIAGNOSTICS and not self._diagnoses):
                    continue
                number += 1
                said = self.tell(partial(Hand.message, topic=topic, sequence=number))
                data = json.dumps({"op": "publish", "topic": topic, "msg": said}).encode()
                for client in clients:
                    for piece, delay in self.faults.on_the_way(data):
                        number += 1
                        heapq.heappush(late, (now + delay, number, client, piece))
            while late and late[0][0] <= now:
                with suppress(ConnectionClosed, OSError):
                    late[0][2].send(late[0][3], text=True)
                heapq.heappop(late)
            next_at = min([*due.values(), *(at for at, *_ in late[:1])])
            time.sleep(max(0.0, next_at - time.monotonic()))
        for client in [*self._clients]:
            with suppress(OSError):
                client.socket.shutdown(socket.SHUT_RDWR)
        self._server.shutdown()
        serving.join()


def _of_the_left_hand(data: bytes) -> bytes:
    """The same message of a left hand on the same computer."""
    return data.replace(b"rh_", b"lh_").replace(b"rh SRD", b"lh SRD")


def emulate(_: HandConfig, listen: Address, seed: int, pace: float) -> HandEmulator[Hand]:
    """Build the emulator of a station's hand."""
    return ShadowEmulator(seed, pace, listen)

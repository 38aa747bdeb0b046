"""What a Shadow Hand says by rosbridge: the maker's own examples, what is refused, two clocks, and lost commands."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.devices.hands.recorded_shadow import (
    COMMANDED,
    CONTROLLED,
    DESIRED,
    EFFORTS,
    NAMES,
    POSITIONS,
    controller_state,
    diagnostics,
    joint_states,
    publication,
)
from tests.errors import raises
from toolee_robot.devices.hands import rosbridge
from toolee_robot.devices.hands.rosbridge import (
    CONTROLLERS,
    JOINTS,
    Acknowledgement,
    HandClock,
    RosbridgeLine,
    Told,
    in_order,
)
from toolee_robot.devices.hands.shadow import reading_of
from toolee_robot.errors import NoAnswerError, ProtocolError
from toolee_robot.runtime.clock import HostClock

FINGERS = JOINTS[CONTROLLERS["/rh_trajectory_controller"]]


class Socket:
    """A websocket on which what is put is received."""

    def __init__(self) -> None:
        self.waiting: list[bytes] = []
        self.sent: list[dict[str, Any]] = []

    def send(self, text: str) -> None:
        self.sent.append(json.loads(text))

    def recv(self, timeout: float, decode: bool) -> bytes:  # noqa: ARG002
        if not self.waiting:
            raise TimeoutError
        return self.waiting.pop(0)

    def close(self) -> None:
        pass


@pytest.fixture
def socket(monkeypatch: pytest.MonkeyPatch) -> Socket:
    socket = Socket()
    monkeypatch.setattr(rosbridge, "connect", lambda *_, **__: socket)
    monkeypatch.setattr(rosbridge, "ANSWER_S", 0.01)
    monkeypatch.setattr(rosbridge, "FIND_S", 0.05)
    return socket


@pytest.fixture
def line(socket: Socket) -> RosbridgeLine:  # noqa: ARG001
    return RosbridgeLine("ws://hand", HostClock())


def hears(line: RosbridgeLine, socket: Socket, *texts: bytes) -> Told:
    """Let messages come, and then the joints' state, which is read."""
    socket.waiting += [*texts, joint_states(nsecs=line.counts.requests + 10**6 * (1 + len(socket.sent)))]
    socket.sent.append({})
    return line.read()


def test_the_makers_published_joint_states_are_understood(line: RosbridgeLine, socket: Socket) -> None:
    told = hears(line, socket)
    for values, expected in ((told.position, POSITIONS), (told.effort, EFFORTS)):
        by_name = dict(zip(JOINTS, values, strict=True))
        assert [by_name[name] for name in NAMES] == expected


def test_the_makers_published_controller_state_shows_a_command(line: RosbridgeLine, socket: Socket) -> None:
    command = np.zeros(24)
    command[CONTROLLERS["/rh_trajectory_controller"]] = in_order(CONTROLLED, DESIRED, FINGERS)
    line.command(command)
    assert hears(line, socket).unshown is not None
    wrist = publication(
        "/rh_wr_trajectory_controller/state",
        {"joint_names": ["rh_WRJ1", "rh_WRJ2"], "desired": {"positions": [0.0, 0.0]}},
    )
    assert hears(line, socket, controller_state(), wrist).unshown is None


def test_the_motors_are_found_among_other_devices(line: RosbridgeLine, socket: Socket) -> None:
    reading = reading_of(hears(line, socket, diagnostics()))
    assert set(reading.said.motors) == {"FFJ0"}
    assert reading.temperature == 34.5625
    assert (reading.trouble, reading.fault) == ("", None)


@pytest.mark.parametrize(
    ("flags", "level", "temperature", "code", "words"),
    [
        ("Motor over temperature | ", 2, "60.250000", "device.hand_over_temperature", "FFJ0: too hot"),
        (" None", 0, "61.000000", "device.hand_over_temperature", "FFJ0: too hot"),
        ("A3950 H-bridge nFault asserted | ", 2, "40.000000", "device.hand_motor", "FFJ0: A3950"),
        ("No demand seen for more than 20ms | ", 2, "40.000000", "device.hand_motor", "FFJ0: No demand"),
        ("Current choke bit 6 | Current choke bit 9 | ", 1, "40.000000", None, ""),
    ],
)
def test_a_motor_that_is_halted_is_a_fault(
    line: RosbridgeLine, socket: Socket, flags: str, level: int, temperature: str, code: str | None, words: str
) -> None:
    reading = reading_of(hears(line, socket, diagnostics(flags, level, temperature)))
    assert (None if reading.fault is None else reading.fault.code) == code
    assert words in reading.trouble


def test_the_command_has_the_fields_of_the_makers_example(line: RosbridgeLine, socket: Socket) -> None:
    positions = np.linspace(0.0, 0.3, len(JOINTS))
    line.command(positions)
    (said,) = [
        one for one in socket.sent if one["op"] == "publish" and one["topic"] == "/rh_trajectory_controller/command"
    ]
    assert said["msg"] == {
        "header": {"stamp": {"secs": 0, "nsecs": 0}, "frame_id": ""},
        "joint_names": list(FINGERS),
        "points": [
            {
                "positions": [round(float(angle), 6) for angle in positions[2:]], "velocities": [],
                "accelerations": [], "effort": [], "time_from_start": {"secs": 0, "nsecs": 20000000},
            }
        ],
    }  # fmt: skip
    assert sorted(FINGERS) == sorted(COMMANDED), "a controller takes all its joints or none"


def test_requests_are_as_the_protocol_says(line: RosbridgeLine, socket: Socket) -> None:
    assert {
        "op": "subscribe", "topic": "/joint_states", "type": "sensor_msgs/JointState", "throttle_rate": 0,
        "queue_length": 1,
    } in socket.sent  # fmt: skip
    assert {
        "op": "advertise", "topic": "/rh_trajectory_controller/command", "type": "trajectory_msgs/JointTrajectory",
    } in socket.sent  # fmt: skip
    with pytest.raises(ValueError, match="not JSON compliant"):
        line.command(np.full(24, np.nan))


@pytest.mark.parametrize(
    "text",
    [
        b'{"op":"png","data":"iVBOR"}', b'{"op":"fragment","id":"1","data":"{","num":0,"total":2}',
        b'{"op":"service_response","service":"/rosapi/topics","result":true}',
        b'{"op":"publish","topic":"/tf","msg":{}}',
        joint_states(name=[name.replace("rh_", "lh_") for name in NAMES]),
        joint_states(name=["ra_elbow_joint"], position=[1.0], velocity=[0.0], effort=[0.0]),
    ],
)  # fmt: skip
def test_what_is_of_others_is_passed_over(line: RosbridgeLine, socket: Socket, text: bytes) -> None:
    socket.waiting.append(text)
    with raises(NoAnswerError, "no_answer.hand_silent"):
        line.read()
    assert line.counts.corrupt == 0


WRONG: list[bytes] = [
    b"", b"\xff\xfe", b"[]", b"{}", b'{"op":"publish"}', b'{"op":"publish","topic":"/joint_states","msg":[]}',
    b"[" * 100_000, joint_states(position=[None, *POSITIONS[1:]]), joint_states(position=["x", *POSITIONS[1:]]),
    joint_states(position=POSITIONS[1:]), joint_states(name=["rh_XXJ1", *NAMES[1:]]),
    joint_states(header={"stamp": {"sec": 1, "nanosec": 2}}), joint_states(header=None),
    joint_states(position=[10**400, *POSITIONS[1:]]), joint_states().replace(b"1.279751244673038", b"1e999"),
    joint_states()[:-9], joint_states() * 2, controller_state(desired=[]),
    controller_state(joint_names=CONTROLLED[1:]), diagnostics(temperature="hot"), diagnostics(temperature="nan"),
    publication("/diagnostics", {"status": [{"name": "rh SRDMotor FFJ0", "level": 0, "message": "OK", "values": [3]}]}),
    publication("/diagnostics", {"status": [{"level": 0}]}), publication("/diagnostics", {"status": None}),
]  # fmt: skip


@pytest.mark.parametrize("text", WRONG, ids=range(len(WRONG)))
def test_what_no_hand_says_is_refused(line: RosbridgeLine, socket: Socket, text: bytes) -> None:
    socket.waiting.append(text)
    with raises(NoAnswerError, "no_answer.hand_silent"):
        line.read()
    assert line.counts.corrupt == 1
    socket.waiting.append(text)
    with raises(ProtocolError, "protocol.rosbridge") as refused:
        line.find()
    assert "ROS 1" in str(refused.value)


def test_a_hand_that_does_not_speak_is_told_with_what_rosbridge_says(line: RosbridgeLine, socket: Socket) -> None:
    socket.waiting.append(b'{"op":"status","level":"error","msg":"no such topic","id":"subscribe:/x"}')
    with raises(NoAnswerError, "no_answer.hand_silent") as silent:
        line.find()
    assert "/diagnostics, /joint_states" in str(silent.value)
    assert "rosbridge says: no such topic" in str(silent.value)


MUTATIONS: dict[str, Callable[[bytes, int, random.Random], bytes]] = {
    "changed": lambda data, at, draw: data[:at] + draw.randbytes(1) + data[at + 1 :],
    "lost": lambda data, at, draw: data[:at] + data[at + draw.randint(1, 12) :],
    "inserted": lambda data, at, draw: data[:at] + draw.randbytes(draw.randint(1, 12)) + data[at:],
    "cut": lambda data, at, _: data[:at],
    "swapped": lambda data, at, draw: data[:at] + data[draw.randrange(len(data)) :][:8] + data[at + 8 :],
}


def test_mutated_messages_are_read_or_refused_and_never_raise(line: RosbridgeLine, socket: Socket) -> None:
    draw = random.Random(31)
    examples = [joint_states(), controller_state(), diagnostics()]
    kinds = [*MUTATIONS.values()]
    for i in range(1_000):
        data = draw.choice(examples)
        socket.waiting.append(kinds[i % len(kinds)](data, draw.randrange(len(data)), draw))
    socket.waiting.append(joint_states(secs=2**60))
    told = line.read()
    assert np.isfinite(told.position).all()
    assert line.counts.corrupt > 200


def test_what_is_late_or_repeated_is_refused(line: RosbridgeLine, socket: Socket) -> None:
    socket.waiting.append(joint_states(nsecs=8_000_000))
    line.read()
    socket.waiting += [joint_states(nsecs=8_000_000), joint_states(nsecs=4_000_000), joint_states(secs=99)]
    with raises(NoAnswerError, "no_answer.hand_silent"):
        line.read()
    assert line.counts.late == 3
    socket.waiting.append(joint_states(nsecs=16_000_000))
    line.read()
    assert line.counts.corrupt == 0


@given(st.floats(-1e9, 1e9), st.lists(st.floats(0.0, 0.5), min_size=1, max_size=30))
@example(0.0, [0.5, 0.125] * 5)  # the clocks drift apart once in a time, however often it seems to pass
def test_a_reading_is_as_old_as_it_came_later_than_the_fastest(offset: float, delays: list[float]) -> None:
    clock = HandClock()
    clock.station_time(offset, 10.0)  # the fastest
    for i, delay in enumerate(delays, 1):
        taken = 10.0 + 0.008 * i
        told = clock.station_time(offset + 0.008 * i, taken + delay)
        assert told == pytest.approx(taken, abs=1e-3)
        assert told <= taken + delay


@pytest.mark.parametrize("rate", [1.0 - 1e-4, 1.0 + 1e-4])
def test_a_clock_that_runs_slow_or_fast_is_followed(rate: float) -> None:
    clock = HandClock()
    for second in range(3600):
        age = second - clock.station_time(1000.0 + second * rate, float(second))
        assert 0.0 <= age < 1e-3


def test_a_command_counts_when_the_state_shows_it() -> None:
    acknowledged = Acknowledgement()
    acknowledged.shown(0.5, np.zeros(2))
    assert acknowledged.since is None, "nothing was commanded"
    acknowledged.sent(1.0, np.full(2, 0.0))
    acknowledged.sent(1.01, np.full(2, 0.1))
    acknowledged.sent(1.02, np.full(2, 0.2))
    assert acknowledged.since == 1.0
    acknowledged.shown(1.03, np.full(2, 0.101))
    assert acknowledged.since == 1.02
    acknowledged.shown(1.04, np.full(2, 0.15))
    assert acknowledged.since == 1.02, "on its way"
    acknowledged.shown(1.06, np.full(2, 0.2))
    assert acknowledged.since is None
    acknowledged.shown(1.08, np.array([0.2, 0.3]))
    assert acknowledged.since == 1.08, "somebody else commands it"
    acknowledged.shown(1.10, np.full(2, 0.2))
    assert acknowledged.since is None

"""What the hand says: the maker's own examples, what rosbridge makes of them, and whatever may become of a message."""

from __future__ import annotations

import json
import math
import random
import re
from collections import Counter
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic_core import from_json

from tests.devices.hands.shadow.recorded import (
    COMMANDED,
    CONTROLLED,
    DESIRED,
    EFFORTS,
    NAMES,
    POSITIONS,
    VELOCITIES,
    controller_state,
    diagnostics,
    joint_states,
    publication,
)
from tests.errors import raises
from toolee_robot.devices.hands.shadow import messages, rosbridge
from toolee_robot.devices.hands.shadow.freshness import FASTEST, SLACK, Freshness
from toolee_robot.devices.hands.shadow.line import CONTROLLERS, JOINTS
from toolee_robot.devices.hands.shadow.messages import ControllerState, JointStates
from toolee_robot.devices.hands.shadow.motors import Flag, Level, MotorStatus, described, error_of
from toolee_robot.devices.hands.wire.counts import LineCounts
from toolee_robot.errors import ProtocolError

FINGERS = JOINTS[CONTROLLERS[messages.FINGERS]]
Read = JointStates | ControllerState | dict[str, MotorStatus] | rosbridge.Notice | None


def read(data: bytes) -> Read:
    """Read a websocket message as the line does."""
    said = rosbridge.decode(data)
    if not isinstance(said, rosbridge.Publication):
        return said
    if said.topic == messages.JOINT_STATES:
        return messages.joint_states(said.message, JOINTS)
    if said.topic == messages.DIAGNOSTICS:
        return messages.motor_statuses(said.message)
    return messages.controller_state(said.message, FINGERS) if said.topic.startswith(messages.FINGERS) else None


def motors_of(data: bytes) -> list[MotorStatus]:
    found = read(data)
    assert isinstance(found, dict)
    return list(found.values())


def test_the_makers_published_joint_states_are_understood() -> None:
    states = read(joint_states())
    assert isinstance(states, JointStates)
    assert states.stamp == pytest.approx(583.274)
    for values, expected in ((states.position, POSITIONS), (states.velocity, VELOCITIES), (states.effort, EFFORTS)):
        by_name = dict(zip(JOINTS, values, strict=True))
        assert [by_name[name] for name in NAMES] == expected


def test_the_makers_published_controller_state_is_understood() -> None:
    state = read(controller_state())
    assert isinstance(state, ControllerState)
    by_name = dict(zip(FINGERS, state.desired, strict=True))
    assert [by_name[name] for name in CONTROLLED] == DESIRED


def test_the_motors_are_found_among_other_devices() -> None:
    (motor,) = motors_of(diagnostics())
    assert motor == MotorStatus("FFJ0", Level.OK, "OK", temperature=34.5625, current=0.105)
    assert motor.fault == ""
    assert error_of([motor]) is None


@pytest.mark.parametrize(
    ("flags", "level", "temperature", "code", "words"),
    [
        ("Motor over temperature | ", 2, "60.250000", "device.hand_over_temperature", "FFJ0: too hot"),
        (" None", 0, "61.000000", "device.hand_over_temperature", "FFJ0: too hot"),
        ("A3950 H-bridge nFault asserted | ", 2, "40.000000", "device.hand_motor", "FFJ0: A3950"),
        ("No demand seen for more than 20ms | ", 2, "40.000000", "device.hand_motor", "FFJ0: No demand"),
    ],
)
def test_a_motor_that_is_halted_is_a_fault(flags: str, level: int, temperature: str, code: str, words: str) -> None:
    motors = motors_of(diagnostics(flags, level, temperature))
    error = error_of(motors)
    assert error is not None
    assert error.code == code
    assert words in described(motors)


def test_a_limited_current_is_told_and_no_fault() -> None:
    (motor,) = motors_of(diagnostics("Current choke bit 6 | Current choke bit 9 | ", 1))
    assert motor.choked
    assert motor.level is Level.WARN
    assert motor.flags == frozenset()
    assert motor.fault == ""


def test_the_command_has_the_fields_of_the_makers_example() -> None:
    positions = np.linspace(0.0, 0.3, len(FINGERS))
    text = rosbridge.publish(f"{messages.FINGERS}/command", messages.trajectory(FINGERS, positions, 0.02))
    assert text == (
        '{"op":"publish","topic":"/rh_trajectory_controller/command","msg":{"header":{"stamp":{"secs":0,"nsecs":0},'
        '"frame_id":""},"joint_names":[' + ",".join(f'"{joint}"' for joint in FINGERS) + '],"points":[{"positions":['
        + ",".join(str(round(float(angle), 6)) for angle in positions)
        + '],"velocities":[],"accelerations":[],"effort":[],"time_from_start":{"secs":0,"nsecs":20000000}}]}}'
    )  # fmt: skip
    assert sorted(FINGERS) == sorted(COMMANDED), "a controller takes all its joints or none"


def test_requests_are_as_the_protocol_says() -> None:
    assert json.loads(rosbridge.subscribe("/joint_states", "sensor_msgs/JointState")) == {
        "op": "subscribe", "id": "subscribe:/joint_states", "topic": "/joint_states", "type": "sensor_msgs/JointState",
        "throttle_rate": 0, "queue_length": 1,
    }  # fmt: skip
    assert json.loads(rosbridge.advertise("/a", "b/C")) == {
        "op": "advertise", "id": "advertise:/a", "topic": "/a", "type": "b/C",
    }  # fmt: skip
    with pytest.raises(ValueError, match="not JSON compliant"):
        rosbridge.publish("/a", {"data": math.nan})


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
def test_what_is_of_others_is_passed_over(text: bytes) -> None:
    assert read(text) is None


def test_what_rosbridge_itself_says() -> None:
    notice = read(b'{"op":"status","level":"error","msg":"no such topic","id":"subscribe:/x"}')
    assert notice == rosbridge.Notice("error", "no such topic")


WRONG: list[bytes] = [
    b"", b"\xff\xfe", b"[]", b"{}", b'{"op":3}', b'{"op":"publish"}', b'{"op":"publish","topic":"/a","msg":[]}',
    b'{"op":"publish","op":"status"}', b"[" * 100_000, b'{"op":"publish","topic":"/a","msg":{"data":NaN}}',
    joint_states(position=[None, *POSITIONS[1:]]), joint_states(position=[True, *POSITIONS[1:]]),
    joint_states(position=["1", *POSITIONS[1:]]), joint_states(position=POSITIONS[1:]),
    joint_states(position=[2.5, *POSITIONS[1:]]), joint_states(effort=[1e6, *EFFORTS[1:]]),
    joint_states(velocity=[-400.0, *VELOCITIES[1:]]), joint_states(name=[NAMES[1], *NAMES[1:]]),
    joint_states(name=["rh_XXJ1", *NAMES[1:]]), joint_states(secs=-1), joint_states(nsecs=10**9),
    joint_states(header={"stamp": {"sec": 1, "nanosec": 2}}), joint_states(header=None),
    joint_states(position=[10**400, *POSITIONS[1:]]),
    joint_states().replace(b"1.279751244673038", b"1e999"), joint_states()[:-9],
    controller_state(desired=[]), controller_state(joint_names=[*CONTROLLED, "rh_WRJ1"]),
    controller_state(joint_names=CONTROLLED[1:]),
    diagnostics(temperature="hot"), diagnostics(temperature="nan"), diagnostics(level=7),
    publication("/diagnostics", {"status": [{"name": "rh SRDMotor FFJ0", "level": 0, "message": "OK", "values": [3]}]}),
    publication("/diagnostics", {"status": [{"level": 0}]}), publication("/diagnostics", {"status": None}),
]  # fmt: skip


@pytest.mark.parametrize("text", WRONG, ids=range(len(WRONG)))
def test_what_no_hand_says_is_refused(text: bytes) -> None:
    with pytest.raises(ProtocolError) as refused:
        read(text)
    assert refused.value.code in (rosbridge.DAMAGED, messages.NOT_OURS)


def test_stamps_of_ros_2_are_refused_by_name() -> None:
    with raises(ProtocolError, "protocol.hand_values") as refused:
        read(joint_states(header={"stamp": {"sec": 1, "nanosec": 2}}))
    assert "ROS 1" in str(refused.value)


@given(st.binary(max_size=200))
def test_bytes_at_random_are_refused_or_nothing(data: bytes) -> None:
    with suppress(ProtocolError):
        assert read(data) is None


MUTATIONS = ("whole", "changed", "lost", "inserted", "cut", "swapped", "doubled", "another number", "a null")


def mutated(kind: str, data: bytes, draw: random.Random) -> bytes:
    at, width = draw.randrange(len(data)), draw.randint(1, 12)
    if kind == "changed":
        return data[:at] + draw.randbytes(1) + data[at + 1 :]
    if kind == "lost":
        return data[:at] + data[at + width :]
    if kind == "inserted":
        return data[:at] + draw.randbytes(width) + data[at:]
    if kind == "cut":
        return data[:at]
    if kind == "swapped":
        other = draw.randrange(len(data))
        return data[:at] + data[other : other + width] + data[at + width :]
    if kind == "doubled":
        return data + data
    at = draw.choice([match.start() for match in re.finditer(rb"(?<=[ \[-])\d", data)])
    if kind == "another number":
        return data[:at] + str(draw.randrange(10)).encode() + data[at + 1 :]
    end = next(i for i in range(at, len(data)) if data[i : i + 1] in b",]}")
    return data[:at] + b"null" + data[end:] if kind == "a null" else data


def as_another_reader_says(data: bytes) -> Any:
    """The message by a parser that the driver does not use."""
    return from_json(data, allow_inf_nan=False)["msg"]


def agrees(found: Read, data: bytes) -> bool:
    """Whether what was read is what the text says."""
    if found is None or isinstance(found, rosbridge.Notice):
        return True
    message = as_another_reader_says(data)
    if isinstance(found, JointStates):
        index = {name: i for i, name in enumerate(message["name"])}
        pairs = (("position", found.position), ("velocity", found.velocity), ("effort", found.effort))
        stamp = message["header"]["stamp"]
        return found.stamp == stamp["secs"] + 1e-9 * stamp["nsecs"] and all(
            [message[field][index[joint]] for joint in JOINTS] == values.tolist() for field, values in pairs
        )
    if isinstance(found, ControllerState):
        index = {name: i for i, name in enumerate(message["joint_names"])}
        return [message["desired"]["positions"][index[joint]] for joint in FINGERS] == found.desired.tolist()
    for name, motor in found.items():
        (status,) = [one for one in message["status"] if one["name"] == f"rh SRDMotor {name}"]
        values = {pair["key"]: pair["value"] for pair in status["values"]}
        said = [values.get("Temperature"), values.get("Measured Current")]
        if (motor.level, motor.summary) != (status["level"], status["message"]):
            return False
        if [motor.temperature, motor.current] != [None if one is None else float(one) for one in said]:
            return False
        if motor.flags != {flag for flag in Flag if flag in values.get("Motor Flags", "")}:
            return False
    return True


@pytest.mark.parametrize("count", [1_000, pytest.param(10_000, marks=pytest.mark.nightly)])
def test_mutated_messages_are_read_as_they_are_or_refused(count: int) -> None:
    draw = random.Random(31)
    examples = [joint_states(), controller_state(), diagnostics()]
    outcomes: Counter[tuple[str, str]] = Counter()
    for i in range(count):
        data = draw.choice(examples)
        kind = MUTATIONS[i % len(MUTATIONS)]
        text = mutated(kind, data, draw)
        try:
            found = read(text)
        except ProtocolError:
            outcomes[kind, "refused"] += 1
            continue
        assert agrees(found, text), f"case {i}: {kind}"
        outcomes[kind, "read"] += 1
    assert outcomes["whole", "refused"] == 0
    for kind in ("cut", "doubled"):
        assert outcomes[kind, "read"] == 0
    assert outcomes["a null", "refused"] > 0.9 * outcomes["a null", "read"]
    assert outcomes["another number", "read"] > 0, "JSON has no checksum: TCP has"


@pytest.mark.parametrize("count", [1_000, pytest.param(10_000, marks=pytest.mark.nightly)])
def test_a_changed_digit_is_refused_or_does_no_harm(count: int) -> None:
    """A joint that cannot have got there since is not believed; what is left is less than a slip."""
    draw = random.Random(32)
    before = [_states(joint_states(nsecs=milliseconds * 10**6)) for milliseconds in (0, 8, 16)]
    whole = joint_states(nsecs=24 * 10**6)
    for i in range(count):
        fresh = Freshness(LineCounts())
        for one in before:
            fresh.admit(one)
        text = mutated("another number", whole, draw)
        try:
            states = read(text)
        except ProtocolError:
            continue
        assert isinstance(states, JointStates)
        if fresh.admit(states):
            wrong = np.abs(states.position - before[0].position).max()
            assert wrong <= FASTEST * (states.stamp - 583.016) + SLACK, f"case {i}"


def _states(data: bytes) -> JointStates:
    states = read(data)
    assert isinstance(states, JointStates)
    return states

"""The driver's own stream of the robot's state: every reading counts, also of several that come at once."""

from __future__ import annotations

import math
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.devices.ur.wire import data, packet, setup_reply
from tests.examples import examples
from toolee_robot.devices.ur.protocols.rtde import RTDE_PORT
from toolee_robot.devices.ur.servo.state_stream import StateStream
from toolee_robot.errors import DeviceError, NotReadyError
from toolee_robot.runtime.clock import HostClock

HOST = "127.0.0.63"
JOINTS = (0.1, -1.2, 1.3, -0.4, 1.5, 0.6)
NAN, INF = math.nan, math.inf
OLD = ["DOUBLE", *["VECTOR6D"] * 4, "DOUBLE", "DOUBLE", "UINT32", "INT32", "UINT32", "UINT64"]
TYPES = [*OLD, "VECTOR6D", "DOUBLE", "VECTOR3D", "DOUBLE", "DOUBLE", "VECTOR6D", "VECTOR6D"]
TORQUES = (0.5, 90.0, 40.0, 2.0, 1.0, 0.25)
HELLO = packet(b"V", b"\x01")


def reading(
    timestamp: float,
    *,
    q0: float = 0.1,
    force: float = 5.0,
    slider: float = 1.0,
    ratio: float = 0.25,
    current: float = 1.5,
    optional: slice = slice(None),
) -> bytes:
    """`optional` says which of the outputs that not every version has are reported."""
    joints, wrench = (q0, *JOINTS[1:]), (force, 2.0, 3.0, 4.0, 5.0, 6.0)
    always = (timestamp, joints, (0.0,) * 6, JOINTS, wrench, slider, 1.0, 1, 7, 2, 0b1000_0000_0000_0101)
    newer: tuple[object, ...] = ((0.0, 0.0, 0.1, 0.0, 0.0, 0.0), 1.25, (0.1, 0.2, 0.3), ratio, 0.5)
    newer += (TORQUES, (current, -0.5, 0.25, 0.0, 0.0, 0.0))
    return data([*OLD, *TYPES[len(OLD) :][optional]], (*always, *newer[optional]))


@contextmanager
def controller(*connections: bytes) -> Iterator[list[socket.socket]]:
    """A robot's RTDE port that says so much to each connection, in this order; yields what it has accepted."""
    accepted: list[socket.socket] = []
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((HOST, RTDE_PORT))
        listener.listen()

        def serve() -> None:
            for said in connections:
                sock, _ = listener.accept()
                accepted.append(sock)
                sock.sendall(said)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield accepted
        finally:
            thread.join()
            for sock in accepted:
                sock.close()


def connect() -> StateStream:
    return StateStream(HOST, 125.0, 10.0, HostClock())


def greeting(types: list[str], first: bytes) -> bytes:
    return HELLO + setup_reply(types) + first


@examples(20)
@given(st.lists(st.floats(-500.0, 500.0), min_size=1, max_size=6))
def test_of_readings_that_come_at_once_none_is_left_out(forces: list[float]) -> None:
    with controller(greeting(TYPES, reading(1.0))) as accepted:
        stream = connect()
        accepted[0].sendall(b"".join(reading(2.0 + k, q0=0.1 * k, force=force) for k, force in enumerate(forces)))
        taken = stream.take()
    assert [r.timestamp for r in taken] == [2.0 + k for k in range(len(forces))]
    assert [r.wrench[0] for r in taken] == [-force for force in forces], "in base, not in the controller's"
    np.testing.assert_allclose(stream.newest.q, (0.1 * (len(forces) - 1), *JOINTS[1:]))
    assert stream.plausible
    assert not stream.lost


@pytest.mark.parametrize(
    "bad",
    [
        reading(3.0, q0=NAN),
        reading(3.0, q0=INF),
        reading(3.0, force=NAN),
        reading(3.0, force=1e300),
        reading(3.0, ratio=NAN),
        reading(3.0, ratio=-0.1),
        reading(NAN),
        reading(INF),
        reading(1.0),
        packet(b"U", b"\x01" + bytes(12)),
    ],
    ids=[
        "joints NaN",
        "joints inf",
        "force NaN",
        "force 1e300",
        "ratio NaN",
        "ratio below 0",
        "time NaN",
        "time inf",
        "time goes back",
        "too short",
    ],
)
def test_one_bad_reading_between_good_ones_is_a_fault_for_good(bad: bytes) -> None:
    with controller(greeting(TYPES, reading(1.5))) as accepted:
        stream = connect()
        accepted[0].sendall(reading(2.0) + bad + reading(4.0, q0=0.4))
        stream.take()
        assert not stream.plausible
        accepted[0].sendall(reading(5.0, q0=0.5))
        assert stream.take() == []
    for numbers in (stream.newest.q, stream.newest.qd, stream.newest.wrench):
        assert np.abs(numbers).max() < 1e3, "garbage was taken in"
    assert stream.newest.timestamp < 3.0, "what came after the fault was taken in"


def test_the_same_reading_twice_is_not_news() -> None:
    with controller(greeting(TYPES, reading(1.0))) as accepted:
        stream = connect()
        accepted[0].sendall(reading(1.0) + reading(2.0) + reading(2.0))
        assert [r.timestamp for r in stream.take()] == [2.0]
        assert stream.plausible


def refusal(types: list[str]) -> bytes:
    return HELLO + packet(b"O", b"\x01" + ",".join(types).encode())


def test_an_old_controller_does_without_what_it_does_not_have() -> None:
    with controller(refusal([*OLD, *["NOT_FOUND"] * 7]), greeting(OLD, reading(1.0, optional=slice(0)))):
        newest = connect().newest
    assert newest.payload is None
    assert newest.tcp is None
    assert math.isnan(newest.position_deviation_ratio)
    assert math.isnan(newest.collision_ratio)
    assert np.isnan([*newest.torques, *newest.currents]).all()
    assert newest.digital_inputs == 0b1000_0000_0000_0101


def test_a_controller_without_ratios_still_reports_its_payload_and_tcp() -> None:
    with controller(refusal([*TYPES[:-4], *["NOT_FOUND"] * 4]), greeting(TYPES[:-4], reading(1.0, optional=slice(3)))):
        newest = connect().newest
    assert newest.payload == (1.25, 0.1, 0.2, 0.3)
    assert newest.tcp is not None
    assert newest.tcp.tolist() == [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    assert math.isnan(newest.collision_ratio)


def test_the_ratios_to_a_protective_stop_are_read_where_the_controller_reports_them() -> None:
    with controller(greeting(TYPES, reading(1.0, ratio=0.75))):
        newest = connect().newest
    assert (newest.position_deviation_ratio, newest.collision_ratio) == (0.75, 0.5)


def test_torques_and_currents_are_read_and_stop_no_arm_whatever_they_are() -> None:
    with controller(greeting(TYPES, reading(1.0))) as accepted:
        stream = connect()
        assert (tuple(stream.newest.torques), stream.newest.currents[0]) == (TORQUES, 1.5)
        accepted[0].sendall(reading(2.0, current=NAN) + reading(3.0, current=INF))
        assert [r.timestamp for r in stream.take()] == [2.0, 3.0]
        assert stream.plausible


def test_what_is_zeroed_is_zeroed_in_every_reading_to_come() -> None:
    with controller(greeting(TYPES, reading(1.0, force=7.0))) as accepted:
        stream = connect()
        stream.wrench_offset = stream.newest.wrench
        accepted[0].sendall(reading(2.0, force=7.0) + reading(3.0, force=12.0))
        taken = stream.take()
    assert [r.wrench.tolist() for r in taken] == [[0.0] * 6, [-5.0, 0.0, 0.0, 0.0, 0.0, 0.0]]


def test_what_a_controller_must_report_is_named() -> None:
    types = [*OLD[:4], "NOT_FOUND", *OLD[5:]]
    known = [*OLD[:4], *OLD[5:]]
    with (
        controller(refusal([*types, *TYPES[len(OLD) :]]), greeting([*known, *TYPES[len(OLD) :]], b"")),
        pytest.raises(NotReadyError, match="actual_TCP_force: update"),
    ):
        connect()


def test_a_connection_that_ends_is_lost_for_good() -> None:
    with controller(greeting(TYPES, reading(1.0))) as accepted:
        stream = connect()
        accepted[0].close()
        with suppress(DeviceError):
            stream.take()
        assert stream.lost
        assert stream.take() == []

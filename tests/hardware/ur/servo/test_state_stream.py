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

from tests.examples import examples
from tests.hardware.ur.wire import data, packet, setup_reply
from toolee_robot.errors import DeviceError, NotReadyError
from toolee_robot.hardware.ur.protocols.rtde import RTDE_PORT
from toolee_robot.hardware.ur.servo.state_stream import StateStream
from toolee_robot.runtime.clock import HostClock

HOST = "127.0.0.63"
JOINTS = (0.1, -1.2, 1.3, -0.4, 1.5, 0.6)
NAN, INF = math.nan, math.inf
OLD = ["DOUBLE", *["VECTOR6D"] * 4, "DOUBLE", "DOUBLE", "UINT32", "INT32", "UINT32"]
TYPES = [*OLD, "DOUBLE", "VECTOR3D"]
HELLO = packet(b"V", b"\x01")


def reading(timestamp: float, *, q0: float = 0.1, force: float = 5.0, slider: float = 1.0, old: bool = False) -> bytes:
    """old: of a controller that does not report the payload."""
    joints, wrench = (q0, *JOINTS[1:]), (force, 2.0, 3.0, 4.0, 5.0, 6.0)
    values = (timestamp, joints, (0.0,) * 6, JOINTS, wrench, slider, 1.0, 1, 7, 2, 1.25, (0.1, 0.2, 0.3))
    return data(OLD, values[:-2]) if old else data(TYPES, values)


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
        reading(NAN),
        reading(INF),
        reading(1.0),
        packet(b"U", b"\x01" + bytes(12)),
    ],
    ids=["joints NaN", "joints inf", "force NaN", "force 1e300", "time NaN", "time inf", "time goes back", "too short"],
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


def test_the_payload_is_read_where_the_controller_reports_it() -> None:
    with controller(greeting(TYPES, reading(1.0))):
        assert connect().newest.payload == (1.25, 0.1, 0.2, 0.3)


def test_an_old_controller_does_without_the_payload() -> None:
    refusal = HELLO + packet(b"O", b"\x01" + ",".join([*OLD, "NOT_FOUND", "NOT_FOUND"]).encode())
    with controller(refusal, greeting(OLD, reading(1.0, old=True))):
        assert connect().newest.payload is None


def test_what_a_controller_must_report_is_named() -> None:
    types = [*OLD[:4], "NOT_FOUND", *OLD[5:]]
    refusals = [HELLO + packet(b"O", b"\x01" + ",".join(names).encode()) for names in ([*types, "X", "X"], types)]
    with controller(*refusals), pytest.raises(NotReadyError, match="actual_TCP_force: update"):
        connect()


def test_a_connection_that_ends_is_lost_for_good() -> None:
    with controller(greeting(TYPES, reading(1.0))) as accepted:
        stream = connect()
        accepted[0].close()
        with suppress(DeviceError):
            stream.take()
        assert stream.lost
        assert stream.take() == []

"""What clients may do to the stand-in on purpose: it ticks on."""

from __future__ import annotations

import json
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress

import pytest

from tests.examples import seldom
from tests.sim_backend.ur_controller.server.wire import RtdeSocket
from toolee_robot.errors import UserError
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.server.rtde_types import packet

pytestmark = pytest.mark.realtime(light=True)

HOST = "127.0.0.67"
PORTS = {"dashboard": 29999, "primary": 30001, "secondary": 30002, "realtime": 30003, "rtde": 30004, "faults": 30020}


STALL = 0.5  # [s] on a busy machine; alone, all of these are under 0.05


@pytest.fixture(scope="module")
def process() -> Iterator[ControllerProcess]:
    with ControllerProcess(host=HOST) as controller:
        yield controller


@pytest.fixture
def controller(process: ControllerProcess, request: pytest.FixtureRequest) -> Iterator[ControllerProcess]:
    """Ticks during the test, and nightly is not held up."""
    process.fault("reset_statistics")
    yield process
    ticks = process.state()["ticks"]
    assert ticks["worst_late"] < STALL or not request.node.get_closest_marker("nightly")
    process.fault("reset")


def push(port: str, data: bytes, seconds: float = 1.0) -> None:
    """Send until all of it has gone, the controller hangs up, or the time is over; its answers are not read."""
    with socket.create_connection((HOST, PORTS[port]), 5.0) as sock, suppress(OSError):
        sock.settimeout(seconds)
        sock.sendall(data)
        time.sleep(0.2)


@pytest.mark.parametrize("name", seldom(b"actual_q", b"nonsense"))
@pytest.mark.parametrize("kind", seldom("I", "O"))
def test_a_recipe_that_outgrows_a_packet(controller: ControllerProcess, kind: str, name: bytes) -> None:
    rate = struct.pack(">d", 500.0) if kind == "O" else b""
    with RtdeSocket(HOST) as client:
        client.ask("V", b"\x00\x02")
        with pytest.raises((EOFError, ConnectionError)):
            client.ask(kind, rate + (name + b",") * 7000)
    with RtdeSocket(HOST) as client:
        client.subscribe("timestamp")
        assert client.timestamps(3)
    assert controller.state()["clients"]["rtde"] <= 1


@pytest.mark.parametrize("port", seldom("rtde", *PORTS))
def test_half_a_megabyte_without_a_line_end(controller: ControllerProcess, port: str) -> None:  # noqa: ARG001
    push(port, b"a" * 500_000)


@pytest.mark.parametrize(
    ("port", "unit"),
    seldom(
        ("rtde", packet(ord("Z"))),
        ("rtde", packet(ord("v"))),
        ("dashboard", b"robotmode\n"),
        ("realtime", b'popup("x")\n'),
        ("faults", b'{"fault": "trace"}\n'),
        ("faults", b"[" * 900 + b"]" * 900 + b"\n"),
    ),
)
def test_a_flood_whose_answers_nobody_reads(controller: ControllerProcess, port: str, unit: bytes) -> None:  # noqa: ARG001
    push(port, unit * (300_000 // len(unit)))


@pytest.mark.parametrize("port", seldom("rtde", *PORTS))
def test_many_slow_clients(controller: ControllerProcess, port: str) -> None:
    with ExitStack() as stack:
        clients = [stack.enter_context(socket.create_connection((HOST, PORTS[port]), 5.0)) for _ in range(15)]
        for _ in range(20):
            for client in clients:
                with suppress(OSError):
                    client.sendall(b"\x00")
            time.sleep(0.01)
        assert controller.state()["ticks"]["done"] > 0


@pytest.mark.parametrize("port", seldom("rtde", *PORTS))
def test_hundreds_of_connections(controller: ControllerProcess, port: str) -> None:
    for _ in range(200):
        with suppress(OSError):
            socket.create_connection((HOST, PORTS[port]), 1.0).close()
    tick = controller.state()["tick"]
    time.sleep(0.1)
    assert controller.state()["tick"] > tick


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("force", {"wrench": [1e308] * 6}),
        ("joint_offset", {"offset": [1e308] * 6}),
        ("tcp", {"pose": [1e308] * 6}),
        ("payload", {"mass": 1.0, "cog": [1e308] * 3}),
        ("kinematics", {"a": [1e308] * 6, "d": [0.0] * 6}),
    ],
)
def test_numbers_that_overflow_are_refused(
    controller: ControllerProcess, name: str, arguments: dict[str, object]
) -> None:
    with pytest.raises(UserError, match="1000000"):
        controller.fault(name, **arguments)


def test_requests_sent_at_once_are_answered_in_order(controller: ControllerProcess) -> None:
    names = ["reset_statistics", "nothing", "accept", "nobody"]
    with socket.create_connection((HOST, PORTS["faults"]), 5.0) as sock, sock.makefile("rb") as answers:
        sock.sendall(b"".join(json.dumps({"fault": name}).encode() + b"\n" for name in names))
        assert [json.loads(answers.readline())["ok"] for _ in names] == [True, False, True, False]
    assert controller.state()["ticks"]["done"] >= 0

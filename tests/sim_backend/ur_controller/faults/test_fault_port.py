"""The fault port: every hook does to a client what it says, and the stand-in lives on."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.examples import examples
from tests.sim_backend.ur_controller.faults.ports import HOST, ask, calibration, reachable, upload
from tests.sim_backend.ur_controller.server.wire import RtdeSocket
from tests.sim_backend.ur_controller.ur_rtde.contract import wait_for
from toolee_robot.errors import UserError
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.server.rtde_types import packet

pytestmark = pytest.mark.sim

PERIOD = 0.008
FOREVER = "def job():\n  while True:\n    sync()\n  end\nend\n"


@pytest.fixture(scope="module")
def process() -> Iterator[ControllerProcess]:
    with ControllerProcess(model="UR10", host=HOST) as controller:
        yield controller


@pytest.fixture
def controller(process: ControllerProcess) -> ControllerProcess:
    process.fault("reset")
    return process


@pytest.fixture
def client(controller: ControllerProcess) -> Iterator[RtdeSocket]:  # noqa: ARG001
    with RtdeSocket(HOST) as client:
        client.subscribe("timestamp")
        yield client


def test_every_hook_is_documented(controller: ControllerProcess) -> None:
    page = (Path(__file__).parents[4] / "docs" / "reference" / "ur_controller.md").read_text()
    with pytest.raises(UserError, match="choose one of") as caught:
        controller.fault("explode")
    names = str(caught.value).split("choose one of ")[1].split(", ")
    assert len(names) > 30
    assert [name for name in names if f"`{name}`" not in page] == []


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("explode", {}, "no fault 'explode': choose one of"),
        ("drop", {"port": "usb"}, "no port 'usb': choose one of all, dashboard"),
        ("stall", {}, "missing a required argument: 'seconds'"),
        ("stall", {"seconds": -1}, "greater than or equal to 0"),
        ("stall", {"seconds": 1, "hours": 2}, "unexpected keyword argument"),
        ("force", {"wrench": [1, 2]}, "at least 6 items"),
        ("own", {"variables": ["nonsense"]}, "no input variable 'nonsense'"),
        ("nan", {"variables": ["nonsense"]}, "no output variable 'nonsense'"),
    ],
)
def test_says_what_is_wrong_with_a_request(
    controller: ControllerProcess, name: str, arguments: dict[str, object], message: str
) -> None:
    with pytest.raises(UserError, match=message):
        controller.fault(name, **arguments)


def test_refuse_and_accept(controller: ControllerProcess, client: RtdeSocket) -> None:
    controller.fault("refuse", port="rtde")
    with pytest.raises(ConnectionRefusedError):
        RtdeSocket(HOST)
    assert client.timestamps(3)  # who is in stays in
    controller.fault("accept", port="rtde")
    RtdeSocket(HOST).close()
    controller.fault("refuse", port="rtde", seconds=0.2)
    wait_for(lambda: reachable(30004))


def test_stall_delivers_everything_afterwards(controller: ControllerProcess, client: RtdeSocket) -> None:
    client.timestamps(3)
    controller.fault("stall", port="rtde", seconds=0.5)
    client.read_for(0.1)
    assert client.read_for(0.2) == b""
    stamps = client.timestamps(60)
    np.testing.assert_allclose(np.diff(stamps), PERIOD, atol=1e-9)


def test_freeze_slips_ticks_and_counts_them(controller: ControllerProcess) -> None:
    controller.fault("reset_statistics")
    controller.fault("freeze", seconds=0.4)
    wait_for(lambda: controller.state()["ticks"]["slipped"] >= 40)
    assert controller.state()["ticks"]["worst_late"] >= 0.35


def test_delay(controller: ControllerProcess, client: RtdeSocket) -> None:
    client.timestamps(3)
    controller.fault("delay", port="rtde", seconds=0.4)
    client.read_for(0.05)
    (newest,) = client.timestamps(1)
    assert controller.state()["timestamp"] - newest > 0.3


def test_skip(controller: ControllerProcess, client: RtdeSocket) -> None:
    before = client.timestamps(3)
    controller.fault("skip", packets=5)
    gaps = np.diff(before + client.timestamps(60))
    assert gaps.max() == pytest.approx(6 * PERIOD)


def test_half_open(controller: ControllerProcess, client: RtdeSocket) -> None:
    controller.fault("half_open", port="rtde")
    client.read_for(0.1)
    assert client.read_for(0.3) == b""  # no data, and no end either
    with RtdeSocket(HOST) as other:
        other.subscribe("timestamp")
        assert other.timestamps(3)


def test_truncate(controller: ControllerProcess, client: RtdeSocket) -> None:
    client.timestamps(3)
    controller.fault("truncate", port="rtde", bytes=5)
    data = client.read_for(0.3)
    assert len(data) % client.packet_size == 5


def test_coalesce(controller: ControllerProcess, client: RtdeSocket) -> None:
    client.timestamps(3)
    controller.fault("coalesce", port="rtde", sends=10)
    client.read_for(0.1)
    assert len(client.read_for(0.5)) % (10 * client.packet_size) == 0


@pytest.mark.parametrize("packets", [1, 2, 4])
def test_drop_in_mid_handshake(controller: ControllerProcess, packets: int) -> None:
    controller.fault("handshake_drop", packets=packets)
    with RtdeSocket(HOST) as client, pytest.raises((EOFError, ConnectionError)):
        list(map(client.ask, "vvvv"))
    with RtdeSocket(HOST) as client:
        client.subscribe("timestamp")
        assert client.timestamps(2)


def test_missing_variable(controller: ControllerProcess) -> None:
    controller.fault("missing", variables=["actual_q"])
    with RtdeSocket(HOST) as client:
        client.ask("V", b"\x00\x02")
        assert client.ask("O", struct.pack(">d", 125.0) + b"timestamp,actual_q,") == b"\x00DOUBLE,NOT_FOUND"


def test_nan_and_frozen_timestamp(controller: ControllerProcess, client: RtdeSocket) -> None:
    controller.fault("nan", variables=["timestamp"], ticks=3)
    assert np.isnan(client.timestamps(60)).sum() == 3
    controller.fault("freeze_timestamp")
    client.read_for(0.1)
    assert len(set(client.timestamps(10))) == 1
    controller.fault("freeze_timestamp", frozen=False)
    client.read_for(0.1)
    assert len(set(client.timestamps(10))) == 10


def test_rejected_script_and_slow_start(controller: ControllerProcess) -> None:
    controller.fault("reject_script")
    upload(FOREVER)
    wait_for(lambda: controller.state()["program_error"] == "script rejected (fault)")
    assert controller.state()["program_state"] == "STOPPED"
    controller.fault("slow_start", seconds=0.5)
    uploads = controller.state()["uploads"]
    upload(FOREVER)
    wait_for(lambda: controller.state()["uploads"] > uploads)
    assert controller.state()["program_state"] == "STOPPED"
    wait_for(lambda: controller.state()["program_state"] == "PLAYING")


def test_wrong_identity(controller: ControllerProcess) -> None:
    controller.fault("version", version=[5, 25, 1, 0])
    controller.fault("model", name="UR5")
    controller.fault("serial", number="12345")
    assert (ask("PolyscopeVersion"), ask("get robot model"), ask("get serial number")) == ("5.25.1.0", "UR5", "12345")
    with RtdeSocket(HOST) as client:
        assert struct.unpack(">4I", client.ask("v")) == (5, 25, 1, 0)


def test_wrong_settings(controller: ControllerProcess) -> None:
    controller.fault("payload", mass=3.5, cog=[0.0, 0.0, 0.1])
    controller.fault("tcp", pose=[0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
    controller.fault("speed_slider", fraction=0.3)
    with RtdeSocket(HOST) as client:
        client.subscribe("payload", "payload_cog", "tcp_offset", "target_speed_fraction")
        numbers = client.numbers()
    assert numbers == (3.5, 0.0, 0.0, 0.1, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.3)


def test_kinematics_of_another_arm(controller: ControllerProcess) -> None:
    nominal = calibration()
    tcp = controller.state()["tcp_pose"]
    controller.fault("kinematics", a=[0.0, 0.002, 0.0, 0.0, 0.0, 0.0], d=[0.0] * 6)
    changed = calibration()
    assert changed[:6] != nominal[:6]
    assert changed[6 + 6 + 1] == pytest.approx(nominal[6 + 6 + 1] + 0.002)
    assert np.linalg.norm(np.subtract(controller.state()["tcp_pose"][:3], tcp[:3])) == pytest.approx(0.002)


def test_joint_offset_is_measured_and_not_true(controller: ControllerProcess) -> None:
    q = controller.state()["q"]
    controller.fault("joint_offset", offset=[0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    with RtdeSocket(HOST) as client:
        client.subscribe("actual_q")
        measured = client.numbers()
    assert measured[0] == pytest.approx(q[0] + 0.05)
    assert controller.state()["q"] == q


@settings(examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    port=st.sampled_from([29999, 30001, 30002, 30003, 30004, 30020]),
    chunks=st.lists(
        st.one_of(
            st.binary(max_size=400), st.builds(packet, st.sampled_from(list(b"VvOISPUM")), st.binary(max_size=60))
        ),
        max_size=6,
    ),
)
def test_any_bytes_on_any_port(controller: ControllerProcess, port: int, chunks: list[bytes]) -> None:
    with socket.create_connection((HOST, port), 5.0) as sock:
        try:
            for chunk in chunks:
                sock.sendall(chunk)
        except ConnectionError:
            pass  # it may hang up on us
    tick = controller.state()["tick"]
    wait_for(lambda: controller.state()["tick"] > tick)


def test_a_used_port_is_said_plainly(controller: ControllerProcess) -> None:
    with pytest.raises(UserError, match=r"127\.0\.0\.15:29999.*choose another"):
        ControllerProcess(host=controller.host).__enter__()

"""RTDE on the wire, against the sessions themselves: no sockets, no clock."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from tests.sim_backend.ur_controller.server.wire import RtdeServer
from toolee_robot.sim_backend.ur_controller.server.rtde_types import FORMATS, packet
from toolee_robot.sim_backend.ur_controller.server.rtde_variables import OUTPUTS


@pytest.mark.parametrize(("model", "version"), [("UR10", (3, 15)), ("UR10e", (5, 11))])
def test_reports_the_version_by_which_clients_choose_their_rate(model: str, version: tuple[int, int]) -> None:
    answer = RtdeServer(model).connect().ask("v")
    assert struct.unpack(">4I", answer)[:2] == version


@pytest.mark.parametrize("asked", [0, 3, 65535])
def test_refuses_unknown_protocol_versions(asked: int) -> None:
    server = RtdeServer()
    client = server.connect()
    assert client.ask("V", struct.pack(">H", asked)) == b"\x00"


@pytest.mark.parametrize("trailing", ["", ","])
def test_a_list_of_names_may_end_with_a_comma(trailing: str) -> None:
    client = RtdeServer().connect()
    payload = struct.pack(">d", 125.0) + f"timestamp,actual_q,runtime_state{trailing}".encode()
    assert client.ask("O", payload) == b"\x01DOUBLE,VECTOR6D,UINT32"


def test_nothing_is_sent_before_the_start_is_acknowledged() -> None:
    server = RtdeServer()
    client = server.connect()
    client.outputs("timestamp")
    client.session.text("too early")
    assert client.tick() == []
    assert client.send("S") == [("S", b"\x01")]
    ((kind, data),) = client.tick()
    assert (kind, data[0]) == ("U", 1)
    assert struct.unpack(">d", data[1:])[0] == pytest.approx(server.robot.timestamp)


def test_pause_stops_the_data_and_start_goes_on() -> None:
    client = RtdeServer().connect()
    client.outputs("timestamp")
    client.ask("S")
    assert client.tick()
    assert client.ask("P") == b"\x01"
    assert client.tick() == []
    client.ask("S")
    assert client.tick()


@pytest.mark.parametrize(("frequency", "expected"), [(125.0, 100), (62.5, 50), (25.0, 20), (1000.0, 100)])
def test_publishes_at_the_rate_asked_for(frequency: float, expected: int) -> None:
    client = RtdeServer().connect()
    client.outputs("timestamp", frequency=frequency)
    client.ask("S")
    assert sum(len(client.tick()) for _ in range(100)) == pytest.approx(expected, abs=1)


@pytest.mark.parametrize("frequency", [0.0, -1.0, float("nan"), float("inf")])
def test_refuses_a_rate_that_is_none(frequency: float) -> None:
    assert RtdeServer().connect().outputs("timestamp", frequency=frequency)[0] == 0


def test_every_variable_can_be_read_with_its_type_on_the_newest_version() -> None:
    server = RtdeServer("UR10e")
    server.robot.identity.version = (5, 99, 0, 0)
    client = server.connect()
    names = sorted(OUTPUTS)
    answer = client.outputs(*names)
    types = answer[1:].decode().split(",")
    assert answer[0] == 1
    assert len(types) == len(names)
    client.ask("S")
    ((_, data),) = client.tick()
    assert len(data) - 1 == struct.calcsize(">" + "".join(FORMATS[name] for name in types))


@pytest.mark.parametrize(
    ("model", "name", "has_it"),
    [
        ("UR10", "payload_inertia", True),
        ("UR10", "ft_raw_wrench", False),
        ("UR10e", "ft_raw_wrench", True),
        ("UR10e", "actual_qdd", False),
        ("UR10", "output_int_register_48", False),
        ("UR10", "no_such_thing", False),
    ],
)
def test_variables_exist_by_version(model: str, name: str, has_it: bool) -> None:
    answer = RtdeServer(model).connect().outputs(name)
    assert answer[0] == has_it
    assert (b"NOT_FOUND" in answer) is not has_it


def test_a_stream_that_a_late_computer_finds_is_caught_up_one_by_one_and_no_further() -> None:
    server = RtdeServer()
    client, registers = server.connect(), server.robot.registers
    client.inputs("input_int_register_0")

    def sent(*numbers: int) -> int:
        """What the next tick sees."""
        client.session.feed(b"".join(packet(ord("U"), b"\x01" + struct.pack(">i", number)) for number in numbers))
        return registers.int_in[0]

    server.inputs.catching_up = True
    assert sent(1, 2, 3, 4, 5) == 1
    client.tick()
    assert sent() == 2
    client.tick()
    assert sent(6) == 3
    server.inputs.catching_up = False
    client.tick()
    assert sent() == 6
    client.tick()
    assert sent(7) == 7
    assert sent(8, 9) == 9


def test_registers_belong_to_one_client_until_it_leaves() -> None:
    server = RtdeServer()
    first, second = server.connect(), server.connect()
    assert first.inputs("input_int_register_0")[0] == 1
    assert first.inputs("input_int_register_0", "input_double_register_0")[0] == 2
    assert second.inputs("input_int_register_0") == b"\x00IN_USE"
    assert second.inputs("input_int_register_24")[0] == 1
    first.session.close()
    assert second.inputs("input_int_register_0")[0] == 2


def test_packets_with_the_numbers_of_a_command_are_counted_and_kicks_of_the_watchdog_are_not() -> None:
    server = RtdeServer()
    client = server.connect()
    set_point, kick = ("input_int_register_0", "input_double_register_0"), ("input_int_register_0",)
    for number, names in enumerate((set_point, kick), start=1):
        assert client.inputs(*names)[0] == number
    client.send("U", struct.pack(">Bid", 1, 0, 0.5))
    client.send("U", struct.pack(">Bi", 2, 0))
    assert server.inputs.commands == 1


def test_outputs_by_rtde_inputs() -> None:
    server = RtdeServer()
    client = server.connect()
    client.inputs("standard_digital_output_mask", "standard_digital_output")
    client.inputs("speed_slider_mask", "speed_slider_fraction")
    client.inputs("external_force_torque")
    client.send("U", b"\x01" + bytes([0b101, 0b111]))
    client.send("U", b"\x02" + struct.pack(">Id", 1, 0.25))
    client.send("U", b"\x03" + struct.pack(">6d", *range(6)))
    machine = server.robot.machine
    assert machine.digital_out[:4] == [True, False, True, False]
    assert machine.speed_fraction == 0.25
    assert server.robot.registers.external_force_torque == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]


@pytest.mark.parametrize("payload", [b"", b"\x00", b"\x07\x00", b"\x01\x00", b"\x01" + b"\x00" * 5])
def test_data_that_fits_no_recipe_changes_nothing(payload: bytes) -> None:
    server = RtdeServer()
    client = server.connect()
    client.inputs("input_int_register_0")
    client.ask("S")
    before = list(server.robot.registers.int_in)
    ((kind, _),) = client.send("U", payload)
    assert kind == "M"
    assert server.robot.registers.int_in == before


def test_protocol_one_has_no_rate_and_no_recipe_number() -> None:
    client = RtdeServer().connect(version=1)
    assert client.ask("O", b"timestamp,robot_mode") == b"DOUBLE,INT32"
    client.ask("S")
    ((_, data),) = client.tick()
    assert len(data) == 12


def test_a_client_that_does_not_read_loses_data_and_nobody_else_does() -> None:
    server = RtdeServer()
    slow, quick = server.connect(), server.connect()
    for client in (slow, quick):
        client.outputs("timestamp")
        client.ask("S")
    slow.sink.backlog = 1 << 20
    assert slow.tick() == []
    assert quick.tick()
    assert slow.session.skipped == 1


@examples(100)
@given(st.data())
def test_packets_survive_any_cut(data: st.DataObject) -> None:
    stream = b"".join(
        [
            packet(ord("V"), b"\x00\x02"),
            packet(ord("v")),
            packet(ord("O"), struct.pack(">d", 125.0) + b"timestamp,actual_q,"),
            packet(ord("I"), b"input_int_register_3,"),
            packet(ord("U"), b"\x01" + struct.pack(">i", -7)),
            packet(ord("S")),
        ]
    )
    whole, pieces = RtdeServer().connect(), RtdeServer().connect()
    whole.session.feed(stream)
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        pieces.session.feed(stream[:size])
        stream = stream[size:]
    assert pieces.sink.take() == whole.sink.take()
    assert pieces.server.robot.registers.int_in[3] == -7

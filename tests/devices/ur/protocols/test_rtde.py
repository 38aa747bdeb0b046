"""The read-only clients: what a controller says comes through, and anything else is a typed error in time."""

from __future__ import annotations

import socket
import time
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.devices.ur.wire import FORMATS, data, packet, peer_sends, setup_reply, soon
from tests.errors import raises
from tests.examples import examples
from toolee_robot.devices.ur.protocols.rtde import PacketBuffer, RtdeReader
from toolee_robot.devices.ur.protocols.tcp import DashboardReader, ask_all, connect, receive_now
from toolee_robot.errors import DeviceError, NoAnswerError, ProtocolError

_number = st.floats(allow_nan=False)
_BY_TYPE: dict[str, st.SearchStrategy[object]] = {
    "DOUBLE": _number,
    "VECTOR6D": st.tuples(*[_number] * 6),
    "VECTOR3D": st.tuples(*[_number] * 3),
    "INT32": st.integers(-(2**31), 2**31 - 1),
    "UINT32": st.integers(0, 2**32 - 1),
    "UINT64": st.integers(0, 2**64 - 1),
    "BOOL": st.booleans(),
}
_typed = st.sampled_from(sorted(FORMATS)).flatmap(lambda t: st.tuples(st.just(t), _BY_TYPE[t]))


@given(
    packets=st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=300)), max_size=8),
    cuts=st.lists(st.integers(0, 2000), max_size=20),
)
def test_a_stream_cut_anywhere_gives_the_same_packets(packets: list[tuple[int, bytes]], cuts: list[int]) -> None:
    stream = b"".join(packet(bytes([kind]), payload) for kind, payload in packets)
    at = sorted({0, len(stream), *(c for c in cuts if c < len(stream))})
    buffer = PacketBuffer()
    found = [p for a, b in pairwise(at) for p in buffer.feed(stream[a:b])]
    assert found == packets


@given(fields=st.lists(_typed, min_size=1, max_size=8), text=st.binary(max_size=50), recipe=st.integers(0, 255))
def test_what_the_controller_says_comes_through(fields: list[tuple[str, object]], text: bytes, recipe: int) -> None:
    types, values = [t for t, _ in fields], [v for _, v in fields]
    names = [f"variable_{i}" for i in range(len(fields))]
    answers = [
        packet(b"V", b"\x01"),
        packet(b"v", bytes(range(16))),
        setup_reply(types, recipe),
        packet(b"M", text),  # a text message in between is passed over
        data(types, values, recipe),
    ]
    with peer_sends(*answers) as sock:
        reader = RtdeReader(sock)
        reader.negotiate(soon())
        assert reader.version(soon()) == (0x00010203, 0x04050607, 0x08090A0B, 0x0C0D0E0F)
        assert reader.subscribe(names, 125.0, soon()) == []
        assert reader.read(soon()).values == dict(zip(names, values, strict=True))
        with raises(NoAnswerError, code="no_answer.connection_lost"):
            reader.read(soon())


@given(count=st.integers(0, 5), after=st.integers(0, 5), cut=st.integers(1, 8))
def test_all_that_has_come_is_read_at_once_and_nobody_waits_for_more(count: int, after: int, cut: int) -> None:
    types = ["DOUBLE"]
    readings = [packet(b"M", b"text") * (i == after) + data(types, [float(i)]) for i in range(count + 1)]
    half = packet(b"V", b"\x01") + setup_reply(types) + b"".join(readings[:-1]) + readings[-1][:cut]
    ours, theirs = socket.socketpair()
    with ours, theirs:
        theirs.sendall(half)
        reader = RtdeReader(ours)
        reader.negotiate(soon())
        reader.subscribe(["timestamp"], 125.0, soon())
        assert [sample.values["timestamp"] for sample in reader.arrived()] == list(range(count))
        assert reader.arrived() == []
        theirs.sendall(readings[-1][cut:])
        assert [sample.values["timestamp"] for sample in reader.arrived()] == [count]
        theirs.close()
        with raises(NoAnswerError, code="no_answer.connection_lost"):
            reader.arrived()


def _talk(sock_bytes: tuple[bytes, ...], pause: float = 0.0, seconds: float = 10.0, close: bool = True) -> None:
    deadline = soon(seconds)
    with peer_sends(*sock_bytes, pause=pause, close=close) as sock:
        reader = RtdeReader(sock)
        reader.negotiate(deadline)
        version = reader.version(deadline)
        assert len(version) == 4
        if not reader.subscribe(["timestamp", "actual_q"], 125.0, deadline):
            for _ in range(1000):
                values = reader.read(deadline).values
                assert isinstance(values["timestamp"], float)


_GOOD = (
    packet(b"V", b"\x01")
    + packet(b"v", bytes(16))
    + setup_reply(["DOUBLE", "VECTOR6D"])
    + data(["DOUBLE", "VECTOR6D"], [1.0, (0.0,) * 6])
)


@examples(150)
@given(st.binary(max_size=400))
def test_any_bytes_are_a_typed_error(garbage: bytes) -> None:
    with pytest.raises(DeviceError):
        _talk((garbage,))


@examples(200)
@given(
    at=st.integers(0, len(_GOOD) - 1),
    byte=st.integers(0, 255),
    cut=st.integers(0, len(_GOOD)),
    insert=st.binary(max_size=5),
)
def test_a_damaged_conversation_is_a_typed_error(at: int, byte: int, cut: int, insert: bytes) -> None:
    damaged = bytearray(_GOOD)
    damaged[at] = byte
    with pytest.raises(DeviceError):  # at the latest because the peer has closed
        _talk((bytes(damaged[:cut]) + insert + bytes(damaged[cut:]),))


@pytest.mark.parametrize(
    ("chunks", "pause", "error"),
    [
        ((), 0.0, NoAnswerError),  # silence
        (tuple(bytes([b]) for b in _GOOD), 0.05, NoAnswerError),  # a byte now and then
        ((packet(b"M", b"text") * 200_000,), 0.0, NoAnswerError),  # messages without end
    ],
)
def test_a_slow_or_chatty_controller_does_not_hold_us_up(
    chunks: tuple[bytes, ...], pause: float, error: type[DeviceError]
) -> None:
    began = time.monotonic()
    with pytest.raises(error):
        _talk(chunks, pause, seconds=0.2, close=False)
    assert time.monotonic() - began < 3.0


@pytest.mark.parametrize(
    ("chunks", "code"),
    [
        ((packet(b"V", b"\x00"),), "protocol.rtde_version"),
        ((packet(b"V", b"\x01") + packet(b"v", b"\x01"),), "protocol.rtde_reply"),
        ((packet(b"V", b"\x01") + packet(b"v", bytes(16)) + packet(b"O", b""),), "protocol.rtde_reply"),
        (
            (packet(b"V", b"\x01") + packet(b"v", bytes(16)) + packet(b"O", b"\x01DOUBLE,QUATERNION"),),
            "protocol.rtde_type",
        ),
        ((packet(b"V", b"\x01") + packet(b"v", bytes(16)) + packet(b"O", b"\x01\xff,\xfe"),), "protocol.not_text"),
        (
            (packet(b"V", b"\x01") + packet(b"v", bytes(16)) + setup_reply(["DOUBLE", "VECTOR6D"])[:-1] + b"\x00",),
            "protocol.rtde_refused",
        ),
        ((_GOOD + data(["DOUBLE"], [1.0]),), "protocol.rtde_packet"),
        ((_GOOD + data(["DOUBLE", "VECTOR6D"], [1.0, (0.0,) * 6], recipe=9),), "protocol.rtde_packet"),
        ((b"HTTP/1.1 400 Bad Request\r\n\r\n" + bytes(40_000),), "protocol.message_size"),
        ((b"\x00\x01\x02\x03",), "protocol.message_size"),
    ],
)
def test_what_is_wrong_is_said(chunks: tuple[bytes, ...], code: str) -> None:
    with raises(ProtocolError, code=code):
        _talk(chunks)


_HELLO = b"Connected: Universal Robots Dashboard Server\n"


@given(st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"]), min_size=1, max_size=80))
def test_the_dashboards_answer_comes_through(answer: str) -> None:
    with peer_sends(_HELLO, answer.encode() + b"\n") as sock:
        reader = DashboardReader(sock, soon())
        known = not answer.lower().startswith(("could not understand", "unknown command"))
        assert reader.ask("get robot model", soon()) == (answer if known else None)


@examples(100)
@given(st.binary(max_size=300), st.booleans())
def test_any_bytes_to_the_dashboard_are_an_answer_or_a_typed_error(garbage: bytes, greeted: bool) -> None:
    with peer_sends((_HELLO if greeted else b"") + garbage) as sock:
        try:
            reader = DashboardReader(sock, soon())
            for _ in range(400):
                assert isinstance(reader.ask("robotmode", soon()), str | None)
        except DeviceError:
            pass
        else:
            pytest.fail("400 answers from 300 bytes")


def test_a_line_without_end_is_not_read_for_ever() -> None:
    with peer_sends(b"dashboard" * 100_000) as sock, raises(ProtocolError, code="protocol.line_too_long"):
        DashboardReader(sock, soon(5.0))


def test_nobody_there_is_said_at_once() -> None:
    began = time.monotonic()
    with pytest.raises(NoAnswerError, match=r"127\.0\.0\.41:30004.*refused"):
        RtdeReader.connect("127.0.0.41", soon())
    with raises(NoAnswerError, code="no_answer.connect"):
        ask_all("127.0.0.41", ["robotmode"], soon())
    with raises(NoAnswerError, code="no_answer.host_unknown"):
        connect("no.such.robot.invalid", 30004, soon(0.5))
    assert time.monotonic() - began < 3.0


def test_what_waited_to_be_read_says_when_it_came() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        ours = connect("127.0.0.1", server.getsockname()[1], soon())
        theirs, _ = server.accept()
        with ours, theirs:
            assert receive_now(ours)[0] == b""
            time.sleep(0.05)  # the kernel begins to stamp
            began = time.monotonic()
            theirs.sendall(b"early")
            sent = time.monotonic()
            time.sleep(0.1)
            data, came = receive_now(ours)
            assert data == b"early"
            assert began - 0.05 < came < sent + 0.05

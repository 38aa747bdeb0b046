"""The bytes of the RH56 on both wires: the maker's and the specification's examples, and what may become of a reply."""

from __future__ import annotations

import struct
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.devices.hands.recorded_ability import PADS, PIECES, POSITIONS, WHOLE
from tests.errors import raises
from toolee_robot.devices.hands import inspire
from toolee_robot.devices.hands.ability import (
    REPLY_LENGTH,
    FrameReader,
    Header,
    Touch,
    command,
    decode,
)
from toolee_robot.devices.hands.inspire import (
    ANGLE_ACT,
    ANGLE_SET,
    CLEAR_ERROR,
    FORCE_SET,
    SPEED_SET,
    InspireLine,
    ModbusLine,
    SerialLine,
    condition,
    serial_reply,
)
from toolee_robot.devices.hands.ports import Port
from toolee_robot.errors import DeviceError, NoAnswerError, ProtocolError
from toolee_robot.sim_backend.hands.inspire import reply

WRITTEN = "90 EB 01 04 12 CE 05 01 EB"
HEAD = bytes.fromhex("90 EB 01 0F 11 0A 06")
"""Of the reply to a read of the angles."""


class Tape(Port):
    """A port that keeps what is sent, and answers it."""

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        super().__init__("tape")
        self.answer, self.sent, self._waiting = answer, list[bytes](), b""

    def close(self) -> None:
        pass

    def _send(self, data: bytes) -> bool:
        self.sent.append(data)
        self._waiting += self.answer(data)
        return True

    def _receive(self, within: float) -> bytes:  # noqa: ARG002
        waiting, self._waiting = self._waiting, b""
        return waiting


def serial_line(monkeypatch: pytest.MonkeyPatch, answer: Callable[[bytes], bytes]) -> tuple[SerialLine, Tape]:
    tape = Tape(answer)
    monkeypatch.setattr(inspire, "SerialPort", lambda *_: tape)
    monkeypatch.setattr(inspire, "ANSWER_S", 0.002)
    return SerialLine("tape", 1), tape


def framed(request: bytes, pdu: bytes, shift: int = 0) -> bytes:
    transaction = (int.from_bytes(request[:2], "big") + shift) & 0xFFFF
    return struct.pack(">HHHB", transaction, 0, 1 + len(pdu), request[6]) + pdu


def modbus_answer(request: bytes) -> bytes:
    """Angles of 1000, and every write acknowledged."""
    if request[7] == 3:
        count = int.from_bytes(request[10:12], "big")
        return framed(request, bytes((3, 2 * count)) + b"\x03\xe8" * count)
    return framed(request, request[7:12])


def modbus_line(monkeypatch: pytest.MonkeyPatch) -> tuple[ModbusLine, Tape]:
    tape = Tape(modbus_answer)
    monkeypatch.setattr(inspire, "TcpPort", lambda *_: tape)
    monkeypatch.setattr(inspire, "ANSWER_S", 0.002)
    return ModbusLine("tape", 1), tape


def put(line: InspireLine, register: int, *values: int) -> None:
    line.write(register, struct.pack(f"{line.order}{len(values)}h", *values))


@pytest.mark.parametrize(
    ("register", "values", "frame"),
    [
        (ANGLE_SET, (1000, 900), "EB 90 01 07 12 CE 05 E8 03 84 03 5F"),
        (ANGLE_SET, (1000,) * 6, "EB 90 01 0F 12 CE 05 " + "E8 03 " * 6 + "77"),
        (ANGLE_SET, (100, 100, 100, 100, 2000, 0), "EB 90 01 0F 12 CE 05 64 00 64 00 64 00 64 00 D0 07 00 00 5C"),
        (FORCE_SET, (500,) * 6, "EB 90 01 0F 12 DA 05 " + "F4 01 " * 6 + "BF"),
        (SPEED_SET, (25,) * 6, "EB 90 01 0F 12 F2 05 " + "19 00 " * 6 + "AF"),
        (CLEAR_ERROR, (), "EB 90 01 04 12 EC 03 01 07"),
    ],
)
def test_requests_are_the_makers(
    monkeypatch: pytest.MonkeyPatch, register: int, values: tuple[int, ...], frame: str
) -> None:
    line, tape = serial_line(monkeypatch, lambda sent: reply(1, 0x12, int.from_bytes(sent[5:7], "little"), b"\x01"))
    if values:
        put(line, register, *values)
    else:
        line.write(register, line.one)
    assert tape.sent == [bytes.fromhex(frame)]


def test_the_makers_replies_are_understood(monkeypatch: pytest.MonkeyPatch) -> None:
    said = bytes.fromhex("90 EB 01 0F 11 0A 06 64 00 64 00 64 00 64 00 D0 07 00 00 98")
    line, tape = serial_line(monkeypatch, lambda _: said)
    assert line.numbers(ANGLE_ACT) == (100, 100, 100, 100, 2000, 0)
    assert tape.sent == [bytes.fromhex("EB 90 01 04 11 0A 06 0C 32")]
    line, _ = serial_line(monkeypatch, lambda _: bytes.fromhex(WRITTEN))
    put(line, ANGLE_SET, *(1000,) * 6)
    line, _ = serial_line(monkeypatch, lambda _: reply(1, 0x12, ANGLE_SET, b"\x00"))
    with raises(DeviceError, "device.hand_refuses"):
        put(line, ANGLE_SET, *(1000,) * 6)


@given(st.binary(min_size=12, max_size=12), st.integers(0, 19), st.integers(1, 255), st.integers(0, 19))
def test_a_reply_with_a_changed_byte_or_a_part_of_one_is_refused(data: bytes, at: int, change: int, cut: int) -> None:
    frame = reply(1, 0x11, ANGLE_ACT, data)
    assert serial_reply(frame, HEAD, 12) == data
    assert serial_reply(frame[:at] + bytes([frame[at] ^ change]) + frame[at + 1 :], HEAD, 12) is None
    assert serial_reply(frame[:cut], HEAD, 12) is None
    assert serial_reply(reply(1, 0x11, ANGLE_SET, data), HEAD, 12) is None, "of another register"


@pytest.mark.parametrize(
    ("ask", "frame"),
    [
        (lambda line: line.read(ANGLE_ACT, 12), "00 06 01 03 06 0A 00 06"),
        (lambda line: line.write(CLEAR_ERROR, line.one), "00 06 01 06 03 EC 00 01"),
        (lambda line: put(line, ANGLE_SET, 1000, 1000, 1000, 1000, 1000, -1),
         "00 13 01 10 05 CE 00 06 0C " + "03 E8 " * 5 + "FF FF"),
    ],
)  # fmt: skip
def test_requests_on_modbus(monkeypatch: pytest.MonkeyPatch, ask: Callable[[ModbusLine], object], frame: str) -> None:
    line, tape = modbus_line(monkeypatch)
    ask(line)
    assert tape.sent[-1][2:4] == b"\x00\x00"
    assert tape.sent[-1][4:] == bytes.fromhex(frame)
    transactions = [sent[:2] for sent in tape.sent]
    assert len(set(transactions)) == len(transactions), "each has an identifier of its own"


RIGHT = struct.pack(">6h", 1, 2, 3, 4, 5, 6)
MODBUS: dict[str, tuple[Callable[[bytes, bytes], bytes], bool]] = {
    "whole": (lambda _, right: right, True),
    "doubled": (lambda _, right: right + right, True),
    "garbage before": (lambda _, right: b"\x01\x02\x03" + right, True),
    "another transaction's before": (lambda sent, right: framed(sent, b"\x03\x0c" + bytes(12), 7) + right, True),
    "another unit's before": (lambda _, right: right[:6] + b"\x02" + right[7:9] + bytes(12) + right, True),
    "of another transaction": (lambda sent, _: framed(sent, b"\x03\x0c" + bytes(12), -1), False),
    "of another unit": (lambda _, right: right[:6] + b"\x02" + right[7:], False),
    "short": (lambda _, right: right[:-1], False),
    "to a write": (lambda sent, _: framed(sent, bytes.fromhex("10 05 CE 00 06")), False),
    "of a busy hand": (lambda sent, _: framed(sent, b"\x83\x06"), False),
}
"""What comes instead of a reply, and whether it is understood."""


@pytest.mark.parametrize("kind", MODBUS)
def test_a_reply_on_modbus_is_understood_or_asked_for_again(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    line, tape = modbus_line(monkeypatch)
    answer, good = MODBUS[kind]
    tape.answer = lambda sent: answer(sent, framed(sent, b"\x03\x0c" + RIGHT))
    if good:
        assert line.read(ANGLE_ACT, 12) == RIGHT
    else:
        with raises(NoAnswerError, "no_answer.hand_silent"):
            line.read(ANGLE_ACT, 12)


@pytest.mark.parametrize("code", [1, 2, 3])
def test_an_exception_that_asking_again_does_not_change_is_a_refusal(
    monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    line, tape = modbus_line(monkeypatch)
    tape.answer = lambda sent: framed(sent, bytes((sent[7] | 0x80, code)))
    with raises(DeviceError, "device.hand_refuses") as refused:
        line.read(ANGLE_ACT, 12)
    assert f"exception {code}" in str(refused.value)


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_state_as_the_hand_sends_it(order: str) -> None:
    words = (200, -3, 0, 800, 12, 1, 20, 20, 20, 150, 20, 20)
    data = struct.pack(f"{order}12h", *words) + bytes([0, 1, 0, 2, 0, 0, 2, 6, 3, 7, 255, 2]) + bytes(range(30, 36))
    reading = condition(1.0, (1000, 900, 0, 0, 0, 0), data, order)
    assert tuple(reading.forces) == words[:6]
    assert tuple(reading.closures[:2]) == (0.0, 100.0)
    assert reading.temperature == 35.0
    assert reading.trouble == "ring: stalled, index: too hot"
    assert reading.fault is not None
    assert reading.fault.code == "device.hand_over_temperature", "the gravest"
    healthy = condition(1.0, (1000,) * 6, data[:24] + bytes(6) + data[30:], order)
    assert (healthy.fault, healthy.trouble) == (None, "")
    for at, value in ((24, 0x20), (30, 4), (36, 200)):
        with raises(ProtocolError, "protocol.hand_values"):
            condition(1.0, (1000,) * 6, data[:at] + bytes([value]) + data[at + 1 :], order)
    with raises(ProtocolError, "protocol.hand_values"):
        condition(1.0, (0, 0, 5000, 0, 0, 0), data, order)


def stuff(frame: bytes) -> bytes:
    return b"\x7e" + frame.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e") + b"\x7e"


def checksum(body: bytes) -> int:
    return -sum(body) & 0xFF


def reply_of_ability(
    header: int, positions: tuple[int, ...], limited: int = 0, changed: tuple[int, int] = (0, 0)
) -> bytes:
    """The last: a place in the body, and what is wrong there, which its checksum does not know."""
    body = bytearray([header]) + b"".join(struct.pack("<hh", p, 7) for p in positions) + bytes(45) + bytes([limited])
    right = checksum(bytes(body))
    body[changed[0]] ^= changed[1]
    return stuff(bytes([*body, right]))


def test_the_makers_recorded_replies_are_understood() -> None:
    reader = FrameReader()
    found = [reader.feed(piece) for piece in PIECES]
    assert [i for i, frames in enumerate(found) if frames] == list(WHOLE)
    first = decode(found[0][0])
    assert first.header == Header.POSITION_VELOCITY
    np.testing.assert_allclose(first.positions, POSITIONS, atol=0.006)
    assert tuple(first.touch) == PADS
    assert not first.limited.any()


COMMANDS = [
    (command(0x50, Header.POSITION_CURRENT, np.zeros(6)), "7E 50 10 " + "00 " * 12 + "A0 7E"),
    # 50 deg x 32767 / 150 = 10922 = 0x2AAA; the rotator has the other sign
    (command(0x50, Header.POSITION_VELOCITY, np.array((50.0,) * 5 + (-50.0,))),
     "7E 50 11 " + "AA 2A " * 5 + "56 D5 " + "50 7E"),
    # 28 deg = 6116.5 -> 0x17E4; 0.577 deg = 126 = 0x7E and 0.572 deg = 125 = 0x7D are escaped
    (command(0x50, Header.POSITION_CURRENT, np.array((126 * 150 / 32767, 125 * 150 / 32767, 0.0, 0.0, 0.0, 0.0))),
     "7E 50 10 7D 5E 00 7D 5D 00 " + "00 " * 8 + "A5 7E"),
    (command(0x50, Header.READ_CURRENT), "7E 50 A0 10 7E"),
    (command(0x50, Header.READ_VELOCITY), "7E 50 A1 0F 7E"),
]  # fmt: skip


@pytest.mark.parametrize(("built", "frame"), COMMANDS)
def test_commands_are_as_the_maker_says(built: bytes, frame: str) -> None:
    assert built == bytes.fromhex(frame)


@given(st.binary(min_size=REPLY_LENGTH - 1, max_size=REPLY_LENGTH - 1), st.binary(max_size=100), st.data())
def test_a_reply_is_found_after_whatever_noise_and_wherever_it_is_cut(
    body: bytes, noise: bytes, data: st.DataObject
) -> None:
    frame = body + bytes([checksum(body)])
    line = noise + b"\x7e" + stuff(frame)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(line)), max_size=4)))
    reader = FrameReader()
    found = [reader.feed(line[a:b]) for a, b in zip([0, *cuts], [*cuts, len(line)], strict=True)]
    assert [one for some in found for one in some][-1:] == [frame]


@given(st.integers(0, 70), st.integers(1, 255))
def test_a_reply_of_the_ability_hand_with_a_changed_byte_is_refused(at: int, change: int) -> None:
    reader, whole = FrameReader(), reply_of_ability(0x10, (5,) * 6)
    assert reader.feed(reply_of_ability(0x10, (5,) * 6, changed=(at, change))) == []
    (frame,) = reader.feed(whole)
    np.testing.assert_allclose(decode(frame).positions, 5 * 150 / 32767)


@pytest.mark.parametrize("header", [0x00, 0x12, 0x41])
def test_a_reply_in_another_format_is_none_to_a_command(header: int) -> None:
    found = FrameReader().feed(reply_of_ability(header, (5,) * 6))
    with suppress(ProtocolError):
        assert all(decode(frame).header not in {*Header} for frame in found)


def test_what_no_hand_says_is_refused() -> None:
    with raises(ProtocolError, "protocol.hand_values"):
        decode(FrameReader().feed(reply_of_ability(0x10, (32767, 0, 0, 0, 0, 0)))[0])
    found = decode(FrameReader().feed(reply_of_ability(0x10, (0,) * 6, limited=0xE1))[0])
    assert found.limited.tolist() == [True, False, False, False, False, True], "two bits are ignored"


def test_forces_are_those_beyond_the_pads_at_rest() -> None:
    touch = Touch()
    np.testing.assert_array_equal(touch.newtons(np.array(PADS)), np.zeros(5))
    pressed = np.array(PADS)
    pressed[7] += 1000  # the middle finger's second pad
    force = touch.newtons(pressed)
    # ICD 3.4.6: R = 33000 / V + 10000, F = 121591 / R + const.
    resistance = [33000.0 / (counts * 3.3 / 4096.0) + 10000.0 for counts in (546, 1546)]
    assert force[1] == pytest.approx(121591.0 / resistance[1] - 121591.0 / resistance[0])
    np.testing.assert_array_equal(np.delete(force, 1), np.zeros(4))

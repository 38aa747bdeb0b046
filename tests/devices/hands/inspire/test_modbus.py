"""The bytes of Modbus-TCP: the specification's examples, the hand's registers, and whatever may become of a reply."""

from __future__ import annotations

import random
import struct
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterRequest,
)

from toolee_robot.devices.hands.inspire.frames import WRITTEN
from toolee_robot.devices.hands.inspire.modbus import ReplySearch, Request, read_request, write_request
from toolee_robot.devices.hands.inspire.registers import (
    ANGLE_ACT,
    ANGLE_SET,
    CLEAR_ERROR,
    CONDITION_LENGTH,
    FORCE_ACT,
    Fault,
    Status,
    pack,
    unpack_angles,
    unpack_condition,
)

PDUS = [
    (read_request(0, 1, 107, 6), "03 00 6B 00 03", "03 06 02 2B 00 00 00 64", "02 2B 00 00 00 64"),
    (write_request(0, 1, 1, b"\x00\x03"), "06 00 01 00 03", "06 00 01 00 03", WRITTEN.hex()),
    (write_request(0, 1, 1, b"\x00\x0a\x01\x02"), "10 00 01 00 02 04 00 0A 01 02", "10 00 01 00 02", WRITTEN.hex()),
]
"""The examples of the MODBUS Application Protocol V1.1b3, sections 6.3, 6.6 and 6.12: request, reply, what it says."""


def framed(transaction: int, pdu: str) -> bytes:
    body = bytes.fromhex(pdu)
    return struct.pack(">HHHB", transaction, 0, 1 + len(body), 1) + body


@pytest.mark.parametrize(("request_", "asked", "answered", "said"), PDUS)
def test_the_specifications_examples(request_: Request, asked: str, answered: str, said: str) -> None:
    assert request_.encoded == framed(0, asked)
    assert ReplySearch(request_).feed(framed(0, answered)) == bytes.fromhex(said)


def test_the_specifications_exception() -> None:
    """Section 7: a server that has no coil 1185 answers function 01 by 81 02."""
    for request_, asked, _, _ in PDUS:
        search = ReplySearch(request_)
        assert search.feed(framed(0, f"{0x80 | int(asked[:2], 16):02X} 02")) is None
        assert search.exception == 2
        assert search.over
        assert "exception 2" in search.refusal
        busy = ReplySearch(request_)
        assert busy.feed(framed(0, f"{0x80 | int(asked[:2], 16):02X} 06")) is None
        assert busy.over
        assert not busy.refusal


@pytest.mark.parametrize(
    ("request_", "frame"),
    [
        (read_request(1, 1, ANGLE_ACT, 12), "00 01 00 00 00 06 01 03 06 0A 00 06"),
        (read_request(2, 1, FORCE_ACT, CONDITION_LENGTH), "00 02 00 00 00 06 01 03 06 2E 00 15"),
        (write_request(3, 1, CLEAR_ERROR, b"\x00\x01"), "00 03 00 00 00 06 01 06 03 EC 00 01"),
        (write_request(0xFFFF, 1, ANGLE_SET, pack((1000, 1000, 1000, 1000, 1000, -1), ">")),
         "FF FF 00 00 00 13 01 10 05 CE 00 06 0C " + "03 E8 " * 5 + "FF FF"),
    ],
)  # fmt: skip
def test_requests_to_the_hand(request_: Request, frame: str) -> None:
    assert request_.encoded == bytes.fromhex(frame)


def test_a_state_as_the_hand_sends_it() -> None:
    words = (200, -3, 0, 800, 12, 1, 20, 20, 20, 150, 20, 20)
    data = struct.pack(">12h", *words) + bytes([0, 1, 0, 2, 0, 0]) + bytes([2, 6, 3, 7, 255, 2]) + bytes(range(30, 36))
    reply = bytes.fromhex("00 07 00 00 00 2D 01 03 2A") + data
    payload = ReplySearch(read_request(7, 1, FORCE_ACT, CONDITION_LENGTH)).feed(reply)
    assert payload is not None
    condition = unpack_condition(payload, ">")
    assert condition.forces == words[:6]
    assert condition.currents == words[6:]
    assert condition.faults[1:4] == (Fault.STALL, Fault(0), Fault.OVER_TEMPERATURE)
    assert condition.statuses[:3] == (Status.POSITION_REACHED, Status.STALLED, Status.FORCE_REACHED)
    assert condition.temperatures == (30, 31, 32, 33, 34, 35)


requests = st.one_of(
    st.builds(
        read_request,
        st.integers(0, 0xFFFF), st.integers(1, 254), st.integers(0, 0xFFFF), st.integers(1, 125).map(lambda n: 2 * n),
    ),
    st.builds(
        write_request,
        st.integers(0, 0xFFFF), st.integers(1, 254), st.integers(0, 0xFFFF),
        st.integers(1, 123).flatmap(lambda n: st.binary(min_size=2 * n, max_size=2 * n)),
    ),
)  # fmt: skip


@given(requests)
def test_pymodbus_understands_every_request(request_: Request) -> None:
    used, pdu = FramerSocket(DecodePDU(True)).handleFrame(request_.encoded, 0, 0)
    assert pdu is not None
    assert (used, pdu.transaction_id, pdu.dev_id) == (len(request_.encoded), request_.transaction, request_.unit)
    assert pdu.address == request_.register
    if request_.data:
        assert isinstance(pdu, WriteSingleRegisterRequest | WriteMultipleRegistersRequest)
        assert struct.pack(f">{len(pdu.registers)}H", *pdu.registers) == request_.data
    else:
        assert isinstance(pdu, ReadHoldingRegistersRequest)
        assert pdu.count == request_.count


@given(requests, st.data())
def test_every_reply_of_pymodbus_is_understood_wherever_it_is_cut(request_: Request, data: st.DataObject) -> None:
    words = data.draw(st.lists(st.integers(0, 0xFFFF), min_size=request_.count, max_size=request_.count))
    said, frame = WRITTEN, request_.encoded  # function 06 is answered by its echo
    unit, transaction = request_.unit, request_.transaction
    if not request_.data:
        frame = FramerSocket(DecodePDU(True)).buildFrame(
            ReadHoldingRegistersResponse(registers=words, dev_id=unit, transaction_id=transaction)
        )
        said = struct.pack(f">{len(words)}H", *words)
    elif request_.count > 1:
        reply = WriteMultipleRegistersResponse(
            address=request_.register, count=request_.count, dev_id=unit, transaction_id=transaction
        )
        frame = FramerSocket(DecodePDU(True)).buildFrame(reply)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(frame)), max_size=4)))
    search = ReplySearch(request_)
    pieces = [frame[a:b] for a, b in zip([0, *cuts], [*cuts, len(frame)], strict=True)]
    found = [search.feed(piece) for piece in pieces]
    assert found.index(said) == next(i for i, end in enumerate([*cuts, len(frame)]) if end == len(frame))
    refusal = ExceptionResponse(request_.function, 2, device_id=unit, transaction=transaction)
    refused = ReplySearch(request_)
    assert refused.feed(FramerSocket(DecodePDU(True)).buildFrame(refusal)) is None
    assert refused.exception == 2


@given(requests, st.binary(max_size=300))
def test_bytes_at_random_never_raise_and_the_reply_after_them_is_found(request_: Request, noise: bytes) -> None:
    search = ReplySearch(request_)
    assert search.feed(noise) is None
    data = bytes(request_.reply_length)
    assert (data or WRITTEN) in (search.feed(request_.reply_head(0) + data), search.feed(request_.reply_head(0) + data))


@pytest.mark.parametrize(
    ("unit", "register", "size"),
    [(0, 1, 2), (255, 1, 2), (1, -1, 2), (1, 1 << 16, 2), (1, 1, 0), (1, 1, 3), (1, 1, 252)],
)
def test_no_request_is_built_that_no_hand_understands(unit: int, register: int, size: int) -> None:
    match = "hand or register" if size == 2 else "registers"
    with pytest.raises(ValueError, match=match):
        read_request(0, unit, register, size)
    with pytest.raises(ValueError, match=match):
        write_request(0, unit, register, bytes(size))


HARMLESS = ("whole", "doubled", "foreign unit", "foreign transaction", "late", "garbage")
REFUSED = ("framing", "short", "gap", "inserted", "exception", "another register", "wrong unit", "wrong transaction")


def mutated(kind: str, frame: bytes, request_: Request, draw: random.Random) -> bytes:
    at = draw.randrange(len(frame))
    if kind == "framing":
        at = draw.randrange(9)
        return frame[:at] + bytes([frame[at] ^ draw.randint(1, 255)]) + frame[at + 1 :]
    if kind == "short":
        return frame[:at]
    if kind == "gap":
        return frame[:at] + frame[at + 1 :]
    if kind == "inserted":
        return frame[:at] + draw.randbytes(draw.randint(1, 3)) + frame[at:]
    if kind == "exception":
        return request_.exception_head(0) + bytes([draw.randint(1, 11)])
    if kind == "another register":
        return framed(request_.transaction, "10 05 CE 00 06")
    if kind in ("wrong unit", "foreign unit"):
        other = frame[:6] + bytes([frame[6] % 254 + 1]) + frame[7:9] + draw.randbytes(12)
        return other + frame * (kind == "foreign unit")
    if kind in ("wrong transaction", "foreign transaction"):
        other = ((request_.transaction + draw.randint(1, 0xFFFF)) & 0xFFFF).to_bytes(2, "big")
        return other + frame[2:9] + draw.randbytes(12) + frame * (kind == "foreign transaction")
    if kind == "late":
        older = read_request((request_.transaction - draw.randint(1, 3)) & 0xFFFF, request_.unit, ANGLE_ACT, 12)
        return older.reply_head(0) + draw.randbytes(12) + frame
    if kind == "garbage":
        return draw.randbytes(draw.randint(1, 40)) + frame
    return frame + frame if kind == "doubled" else frame


def test_ten_thousand_mutated_replies_are_decoded_right_or_refused() -> None:
    """But for a wrong byte in the data, which is for TCP's checksum to see."""
    draw = random.Random(6000)
    outcomes: Counter[tuple[str, str]] = Counter()
    kinds = HARMLESS + REFUSED
    for i in range(10_000):
        request_ = read_request(draw.randint(0, 0xFFFF), draw.randint(1, 254), ANGLE_ACT, 12)
        angles = tuple(draw.randint(0, 1000) for _ in range(6))
        kind = kinds[i % len(kinds)]
        frame = request_.reply_head(0) + pack(angles, ">")
        search = ReplySearch(request_)
        sent = mutated(kind, frame, request_, draw)
        cut = draw.randrange(len(sent)) if sent and kind in HARMLESS else 0
        found = search.feed(sent[:cut]) or search.feed(sent[cut:])
        if found is not None:
            assert unpack_angles(found, ">") == angles, f"case {i}: {kind}"
        outcomes[kind, "refused" if found is None else "decoded"] += 1
    for kind in HARMLESS:
        assert outcomes[kind, "refused"] == 0, kind
    for kind in REFUSED:
        if kind != "inserted":  # before the frame it is garbage
            assert outcomes[kind, "decoded"] == 0, kind


def test_a_shifted_transaction_identifier_is_found_only_where_it_is_looked_for() -> None:
    request_ = read_request(0, 1, ANGLE_ACT, 2)
    frame = request_.reply_head(-1) + b"\x03\xe8"
    assert frame[:2] == b"\xff\xff"
    assert ReplySearch(request_).feed(frame) is None
    search = ReplySearch(request_, (0, -1, 1))
    assert search.feed(frame) == b"\x03\xe8"
    assert search.shift == -1

"""The bytes of the RH56's RS-485 frames: the maker's own examples, and whatever may become of a reply on the line."""

from __future__ import annotations

import random
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.errors import raises
from toolee_robot.devices.hands.inspire.frames import (
    ReplySearch,
    Request,
    checksum,
    read_request,
    write_request,
)
from toolee_robot.devices.hands.inspire.registers import (
    ANGLE_ACT,
    ANGLE_SET,
    CLEAR_ERROR,
    ERROR,
    FORCE_SET,
    SPEED_SET,
    Fault,
    Status,
    pack,
    unpack_angles,
    unpack_condition,
)
from toolee_robot.errors import ProtocolError


def reply(request: Request, payload: bytes) -> bytes:
    body = request.reply_prefix[2:] + payload
    return request.reply_prefix + payload + bytes([checksum(body)])


GOLDEN = [
    (read_request(1, ANGLE_ACT, 12), "EB 90 01 04 11 0A 06 0C 32"),
    (read_request(1, ERROR, 18), "EB 90 01 04 11 46 06 12 74"),
    (write_request(1, ANGLE_SET, bytes.fromhex("E8 03 84 03")), "EB 90 01 07 12 CE 05 E8 03 84 03 5F"),
    (write_request(1, ANGLE_SET, pack((1000,) * 6, "<")), "EB 90 01 0F 12 CE 05 " + "E8 03 " * 6 + "77"),
    (write_request(1, ANGLE_SET, pack((100, 100, 100, 100, 2000, 0), "<")),
     "EB 90 01 0F 12 CE 05 64 00 64 00 64 00 64 00 D0 07 00 00 5C"),
    (write_request(1, FORCE_SET, pack((500,) * 6, "<")), "EB 90 01 0F 12 DA 05 " + "F4 01 " * 6 + "BF"),
    (write_request(1, SPEED_SET, pack((25,) * 6, "<")), "EB 90 01 0F 12 F2 05 " + "19 00 " * 6 + "AF"),
    (write_request(1, CLEAR_ERROR, b"\x01"), "EB 90 01 04 12 EC 03 01 07"),
    (write_request(1, 1009, b"\x01"), "EB 90 01 04 12 F1 03 01 0C"),
]  # fmt: skip


@pytest.mark.parametrize(("request_", "frame"), GOLDEN)
def test_requests_are_the_makers(request_: Request, frame: str) -> None:
    assert request_.encoded == bytes.fromhex(frame)


def test_the_makers_replies_are_understood() -> None:
    search = ReplySearch(read_request(1, ANGLE_ACT, 12))
    payload = search.feed(bytes.fromhex("90 EB 01 0F 11 0A 06 64 00 64 00 64 00 64 00 D0 07 00 00 98"))
    assert payload is not None
    assert unpack_angles(payload, "<") == (100, 100, 100, 100, 2000, 0)
    written = ReplySearch(write_request(1, ANGLE_SET, pack((1000,) * 6, "<")))
    assert written.feed(bytes.fromhex("90 EB 01 04 12 CE 05 01 EB")) == b"\x01"


@pytest.mark.parametrize(
    ("hand", "register", "count"), [(0, 1, 1), (255, 1, 1), (1, -1, 1), (1, 1 << 16, 1), (1, 1, 0)]
)
def test_no_request_is_built_that_no_hand_understands(hand: int, register: int, count: int) -> None:
    with pytest.raises(ValueError, match="hand or register" if count else "1 to 252"):
        read_request(hand, register, count)
    with pytest.raises(ValueError, match="1 to 252"):
        write_request(1, 1, b"\x00" * 253)


requests = st.one_of(
    st.builds(read_request, st.integers(1, 254), st.integers(0, 0xFFFF), st.integers(1, 60)),
    st.builds(write_request, st.integers(1, 254), st.integers(0, 0xFFFF), st.binary(min_size=1, max_size=60)),
)


@given(requests, st.data())
def test_a_reply_is_found_wherever_it_is_cut(request_: Request, data: st.DataObject) -> None:
    payload = data.draw(st.binary(min_size=request_.reply_length, max_size=request_.reply_length))
    frame = data.draw(st.sampled_from([b"", request_.encoded])) + reply(request_, payload)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(frame)), max_size=4)))
    search = ReplySearch(request_)
    pieces = [frame[a:b] for a, b in zip([0, *cuts], [*cuts, len(frame)], strict=True)]
    found = [search.feed(piece) for piece in pieces]
    assert found.index(payload) == next(i for i, end in enumerate([*cuts, len(frame)]) if end == len(frame))


@given(requests, st.binary(max_size=200))
def test_bytes_at_random_never_raise_and_the_reply_after_them_is_found(request_: Request, noise: bytes) -> None:
    search = ReplySearch(request_)
    if search.feed(noise) is None:
        frame = reply(request_, bytes(request_.reply_length))
        # Noise that ends in the beginning of a reply swallows the first one; the line asks again.
        assert bytes(request_.reply_length) in (search.feed(frame), search.feed(frame))


HARMLESS = ("whole", "doubled", "foreign", "echo", "late")
MUTATIONS = (*HARMLESS, "changed", "short", "garbage", "inserted", "another register")


def mutated(kind: str, frame: bytes, request_: Request, draw: random.Random) -> bytes:
    at = draw.randrange(len(frame))
    if kind == "changed":
        return frame[:at] + bytes([frame[at] ^ draw.randint(1, 255)]) + frame[at + 1 :]
    if kind == "short":
        return frame[:at] + frame[at + 1 :] if draw.random() < 0.5 else frame[:at]
    if kind == "garbage":
        return draw.randbytes(draw.randint(1, 40)) + frame
    if kind == "inserted":
        return frame[:at] + draw.randbytes(draw.randint(1, 3)) + frame[at:]
    if kind == "doubled":
        return frame + frame
    if kind == "foreign":
        other = Request(request_.hand_id % 254 + 1, request_.command, request_.register, request_.payload)
        return reply(other, draw.randbytes(request_.reply_length)) + frame
    if kind == "another register":
        return reply(read_request(request_.hand_id, ANGLE_SET, 12), draw.randbytes(12))
    if kind == "late":
        length = draw.randint(1, 11)
        return reply(read_request(request_.hand_id, ANGLE_ACT, length), draw.randbytes(length)) + frame
    return request_.encoded + frame if kind == "echo" else frame


def test_ten_thousand_mutated_replies_are_decoded_right_or_refused() -> None:
    draw = random.Random(28)
    outcomes: Counter[tuple[str, str]] = Counter()
    for i in range(10_000):
        request_ = read_request(draw.randint(1, 254), ANGLE_ACT, 12)
        angles = tuple(draw.randint(0, 1000) for _ in range(6))
        kind = MUTATIONS[i % len(MUTATIONS)]
        found = ReplySearch(request_).feed(mutated(kind, reply(request_, pack(angles, "<")), request_, draw))
        if found is not None:
            assert unpack_angles(found, "<") == angles, f"case {i}: {kind}"
        outcomes[kind, "refused" if found is None else "decoded"] += 1
    for kind in HARMLESS:
        assert outcomes[kind, "refused"] == 0
    assert outcomes["changed", "decoded"] == outcomes["another register", "decoded"] == 0
    assert outcomes["garbage", "refused"] <= 2, "noise of which a reply's header is part"


def test_what_no_hand_says_is_refused() -> None:
    good = pack((0,) * 6, "<") * 2 + bytes(6) + bytes([255] * 6) + bytes([30] * 6)
    condition = unpack_condition(good, "<")
    assert condition.statuses == (Status.NEVER_COMMANDED,) * 6
    assert condition.worst is None
    faulty = unpack_condition(good[:24] + bytes([0, 1, 0, 2, 0, 0]) + good[30:], "<")
    assert faulty.worst is Fault.OVER_TEMPERATURE
    assert faulty.described == "ring: stalled, index: too hot"
    for at, value in ((24, 0x20), (30, 4), (36, 200)):
        with raises(ProtocolError, "protocol.hand_values"):
            unpack_condition(good[:at] + bytes([value]) + good[at + 1 :], "<")
    with raises(ProtocolError, "protocol.hand_values"):
        unpack_angles(pack((0, 0, 5000, 0, 0, 0), "<"), "<")

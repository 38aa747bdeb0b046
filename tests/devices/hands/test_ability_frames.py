"""The bytes of the Ability Hand: the maker's own recordings and formats, and whatever may become of a reply."""

from __future__ import annotations

import random
import struct
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.devices.hands.recorded_ability import PADS, PIECES, POSITIONS, WHOLE
from tests.errors import raises
from toolee_robot.devices.hands.ability import (
    REPLY_LENGTH,
    FrameReader,
    Header,
    Reply,
    Touch,
    command,
    decode,
)
from toolee_robot.errors import ProtocolError


def stuff(frame: bytes) -> bytes:
    return b"\x7e" + frame.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e") + b"\x7e"


def checksum(body: bytes) -> int:
    return -sum(body) & 0xFF


def says(found: Reply) -> tuple[object, ...]:
    return found.header, *found.positions, *found.touch, *found.limited


def reply(header: int, positions: tuple[int, ...], limited: int = 0, pads: bytes = bytes(45)) -> bytes:
    body = bytes([header]) + b"".join(struct.pack("<hh", p, 7) for p in positions) + pads + bytes([limited])
    return stuff(body + bytes([checksum(body)]))


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


@given(st.lists(st.binary(max_size=300), max_size=5))
def test_bytes_at_random_never_raise(pieces: list[bytes]) -> None:
    reader = FrameReader()
    for piece in pieces:
        reader.feed(piece)


HARMLESS = ("whole", "doubled", "foreign", "echo", "garbage")
ONE_BYTE = ("changed", "lost byte", "inserted", "cut")
MUTATIONS = (*HARMLESS, *ONE_BYTE, "another format")


def mutated(kind: str, frame: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(len(frame))
    if kind == "changed":
        return frame[:at] + bytes([frame[at] ^ draw.randint(1, 255)]) + frame[at + 1 :]
    if kind == "lost byte":
        return frame[:at] + frame[at + 1 :]
    if kind == "cut":
        return frame[:at]
    if kind == "inserted":
        return frame[:at] + draw.randbytes(draw.randint(1, 3)) + frame[at:]
    if kind == "garbage":  # ended by a flag, as every frame before is
        return draw.randbytes(draw.randint(1, 90)) + b"\x7e" + frame
    if kind == "doubled":
        return frame + frame
    if kind == "foreign":
        return reply(0x40, (1,) * 6) + frame
    if kind == "another format":
        return reply(draw.choice([0x12, 0x20, 0x41, 0xA2, 0x00]), (5,) * 6)
    return command(0x50, Header.READ_CURRENT) + frame if kind == "echo" else frame


def test_ten_thousand_mutated_replies_are_decoded_right_or_refused() -> None:
    draw = random.Random(28)
    outcomes: Counter[tuple[str, str]] = Counter()
    for i in range(10_000):
        positions = tuple(draw.randint(0, 20_000) * (1 if motor < 5 else -1) for motor in range(6))
        limited, pads = draw.randrange(64), draw.randbytes(45)
        header = draw.choice([*Header])
        kind = MUTATIONS[i % len(MUTATIONS)]
        right = decode(FrameReader().feed(reply(header, positions, limited, pads))[0])
        decoded = []
        for frame in FrameReader().feed(mutated(kind, reply(header, positions, limited, pads), draw)):
            try:
                decoded.append(decode(frame))
            except ProtocolError:
                continue
        decoded = [one for one in decoded if one.header in {*Header}]  # the line looks for its command's
        assert all(says(one) == says(right) for one in decoded), f"case {i}: {kind}"
        outcomes[kind, "decoded" if decoded else "refused"] += 1
    for kind in HARMLESS:
        assert outcomes[kind, "refused"] == 0
    assert outcomes["another format", "decoded"] == 0
    assert outcomes["lost byte", "decoded"] < 0.05 * outcomes["lost byte", "refused"], "but the opening flag"


def test_what_no_hand_says_is_refused() -> None:
    with raises(ProtocolError, "protocol.hand_values"):
        decode(FrameReader().feed(reply(0x10, (32767, 0, 0, 0, 0, 0)))[0])
    found = decode(FrameReader().feed(reply(0x10, (0,) * 6, limited=0xE1))[0])
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

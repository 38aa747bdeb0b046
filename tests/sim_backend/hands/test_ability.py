"""The emulated Ability Hand without a port: the maker's frames in and out, and how its motors behave."""

from __future__ import annotations

import gc
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.devices.hands.recorded_ability import PADS
from toolee_robot.sim_backend.hands.ability import AbilityEmulator, Hand

ASK = "7E 50 A0 10 7E"
CLOSE_40 = "7E 50 10 22 22 22 22 22 22 22 22 22 22 DE DD 91 7E"
"""All to 40 deg: 40 x 32767 / 150 = 8738 = 0x2222, of the rotator -8738 = 0xDDDE."""


class Bench:
    """A hand whose time is set by hand, and the bytes of its line."""

    def __init__(self) -> None:
        self.now = 100.0
        self.hand = Hand(lambda: self.now)
        self.emulator = AbilityEmulator()
        self.emulator._hand = self.hand
        for motor in self.hand.motors:
            motor.ratchets = 0.0

    def send(self, frame: str | bytes) -> list[bytes]:
        data = bytes.fromhex(frame) if isinstance(frame, str) else frame
        return self.emulator.answer(data)

    def ask(self, frame: str = ASK) -> bytes:
        (line,) = self.send(frame)
        assert line[0] == line[-1] == 0x7E
        body = line[1:-1].replace(b"\x7d\x5e", b"\x7e").replace(b"\x7d\x5d", b"\x7d")
        assert sum(body) % 256 == 0
        return body

    def keep(self, frame: str, seconds: float) -> None:
        """Repeat a command every 20 ms."""
        for _ in range(round(seconds / 0.02)):
            self.send(frame)
            self.now += 0.02

    def limited(self, frame: str = ASK) -> int:
        return self.ask(frame)[70]


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_replies_have_the_makers_format(bench: Bench) -> None:
    body = bench.ask()
    assert len(body) == 72
    assert body[0] == 0xA0
    assert struct.unpack("<12h", body[1:25])[::2] == (0,) * 6
    pads = [int.from_bytes(body[25:70], "little") >> 12 * pad & 0xFFF for pad in range(30)]
    np.testing.assert_allclose(pads, PADS, atol=2)
    assert len(bench.ask("7E 50 12 9E 7E")) == 39, "variant 3"
    bench.keep(CLOSE_40, 1.5)
    positions = struct.unpack("<12h", bench.ask()[1:25])[::2]
    np.testing.assert_allclose(positions, [8738] * 5 + [-8738], atol=30)
    assert bench.ask("7E 50 C2 EE 7E")[0] == 0xA0, "a header without a reply of its own: the last one's"


def test_damaged_messages_and_those_for_others_get_no_answer(bench: Bench) -> None:
    assert bench.send("7E 50 A0 11 7E 51 A0 0F 7E 50 7E") == []
    assert bench.emulator.ignored == 3
    assert len(bench.send("00 FF 7E 50 A0 10 7E")) == 1


def test_without_a_command_for_300_ms_it_leaves_the_api_mode_and_moves(bench: Bench) -> None:
    bench.send(ASK)
    assert not bench.hand.in_api
    bench.keep(CLOSE_40, 1.0)
    bench.now += 0.25
    assert bench.hand.in_api
    bench.send(ASK)
    bench.now += 0.25
    assert bench.hand.in_api, "reading keeps it up"
    closed = bench.hand.angles[0]
    bench.now += 0.4
    assert not bench.hand.in_api
    assert bench.hand.angles[0] < closed - 5.0
    bench.keep(CLOSE_40, 1.0)
    bench.send("7E 50 7C 34 7E")
    assert not bench.hand.in_api


def test_a_finger_that_has_collided_is_barred_until_it_is_told_to_go_back(bench: Bench) -> None:
    bench.hand.hold(20.0)
    bench.keep(CLOSE_40, 1.0)
    assert bench.limited(CLOSE_40) == 0b011111, "no collision bars the rotator"
    stands = bench.hand.angles[0]
    assert 20.0 < stands < 40.0
    bench.hand.slip(10.0)
    bench.keep(CLOSE_40, 1.0)
    assert bench.hand.angles[0] == stands, "a shifted object is not followed"
    bench.keep("7E 50 10 00 00 A0 7E", 0.04)
    bench.keep(CLOSE_40, 1.0)
    assert bench.hand.angles[0] > 30.0


@given(st.lists(st.binary(max_size=60), max_size=8))
def test_bytes_at_random_never_raise(pieces: list[bytes]) -> None:
    bench = Bench()
    for piece in pieces:
        bench.send(piece)
    assert bench.send("7E " + ASK)[-1:] != []


def test_an_emulator_that_nobody_enters_keeps_no_line_open() -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(50):
        AbilityEmulator()
    gc.collect()
    assert len(list(Path("/proc/self/fd").iterdir())) <= before

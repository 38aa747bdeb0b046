"""The emulated RH56 without a port: the maker's frames in and out, and how its motors behave."""

from __future__ import annotations

import struct

import pytest

from toolee_robot.sim_backend.hands.inspire import Hand, InspireEmulator

CLOSE_ALL = "EB 90 01 0F 12 CE 05 00 00 00 00 00 00 00 00 00 00 E8 03 E0"
"""All but the thumb's rotation to 0."""


class Bench:
    """A hand whose time is set by hand, and the bytes of its line."""

    def __init__(self) -> None:
        self.now = 100.0
        self.hand = Hand(lambda: self.now)
        self.emulator = InspireEmulator()
        self.emulator._hand = self.hand

    def send(self, frame: str | bytes) -> list[str]:
        data = bytes.fromhex(frame) if isinstance(frame, str) else frame
        return [frame.hex(" ").upper() for frame in self.emulator.answer(data)]

    def words(self, address: int) -> tuple[int, ...]:
        return struct.unpack("<6h", self.hand.read(address, 12))

    def bytes(self, address: int) -> tuple[int, ...]:
        return tuple(self.hand.read(address, 6))

    def write(self, address: int, *values: int) -> None:
        assert self.hand.write(address, struct.pack(f"<{len(values)}h", *values))


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_it_answers_the_makers_frames_with_the_makers_frames(bench: Bench) -> None:
    assert bench.send("EB 90 01 07 12 CE 05 E8 03 84 03 5F") == ["90 EB 01 04 12 CE 05 01 EB"]
    assert bench.send("EB 90 01 04 11 0A 06 0C 32") == ["90 EB 01 0F 11 0A 06 " + "E8 03 " * 6 + "B3"]
    bench.send("EB 90 01 0F 12 CE 05 64 00 64 00 64 00 64 00 E8 03 00 00 70")
    bench.now += 2.0
    assert bench.words(1546) == (100, 100, 100, 100, 1000, 0)


def test_noise_other_hands_and_damaged_requests_get_no_answer(bench: Bench) -> None:
    assert bench.send("00 EB EB 90 02 04 11 0A 06 0C 33 EB 90 01 04 11 0A 06 0C 31") == []
    assert bench.emulator.ignored == 2
    assert len(bench.send("EB EB 90 01 04 11 0A 06 0C 32 90")) == 1


def test_the_whole_range_takes_the_published_time_after_the_measured_delay(bench: Bench) -> None:
    bench.write(1522, *(1000,) * 6)
    bench.send(CLOSE_ALL)
    assert bench.bytes(1612) == (255,) * 6
    bench.now += 0.06
    assert bench.words(1546)[3] == 1000
    bench.now += 0.4
    assert bench.words(1546)[3] == pytest.approx(1000 - 1250 * 0.394, abs=5)
    assert bench.bytes(1612)[3] == 1
    bench.now += 0.45
    assert bench.words(1546)[:5] == (0,) * 5
    assert bench.bytes(1612)[3] == 2


@pytest.mark.parametrize(("speed", "at_most"), [(25, 1.15), (250, 2.3)])
def test_it_stops_at_the_force_and_overshoots_the_more_the_faster_it_is(
    bench: Bench, speed: int, at_most: float
) -> None:
    bench.hand.hold(600)
    bench.write(1498, *(500,) * 6)
    bench.write(1522, *(speed,) * 6)
    bench.send(CLOSE_ALL)
    bench.now += 1.0 + 400 / (1.25 * speed)
    force = bench.words(1582)[3]
    assert 500 <= force <= at_most * 500
    assert force > 550 or speed == 25
    assert bench.bytes(1612)[3] == 3


def test_a_hot_motor_stands_until_it_is_cool_whatever_is_cleared(bench: Bench) -> None:
    bench.hand.motors[0].temperature = 75.0
    bench.now += 0.1
    bench.send("EB 90 01 04 12 EC 03 01 07")
    bench.send(CLOSE_ALL)
    bench.now += 2.0
    assert bench.bytes(1606)[0] == 2
    assert bench.bytes(1618)[0] == 75
    assert bench.words(1546)[:2] == (1000, 0)
    bench.hand.motors[0].temperature = 50.0
    bench.now += 0.1
    assert bench.bytes(1606)[0] == 0

"""What every driver of a hand on a wire does alike, on its emulated hand."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.errors import raises
from tests.examples import timed
from tests.rigs.wired_hands import HANDS, emulated, eventually
from toolee_robot.devices.hands import open_hand
from toolee_robot.devices.hands.polled import PolledHand
from toolee_robot.doctor.devices import check_hand
from toolee_robot.errors import ConfigError, DeviceError, NoAnswerError
from toolee_robot.findings import Level
from toolee_robot.frames import Array
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.hands.kit import HandEmulator, LineFault, happen
from toolee_robot.station import StationConfig, load_station

pytestmark = pytest.mark.realtime(light=True)

EXAMPLES = Path(__file__).parents[3] / "examples"
NOISE = {LineFault.GARBAGE: 0.05, LineFault.CORRUPT: 0.03, LineFault.DOUBLED: 0.05, LineFault.FOREIGN: 0.05}


@dataclass(frozen=True)
class Rig:
    """A driver, not yet entered, and the emulated hand at the other end of its wire."""

    config: StationConfig
    emulator: HandEmulator[Any]
    heats: str

    @property
    def hand(self) -> PolledHand[Any, Any]:
        hand = open_hand(self.config.hand, HostClock())
        assert isinstance(hand, PolledHand)
        return hand


@pytest.fixture(params=HANDS)
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    station, hand = load_station(EXAMPLES / "inspire.yaml"), HANDS[request.param]
    with emulated(hand) as (config, emulator):
        yield Rig(replace(station, hand=config), emulator, hand.heats)


by_wire = pytest.mark.parametrize(
    "rig", [pytest.param(name, marks=() if name == "inspire" else pytest.mark.nightly) for name in HANDS], indirect=True
)
"""What the drivers' one base does is asked on a serial line in every run, nightly on all."""


def moves(rig: Rig, before: Array) -> None:
    """Wait until the hand moves."""
    eventually(lambda: bool(np.abs(np.array(rig.emulator.angles) - before).max() > 5.0))


@by_wire
def test_one_motion_at_a_time_and_none_outside_of_its_block(rig: Rig) -> None:
    hand = rig.hand
    for _ in range(2):  # it can be entered again
        for use in (hand.state, hand.open, hand.close):
            with raises(DeviceError, "device.closed"):
                use()
        with hand, ThreadPoolExecutor() as pool:
            hand.open()
            before = np.array(rig.emulator.angles)
            closing = pool.submit(hand.close)
            moves(rig, before)
            with raises(DeviceError, "device.busy"):
                hand.open()
            hand.stop()
            with raises(DeviceError, says="the hand was stopped"):
                closing.result(5.0)
            assert hand.state(2.0).joints.stamp > 0
    hand.stop()


@timed
@by_wire
def test_an_unplugged_cable_is_told_within_50_ms_and_ends_a_motion(rig: Rig, timed: bool) -> None:
    with rig.hand as hand, ThreadPoolExecutor() as pool:
        hand.open()
        before = np.array(rig.emulator.angles)
        closing = pool.submit(hand.close)
        moves(rig, before)
        rig.emulator.unplug()
        began = time.monotonic()
        with raises(NoAnswerError, "no_answer.hand_unplugged"):
            while True:
                hand.state(max_age=10.0)
                time.sleep(0.001)
        assert not timed or time.monotonic() - began < 0.05
        with raises(NoAnswerError, "no_answer.hand_unplugged"):
            closing.result(0.5 if timed else 5.0)
        with raises(NoAnswerError, "no_answer.hand_unplugged"):
            hand.open()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("duration", "rates"), [(1.5, {}), (1.5, NOISE), (600.0, {})], ids=["clean", "noisy", "ten minutes"]
)
def test_polling_loses_no_reply_and_no_memory(rig: Rig, duration: float, rates: dict[LineFault, float]) -> None:
    with rig.hand as hand:
        stands = hand.state(2.0).joints.q
        rig.emulator.faults.rates = rates
        time.sleep(0.5)
        tracemalloc.start()
        try:
            before, first = tracemalloc.get_traced_memory()[0], hand.readings
            lost, began = hand.line_counts.unanswered, time.monotonic()
            while time.monotonic() - began < duration:
                np.testing.assert_allclose(hand.state(max_age=2.0).joints.q, stands, atol=5e-3)
                time.sleep(0.01)
            taken, readings = time.monotonic() - began, hand.readings - first
            grown = tracemalloc.get_traced_memory()[0] - before
        finally:
            tracemalloc.stop()
        lost = hand.line_counts.unanswered - lost
        print(f"{readings / taken:.1f} readings/s for {taken:.1f} s, {lost} without a reply, memory {grown:+d} bytes")
        assert readings > 20 * duration
        assert grown < 200_000
        if not rates:
            assert lost <= 0.02 * readings, "what the machine holds up for 30 ms"


@by_wire
def test_nobody_is_there(rig: Rig) -> None:
    nowhere = {"/": "/dev/no_such_port", "t": "tcp://127.0.0.1:9", "w": "ws://127.0.0.1:9"}[rig.emulator.port[0]]
    hand = open_hand(replace(rig.config.hand, port=nowhere), HostClock())
    with raises(NoAnswerError, says="hand.port"), hand:
        pass
    rig.emulator.faults.muted = True
    with raises(NoAnswerError, "no_answer.hand_silent"), rig.hand:
        pass
    with raises(ConfigError, "config.hand_port"):
        open_hand(replace(rig.config.hand, port=None), HostClock())


def test_a_serial_port_is_one_programs(rig: Rig) -> None:
    if rig.emulator.port.startswith("/"):
        with rig.hand, raises(NoAnswerError, says="hand.port"), rig.hand:
            pass


@by_wire
def test_the_doctor_looks_at_it_and_moves_nothing(rig: Rig) -> None:
    before = rig.emulator.angles
    with rig.hand as hand:
        finding = check_hand(hand, rig.config)
        assert finding.level is Level.OK, finding
        happen(rig.emulator, rig.heats)
        eventually(lambda: hand.state(2.0).fault != "")
        assert check_hand(hand, rig.config).level is Level.FAIL
    assert rig.emulator.angles == before

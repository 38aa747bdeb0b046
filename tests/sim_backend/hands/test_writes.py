"""The emulated RH56 that does not take, or does not acknowledge, what is written: reads are answered all the same."""

from __future__ import annotations

import struct

import pytest

from tests.errors import raises
from toolee_robot.errors import UserError
from toolee_robot.sim_backend.hands.ability import AbilityEmulator
from toolee_robot.sim_backend.hands.inspire import Hand, InspireEmulator, ModbusEmulator
from toolee_robot.sim_backend.hands.kit import WriteFault, happen
from toolee_robot.sim_backend.hands.shadow import ShadowEmulator

FRAMES = {
    InspireEmulator: ("EB 90 01 04 11 DA 05 0C 01", ["EB 90 01 0F 12 DA 05 " + "2C 01 " * 6 + "0F"]),
    ModbusEmulator: (
        "00 01 00 00 00 06 01 03 05 DA 00 06",
        ["00 02 00 00 00 06 01 06 05 DA 01 2C", "00 01 00 00 00 13 01 10 05 DA 00 06 0C " + "01 2C " * 6],
    ),
}
"""The thresholds of the force: read, and written as 300 in every way that the wire has."""


@pytest.mark.parametrize("fault", WriteFault)
@pytest.mark.parametrize("kind", FRAMES)
def test_reads_are_answered_and_writes_are_not(kind: type[InspireEmulator], fault: WriteFault) -> None:
    hand, (read, writes) = kind(), FRAMES[kind]
    hand.faults.writes = fault
    for write in writes:
        assert hand.answer(bytes.fromhex(write)) == []
    assert hand.tell(lambda hand: hand.told)[0][1] == (500 if fault is WriteFault.DEAF else 300)
    assert len(hand.answer(bytes.fromhex(read))) == 1
    if isinstance(hand, ModbusEmulator):
        hand.refusals.append(6)
        assert hand.answer(bytes.fromhex(writes[0])) == []
    hand.faults.writes = None
    for write in writes:
        assert len(hand.answer(bytes.fromhex(write))) == 1


def test_events() -> None:
    with InspireEmulator() as inspire, ModbusEmulator() as modbus:
        for emulator in (inspire, modbus):
            for fault in WriteFault:
                happen(emulator, fault)
                assert emulator.faults.writes is fault
            happen(emulator, "acknowledge")
            assert emulator.faults.writes is None
            happen(emulator, "error middle 4")
            happen(emulator, "error middle 16")
            assert emulator.tell(lambda hand: hand.read(1606, 6)) == bytes([0, 0, 20, 0, 0, 0])
            for nonsense in ("deaf 3", "error 4", "error middle", "error middle 0", "error middle 2", "error palm 4"):
                with raises(UserError, "user.hand_event"):
                    happen(emulator, nonsense)
    with AbilityEmulator() as ability, ShadowEmulator() as shadow:
        for other in (ability, shadow):
            with raises(UserError, "user.hand_event"):
                happen(other, "deaf")


def test_a_motor_with_too_much_current_stands_until_it_is_cleared() -> None:
    now = 100.0
    hand = Hand(lambda: now)
    hand.write(1486, struct.pack("<6h", *(0,) * 6))
    now += 0.2
    hand.run()
    hand.motors[2].error |= 4
    now += 2.0
    angles = struct.unpack("<6h", hand.read(1546, 12))
    assert angles[2] > 800
    assert angles[3] == 0
    assert (hand.read(1606, 6)[2], hand.read(1612, 6)[2]) == (4, 5)
    assert hand.write(1004, b"\x01")
    assert hand.read(1606, 6) == bytes(6)

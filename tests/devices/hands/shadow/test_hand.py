"""The Shadow Hand's driver on the emulated hand, over a websocket: grasps, and what goes wrong with them."""

from __future__ import annotations

import json
import time
import tracemalloc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from websockets.sync.client import connect

from tests.devices.hands.shadow.conftest import EFFORTS
from tests.errors import raises
from toolee_robot.devices.hands.shadow import ShadowHand
from toolee_robot.errors import ConfigError, DeviceError, NoAnswerError, ProtocolError, StaleDataError
from toolee_robot.hal import HandState
from toolee_robot.robots import HandModel
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.hand_wire import LineFault, happen
from toolee_robot.sim_backend.shadow_hand import Hand, ShadowEmulator

pytestmark = pytest.mark.realtime(light=True)

HANDLE = 55.0
"""Angle at which the knuckles meet a handle [deg]."""
KNUCKLES = [0, 3, 6, 9]
"""Of the emulated motors."""


def eventually(condition: Callable[[], bool], within: float = 5.0) -> None:
    end = time.monotonic() + within
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def told(hand: ShadowHand) -> HandState:
    """Its state, however busy this machine is."""
    return hand.state(max_age=2.0)


def held(emulator: ShadowEmulator, hand: ShadowHand) -> None:
    emulator.hold(HANDLE)
    hand.close()
    assert told(hand).holding
    assert told(hand).fault == ""


def test_entering_moves_nothing_and_leaving_keeps_the_grip(emulator: ShadowEmulator, model: HandModel) -> None:
    emulator.tell(lambda hand: setattr(hand.motor("FFJ3"), "position", 30.0))
    emulator.tell(lambda hand: setattr(hand.motor("FFJ3"), "jammed", True))
    with ShadowHand(model, emulator.port, EFFORTS, HostClock()) as hand:
        time.sleep(0.2)
        assert emulator.angles == (30.0, *(0.0,) * 19)
        assert told(hand).joints.q[model.joints.index("rh_FFJ3")] == pytest.approx(np.deg2rad(30.0), abs=2e-3)
        assert hand.line_counts.requests == 0
        emulator.tell(lambda hand: setattr(hand.motor("FFJ3"), "jammed", False))
        held(emulator, hand)
    stands = emulator.angles
    time.sleep(0.3)
    np.testing.assert_allclose(emulator.angles, stands, atol=0.2)
    with ShadowHand(model, emulator.port, EFFORTS, HostClock()) as hand:
        eventually(lambda: told(hand).holding)


def test_joints_are_counted_as_the_model_counts_them(
    emulator: ShadowEmulator, hand: ShadowHand, model: HandModel
) -> None:
    def stand(hand: Hand) -> None:
        for name, angle in (("FFJ0", 60.0), ("MFJ4", 10.0), ("RFJ4", 10.0), ("THJ1", 40.0), ("THJ2", 15.0)):
            motor = hand.motor(name)
            motor.position, motor.jammed = angle, True

    emulator.tell(stand)
    expected = {"rh_FFJ1": 30.0, "rh_FFJ2": 30.0, "rh_MFJ4": -10.0, "rh_RFJ4": 10.0, "rh_THJ1": -40.0, "rh_THJ2": -15.0}

    def as_expected() -> bool:
        found = dict(zip(model.joints, np.rad2deg(told(hand).joints.q), strict=True))
        return all(abs(angle - expected.get(joint, 0.0)) < 0.5 for joint, angle in found.items())

    eventually(as_expected)


def test_it_presses_with_the_grips_effort_and_lets_go_when_it_opens(emulator: ShadowEmulator, hand: ShadowHand) -> None:
    held(emulator, hand)
    efforts: list[float] = []
    emulator.tell(lambda hand: efforts.extend(motor.pressed for motor in hand.motors if motor.pressed > 0.0))
    assert len(efforts) >= 9
    assert max(efforts) < 1.5 * EFFORTS.grip, "not what the approach's speed adds"
    forces = told(hand).contact_forces
    assert set(forces) == {"thumb", "index", "middle", "ring", "little"}
    assert all(0.8 < force / (EFFORTS.grip * EFFORTS.newtons_per_unit) < 1.5 for force in forces.values())
    hand.open()
    assert not told(hand).holding
    assert max(emulator.angles[motor] for motor in KNUCKLES) < 2.0
    assert max(told(hand).contact_forces.values()) == 0.0


def test_the_grip_is_kept_up_and_a_slip_and_a_loss_are_seen(emulator: ShadowEmulator, hand: ShadowHand) -> None:
    held(emulator, hand)
    emulator.slip(1.5)
    eventually(lambda: min(told(hand).contact_forces.values()) > 7.0)
    assert told(hand).fault == "", "a little is no slip"
    emulator.slip(5.0)
    eventually(lambda: "slipped" in told(hand).fault)
    emulator.hold(None)
    eventually(lambda: not told(hand).holding, within=2.0)
    hand.open()
    assert told(hand).fault == ""


def test_a_stop_freezes_the_fingers_and_keeps_a_grip(emulator: ShadowEmulator, hand: ShadowHand) -> None:
    hand.open()
    with ThreadPoolExecutor() as pool:
        closing = pool.submit(hand.close)
        eventually(lambda: emulator.angles[0] > 15.0)
        hand.stop()
        with raises(DeviceError, "device.stopped"):
            closing.result(5.0)
    time.sleep(0.5)
    stands = emulator.angles
    assert stands[0] < 80.0
    time.sleep(0.2)
    np.testing.assert_allclose(emulator.angles, stands, atol=0.1)
    held(emulator, hand)
    hand.stop()
    time.sleep(0.5)
    assert told(hand).holding


def test_a_time_out_keeps_position_and_grip(emulator: ShadowEmulator, hand: ShadowHand) -> None:
    hand.open()
    with raises(DeviceError, "device.timeout"):
        hand.close(timeout=0.4)
    time.sleep(0.4)
    assert emulator.angles[0] < 80.0
    held(emulator, hand)
    with raises(DeviceError, "device.timeout"):
        hand.open(timeout=0.01)
    time.sleep(0.3)
    assert told(hand).holding


@pytest.mark.parametrize("duration", [1.5, pytest.param(600.0, marks=pytest.mark.nightly)])
def test_polling_loses_no_reading_and_no_memory(emulator: ShadowEmulator, hand: ShadowHand, duration: float) -> None:
    stands = emulator.angles
    tracemalloc.start()
    try:
        before, first = tracemalloc.get_traced_memory()[0], hand.reading(2.0).number
        lost, began = hand.line_counts.unanswered, time.monotonic()
        while time.monotonic() - began < duration:
            assert told(hand).fault == ""
            time.sleep(0.01)
        taken, readings = time.monotonic() - began, hand.reading(2.0).number - first
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    lost = hand.line_counts.unanswered - lost
    print(f"{readings / taken:.1f} readings/s for {taken:.1f} s, {lost} did not come, memory {grown:+d} bytes")
    assert readings > 50 * duration
    assert lost <= 0.02 * readings, "what the machine holds up for 30 ms"
    assert grown < 200_000
    np.testing.assert_allclose(emulator.angles, stands, atol=0.2)


def test_heat_is_a_fault_with_its_temperature(emulator: ShadowEmulator, hand: ShadowHand) -> None:
    held(emulator, hand)
    assert told(hand).temperature == pytest.approx(32.0)
    happen(emulator, "heat MFJ0 64")
    eventually(lambda: "MFJ0: too hot" in told(hand).fault)
    assert told(hand).temperature == pytest.approx(64.0)
    with raises(DeviceError, "device.hand_over_temperature"):
        hand.close()
    happen(emulator, "heat MFJ0 40")
    eventually(lambda: "too hot" not in told(hand).fault)


def test_a_broken_motor_is_a_fault(emulator: ShadowEmulator, hand: ShadowHand) -> None:
    happen(emulator, "break THJ5")
    eventually(lambda: "THJ5: A3950 H-bridge" in told(hand).fault)
    with raises(DeviceError, "device.hand_motor"):
        hand.close()


def test_a_finger_that_does_not_move_passes_neither_for_open_nor_for_closed(
    emulator: ShadowEmulator, hand: ShadowHand
) -> None:
    hand.open()
    happen(emulator, "jam MFJ3")
    with raises(DeviceError, "device.hand_stall") as stuck:
        hand.close()
    assert "middle (MFJ3)" in str(stuck.value)
    happen(emulator, "jam RFJ0")
    with raises(DeviceError, "device.hand_blocked") as blocked:
        hand.open()
    assert "ring (RFJ0)" in str(blocked.value)


def test_commands_that_the_controllers_do_not_take_are_an_error(emulator: ShadowEmulator, hand: ShadowHand) -> None:
    hand.open()
    happen(emulator, "controllers off")
    with raises(DeviceError, "device.hand_command"):
        hand.close()
    assert "controllers" in told(hand).fault
    happen(emulator, "controllers on")
    hand.open()
    eventually(lambda: told(hand).fault == "")


def test_the_command_of_another_program_is_countermanded(emulator: ShadowEmulator, hand: ShadowHand) -> None:
    held(emulator, hand)
    sent = hand.line_counts.requests
    joints: list[str] = []
    emulator.tell(lambda hand: joints.extend(hand.fingers.joints))
    point = {"positions": [0.0] * len(joints), "time_from_start": {"secs": 0, "nsecs": 200_000_000}}
    opening = {"joint_names": joints, "points": [point]}
    with connect(emulator.port) as other:
        other.send(json.dumps({"op": "publish", "topic": "/rh_trajectory_controller/command", "msg": opening}))
        eventually(lambda: hand.line_counts.requests > sent)
    time.sleep(0.5)
    assert told(hand).holding
    assert told(hand).fault == ""


def test_motors_of_which_nothing_is_known_are_a_fault(emulator: ShadowEmulator, hand: ShadowHand) -> None:
    assert told(hand).fault == ""
    happen(emulator, "diagnostics off")
    eventually(lambda: "nothing of its motors" in told(hand).fault)
    happen(emulator, "diagnostics on")
    eventually(lambda: told(hand).fault == "")


@pytest.mark.parametrize("fault", list(LineFault))
def test_messages_survive_what_becomes_of_them(emulator: ShadowEmulator, hand: ShadowHand, fault: LineFault) -> None:
    emulator.faults.upcoming(fault, 10)
    number = hand.reading(2.0).number
    eventually(lambda: emulator.faults.pending == 0 and hand.reading(2.0).number > number + 5)
    eventually(lambda: hand.reading(0.5).number > number + 10)
    assert told(hand).fault == ""
    counts = hand.line_counts
    if fault in (LineFault.DOUBLED, LineFault.LATE):
        eventually(lambda: hand.line_counts.late > 0)
    elif fault in (LineFault.CORRUPT, LineFault.SHORT, LineFault.GARBAGE):
        assert counts.corrupt > 0


def test_a_silent_hand_has_no_state_is_told_nothing_and_keeps_its_grip(
    emulator: ShadowEmulator, hand: ShadowHand
) -> None:
    held(emulator, hand)
    emulator.faults.muted = True
    time.sleep(0.5)
    with raises(StaleDataError, "stale_data.hand"):
        hand.state()
    sent = hand.line_counts.requests
    with raises(StaleDataError, "stale_data.hand"):
        hand.close()
    assert hand.line_counts.requests == sent, "no old command waits in the network"
    emulator.faults.muted = False
    eventually(lambda: _answers(hand) and told(hand).holding)


def _answers(hand: ShadowHand) -> bool:
    try:
        hand.state(0.5)
    except StaleDataError:
        return False
    return True


def test_readings_that_wait_in_the_network_are_not_taken_for_fresh(emulator: ShadowEmulator, hand: ShadowHand) -> None:
    told(hand)
    emulator.faults.late_by = 0.5
    emulator.faults.rates = {LineFault.LATE: 1.0}
    time.sleep(1.2)
    with raises(StaleDataError, "stale_data.hand"):
        hand.state(max_age=0.1)
    assert hand.reading(5.0).told.stamp < HostClock().now() - 0.3


def test_a_rosbridge_that_is_gone_is_told_within_50_ms(emulator: ShadowEmulator, hand: ShadowHand) -> None:
    held(emulator, hand)
    emulator.unplug()
    began = time.monotonic()
    with raises(NoAnswerError, "no_answer.hand_unplugged"):
        while True:
            hand.state(max_age=10.0)
            time.sleep(0.001)
    assert time.monotonic() - began < 0.05
    with raises(NoAnswerError, "no_answer.hand_unplugged"):
        hand.open()


def test_it_can_be_entered_again(emulator: ShadowEmulator, model: HandModel) -> None:
    hand = ShadowHand(model, emulator.port, EFFORTS, HostClock())
    for _ in range(2):
        with hand:
            assert told(hand).fault == ""
        with raises(DeviceError, "device.closed"):
            hand.state()


@pytest.mark.parametrize("url", ["/dev/ttyUSB0", "http://127.0.0.1:9090", "ws://"])
def test_a_port_that_is_no_rosbridge(model: HandModel, url: str) -> None:
    with raises(ConfigError, "config.hand_port"), ShadowHand(model, url, EFFORTS, HostClock()):
        pass


def test_nobody_there_or_somebody_else(emulator: ShadowEmulator, model: HandModel) -> None:
    with raises(NoAnswerError, "no_answer.hand_port"), ShadowHand(model, "ws://127.0.0.1:9", EFFORTS, HostClock()):
        pass
    emulator.faults.muted = True
    with (
        raises(NoAnswerError, "no_answer.hand_silent") as silent,
        ShadowHand(model, emulator.port, EFFORTS, HostClock()),
    ):
        pass
    assert "/diagnostics, /joint_states" in str(silent.value)
    emulator.faults.muted = False
    emulator.faults.rates = {LineFault.SHORT: 1.0}
    with raises(ProtocolError, "protocol.rosbridge"), ShadowHand(model, emulator.port, EFFORTS, HostClock()):
        pass


def test_efforts_that_are_higher_press_harder(emulator: ShadowEmulator, model: HandModel) -> None:
    with ShadowHand(model, emulator.port, replace(EFFORTS, grip=450.0), HostClock()) as hand:
        held(emulator, hand)
        assert min(told(hand).contact_forces.values()) > 0.8 * 450.0 * EFFORTS.newtons_per_unit

"""The Shadow Hand's driver on the emulated hand, over a websocket: grasps, and what goes wrong with them."""

from __future__ import annotations

import json
import time
from dataclasses import replace

import numpy as np
import pytest
from websockets.sync.client import connect

from tests.errors import raises
from tests.rigs.wired_hands import EFFORTS, eventually, told
from toolee_robot.devices.hands.shadow import ShadowHand
from toolee_robot.errors import ConfigError, DeviceError, StaleDataError
from toolee_robot.robots import HandModel
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.hands.kit import LineFault, happen
from toolee_robot.sim_backend.hands.shadow import Hand, ShadowEmulator

pytestmark = pytest.mark.realtime(light=True)

HANDLE = 55.0
"""Angle at which the knuckles meet a handle [deg]."""
KNUCKLES = [0, 3, 6, 9]
"""Of the emulated motors."""


def held(emulator: ShadowEmulator, hand: ShadowHand) -> None:
    emulator.hold(HANDLE)
    hand.close()
    assert told(hand).holding
    assert told(hand).fault == ""


@pytest.mark.nightly
def test_entering_moves_nothing_and_leaving_keeps_the_grip(shadow: ShadowEmulator, shadow_model: HandModel) -> None:
    shadow.tell(lambda hand: setattr(hand.motor("FFJ3"), "position", 30.0))
    shadow.tell(lambda hand: setattr(hand.motor("FFJ3"), "jammed", True))
    with ShadowHand(shadow_model, shadow.port, EFFORTS, HostClock()) as hand:
        time.sleep(0.2)
        assert shadow.angles == (30.0, *(0.0,) * 19)
        assert told(hand).joints.q[shadow_model.joints.index("rh_FFJ3")] == pytest.approx(np.deg2rad(30.0), abs=2e-3)
        assert hand.line_counts.requests == 0
        shadow.tell(lambda hand: setattr(hand.motor("FFJ3"), "jammed", False))
        held(shadow, hand)
    stands = shadow.angles
    time.sleep(0.3)
    np.testing.assert_allclose(shadow.angles, stands, atol=0.2)
    with ShadowHand(shadow_model, shadow.port, EFFORTS, HostClock()) as hand:
        eventually(lambda: told(hand).holding)


def test_joints_are_counted_as_the_model_counts_them(
    shadow: ShadowEmulator, shadow_hand: ShadowHand, shadow_model: HandModel
) -> None:
    def stand(hand: Hand) -> None:
        for name, angle in (("FFJ0", 60.0), ("MFJ4", 10.0), ("RFJ4", 10.0), ("THJ1", 40.0), ("THJ2", 15.0)):
            motor = hand.motor(name)
            motor.position, motor.jammed = angle, True

    shadow.tell(stand)
    expected = {"rh_FFJ1": 30.0, "rh_FFJ2": 30.0, "rh_MFJ4": -10.0, "rh_RFJ4": 10.0, "rh_THJ1": -40.0, "rh_THJ2": -15.0}

    def as_expected() -> bool:
        found = dict(zip(shadow_model.joints, np.rad2deg(told(shadow_hand).joints.q), strict=True))
        return all(abs(angle - expected.get(joint, 0.0)) < 0.5 for joint, angle in found.items())

    eventually(as_expected)


@pytest.mark.nightly
def test_it_presses_with_the_grips_effort_and_lets_go_when_it_opens(
    shadow: ShadowEmulator, shadow_hand: ShadowHand
) -> None:
    held(shadow, shadow_hand)
    efforts: list[float] = []
    shadow.tell(lambda hand: efforts.extend(motor.pressed for motor in hand.motors if motor.pressed > 0.0))
    assert len(efforts) >= 9
    assert max(efforts) < 1.5 * EFFORTS.grip, "not what the approach's speed adds"
    forces = told(shadow_hand).contact_forces
    assert set(forces) == {"thumb", "index", "middle", "ring", "little"}
    assert all(0.8 < force / (EFFORTS.grip * EFFORTS.newtons_per_unit) < 1.5 for force in forces.values())
    shadow_hand.open()
    assert not told(shadow_hand).holding
    assert max(shadow.angles[motor] for motor in KNUCKLES) < 2.0
    assert max(told(shadow_hand).contact_forces.values()) == 0.0


def test_the_grip_is_kept_up_and_a_slip_and_a_loss_are_seen(shadow: ShadowEmulator, shadow_hand: ShadowHand) -> None:
    held(shadow, shadow_hand)
    shadow.slip(1.5)
    eventually(lambda: min(told(shadow_hand).contact_forces.values()) > 7.0)
    assert told(shadow_hand).fault == "", "a little is no slip"
    shadow.slip(5.0)
    eventually(lambda: "slipped" in told(shadow_hand).fault)
    shadow.hold(None)
    eventually(lambda: not told(shadow_hand).holding, within=2.0)
    shadow_hand.open()
    assert told(shadow_hand).fault == ""


def test_a_broken_motor_is_a_fault(shadow: ShadowEmulator, shadow_hand: ShadowHand) -> None:
    happen(shadow, "break THJ5")
    eventually(lambda: "THJ5: A3950 H-bridge" in told(shadow_hand).fault)
    with raises(DeviceError, "device.hand_motor"):
        shadow_hand.close()


@pytest.mark.nightly
def test_commands_that_the_controllers_do_not_take_are_an_error(
    shadow: ShadowEmulator, shadow_hand: ShadowHand
) -> None:
    shadow_hand.open()
    happen(shadow, "controllers off")
    with raises(DeviceError, "device.hand_command"):
        shadow_hand.close()
    assert "controllers" in told(shadow_hand).fault
    happen(shadow, "controllers on")
    shadow_hand.open()
    eventually(lambda: told(shadow_hand).fault == "")


@pytest.mark.nightly
def test_the_command_of_another_program_is_countermanded(shadow: ShadowEmulator, shadow_hand: ShadowHand) -> None:
    held(shadow, shadow_hand)
    sent = shadow_hand.line_counts.requests
    joints: list[str] = []
    shadow.tell(lambda hand: joints.extend(hand.controllers["/rh_trajectory_controller"].joints))
    point = {"positions": [0.0] * len(joints), "time_from_start": {"secs": 0, "nsecs": 200_000_000}}
    opening = {"joint_names": joints, "points": [point]}
    with connect(shadow.port) as other:
        other.send(json.dumps({"op": "publish", "topic": "/rh_trajectory_controller/command", "msg": opening}))
        eventually(lambda: shadow_hand.line_counts.requests > sent)
    time.sleep(0.5)
    assert told(shadow_hand).holding
    assert told(shadow_hand).fault == ""


@pytest.mark.nightly
def test_motors_of_which_nothing_is_known_are_a_fault(shadow: ShadowEmulator, shadow_hand: ShadowHand) -> None:
    assert told(shadow_hand).fault == ""
    happen(shadow, "diagnostics off")
    eventually(lambda: "nothing of its motors" in told(shadow_hand).fault)
    happen(shadow, "diagnostics on")
    eventually(lambda: told(shadow_hand).fault == "")


def test_readings_that_wait_in_the_network_are_not_taken_for_fresh(
    shadow: ShadowEmulator, shadow_hand: ShadowHand
) -> None:
    told(shadow_hand)
    shadow.faults.late_by = 0.5
    shadow.faults.rates = {LineFault.LATE: 1.0}
    time.sleep(1.2)
    with raises(StaleDataError, "stale_data.hand"):
        shadow_hand.state(max_age=0.1)
    assert shadow_hand.reading(5.0).stamp < HostClock().now() - 0.3


@pytest.mark.parametrize("url", ["/dev/ttyUSB0", "http://127.0.0.1:9090", "ws://"])
def test_a_port_that_is_no_rosbridge(shadow_model: HandModel, url: str) -> None:
    with raises(ConfigError, "config.hand_port"), ShadowHand(shadow_model, url, EFFORTS, HostClock()):
        pass


@pytest.mark.nightly
def test_efforts_that_are_higher_press_harder(shadow: ShadowEmulator, shadow_model: HandModel) -> None:
    with ShadowHand(shadow_model, shadow.port, replace(EFFORTS, grip=450.0), HostClock()) as hand:
        held(shadow, hand)
        assert min(told(hand).contact_forces.values()) > 0.8 * 450.0 * EFFORTS.newtons_per_unit

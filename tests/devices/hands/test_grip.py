"""What a closed hand holds, by its readings: a slip, a finger that has lost the handle, and a lost tool."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from serial.tools.list_ports import comports

from tests.errors import raises
from toolee_robot.devices.hands import MountedTool, ports
from toolee_robot.devices.hands.grip import PRESS_PERIOD_S, WINDOW_S, Grip, GripRule, Reading
from toolee_robot.errors import ConfigError
from toolee_robot.hal import Hand
from toolee_robot.robots import hand_model
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import load_station

RULE = GripRule((0, 1, 2, 3), 4, touches=1.0, shut=80.0, slipped=5.0, unit="deg")
AT, FORCE = 50.0, 6.0


class Fingers:
    """Five fingers on a handle, read every 10 ms."""

    def __init__(self) -> None:
        self.closures, self.forces = np.full(5, AT), np.full(5, FORCE)
        self.grip, self._number = Grip(RULE), 0
        self.read(WINDOW_S)
        assert self.grip.begin(self._reading())

    def read(self, duration: float) -> set[int]:
        """Let time pass; return the fingers that are to be closed further."""
        pressed: set[int] = set()
        for _ in range(round(duration / 0.01)):
            self._number += 1
            pressed.update(self.grip.follow(self._reading()))
        return pressed

    def _reading(self) -> Reading[None]:
        return Reading(0.01 * self._number, self.closures.copy(), self.forces.copy(), None)


@pytest.fixture
def hand() -> Fingers:
    return Fingers()


def test_a_grip_that_stays_has_not_slipped(hand: Fingers) -> None:
    hand.closures += RULE.slipped - 0.1
    assert not hand.read(1.0)
    assert hand.grip.holding
    assert hand.grip.slipped == ""


def test_fingers_that_follow_a_handle_further_than_a_little_tell_a_slip(hand: Fingers) -> None:
    hand.closures += RULE.slipped + 1.0
    hand.read(0.01)
    assert "6 deg" in hand.grip.slipped
    assert hand.grip.holding


@pytest.mark.parametrize("finger", range(5))
def test_one_finger_that_has_lost_the_handle_tells_a_slip_while_the_others_hold(hand: Fingers, finger: int) -> None:
    hand.forces[finger], hand.closures[finger] = 0.0, AT + RULE.slipped + 1.0
    hand.read(WINDOW_S + 0.02)
    if finger == RULE.thumb:
        assert not hand.grip.holding, "there is no grip without the thumb"
    else:
        assert hand.grip.holding
        assert hand.grip.slipped


def test_a_tool_that_is_gone_is_lost_and_has_not_slipped(hand: Fingers) -> None:
    hand.forces[:], hand.closures[:] = 0.0, AT + RULE.slipped + 1.0
    hand.read(WINDOW_S + 0.02)
    assert not hand.grip.holding
    assert hand.grip.slipped == ""


def test_a_finger_whose_force_has_fallen_is_closed_further_but_not_with_every_reading(hand: Fingers) -> None:
    hand.forces[1] = 2.0
    assert hand.read(WINDOW_S + 0.02) == {1}
    assert not hand.read(0.5 * PRESS_PERIOD_S)
    assert hand.read(PRESS_PERIOD_S) == {1}


def test_a_mount_holds_what_a_person_fixed_in_it() -> None:
    config = load_station(Path(__file__).parents[3] / "examples" / "mount.yaml")
    with MountedTool(hand_model(config.hand), HostClock()) as mount:
        assert isinstance(mount, Hand)
        assert mount.joint_names == ("mount_hinge",)
        assert not mount.state().holding
        mount.close()
        mount.stop()
        state = mount.state()
        assert state.holding
        assert state.contact_forces == {}
        assert state.temperature is None
        np.testing.assert_array_equal(state.joints.q, [0.0])
        mount.open()
        assert not mount.state().holding


DEVICES = sorted(found.device for found in comports())


def test_names_that_stay_the_same_are_told_before_devices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [tmp_path / "usb-FTDI_RS485-if00-port0", tmp_path / "usb-Prolific_2303-if00-port0"]
    for name in reversed(names):
        name.touch()
    monkeypatch.setattr(ports, "_BY_ID", tmp_path)
    assert ports.serial_ports() == [str(name) for name in names]


@pytest.mark.parametrize("kind", ["missing", "empty"])
def test_without_such_names_the_devices_are_told(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "by-id"
    if kind != "missing":
        folder.mkdir()
    monkeypatch.setattr(ports, "_BY_ID", folder)
    assert ports.serial_ports() == DEVICES


@pytest.mark.parametrize(
    "path", ["tcp://", "tcp://host", "tcp://:6000", "tcp://host:x", "tcp://host:70000", "host:6000"]
)
def test_what_is_no_address(path: str) -> None:
    with raises(ConfigError, "config.hand_port"):
        ports.tcp_address(path)


def test_addresses() -> None:
    assert ports.tcp_address("tcp://192.168.11.210:6000") == ("192.168.11.210", 6000)
    assert ports.tcp_address("tcp://hand.lab:0") == ("hand.lab", 0)

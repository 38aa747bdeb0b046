"""The hand's driver that a station file names: this project's, or one that a lab's own package brings."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.errors import raises
from tests.robots.three_finger import THREE_FINGER_HAND
from toolee_robot.config import HandConfig
from toolee_robot.errors import ConfigError
from toolee_robot.robots import HANDS
from toolee_robot.runtime.clock import HostClock
from toolee_robot.stations.hand import WIRED_HANDS, emulated_hand, hand_drivers, open_hand
from toolee_robot.types import HandEfforts, HandMounting

MOUNTING = HandMounting(position=(0.0, 0.0, 0.08), fingers=(0.0, 0.0, 1.0), thumb=(1.0, 0.0, 0.0))


def test_a_labs_own_driver_is_found_by_its_entry_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "our_lab_hands.py").write_text("def open_ours(model, config, clock):\n    return model, config.port\n")
    info = tmp_path / "our_lab_hands-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: our_lab_hands\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[toolee_robot.devices]\n"
        "hand.three_finger = our_lab_hands:open_ours\n"
        "hand.inspire_rh56 = our_lab_hands:no_such\n"
    )
    monkeypatch.setitem(HANDS, "three_finger", THREE_FINGER_HAND)
    with raises(ConfigError, "config.hand_driver"):
        open_hand(HandConfig("three_finger", port="here"), HostClock())
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    ours: object = open_hand(HandConfig("three_finger", port="here"), HostClock())
    assert ours == (THREE_FINGER_HAND, "here")
    drivers = hand_drivers()
    assert drivers["three_finger"] == "our_lab_hands:open_ours"
    for name in (*WIRED_HANDS, "mount"):
        assert drivers[name] == "toolee_robot", "ours stays ours"


def test_every_hand_on_a_wire_has_an_emulator() -> None:
    for name in WIRED_HANDS:
        with emulated_hand(HandConfig(name)) as emulator:
            assert emulator.port.startswith("ws://127.0.0.1:" if name == "shadow_right" else "/dev/")
    with emulated_hand(HandConfig("inspire_rh56", port="tcp://192.168.11.210:6000")) as emulator:
        assert emulator.port.startswith("tcp://127.0.0.1:"), "not at the real hand's address"
    with raises(ConfigError, "config.hand_driver"):
        emulated_hand(HandConfig("three_finger"))


@pytest.mark.parametrize(
    ("model", "port"),
    [
        ("ability_hand", "tcp://192.168.11.210:6000"),
        ("inspire_rh56", "tcp://192.168.11.210"),
        ("inspire_rh56", "ws://192.168.11.210:9090"),
        ("shadow_right", "tcp://192.168.11.210:9090"),
    ],
)
def test_a_port_that_the_hand_cannot_have(model: str, port: str) -> None:
    mounting = None if model == "shadow_right" else MOUNTING
    config = HandConfig(model, port=port, mounting=mounting, efforts=HandEfforts(60.0, 300.0, 0.03))
    with raises(ConfigError, "config.hand_port"):
        open_hand(config, HostClock())
    with raises(ConfigError, "config.hand_port"):
        emulated_hand(config)


def test_an_inspire_hand_needs_a_port() -> None:
    with raises(ConfigError, "config.hand_port"):
        open_hand(HandConfig("inspire_rh56", mounting=MOUNTING), HostClock())


def test_a_shadow_hand_needs_what_only_a_lab_can_measure() -> None:
    with raises(ConfigError, "config.hand_port"):
        open_hand(HandConfig("shadow_right"), HostClock())
    with raises(ConfigError, "config.hand_efforts") as lacking:
        open_hand(HandConfig("shadow_right", port="ws://127.0.0.1:9090"), HostClock())
    assert "hand.efforts.newtons_per_unit" in str(lacking.value)
    efforts = HandEfforts(60.0, 300.0, 0.03)
    numbered = HandConfig("shadow_right", port="ws://127.0.0.1:9090", hand_id=3, efforts=efforts)
    with raises(ConfigError, "config.hand_id"):
        open_hand(numbered, HostClock())
    with raises(ConfigError, "config.hand_id"):
        emulated_hand(numbered)
    for wrong in ((0.0, 300.0, 0.03), (60.0, 50.0, 0.03), (60.0, 300.0, -1.0)):
        with pytest.raises(ValueError, match="must be more than"):
            HandEfforts(*wrong)

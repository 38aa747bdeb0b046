"""The hand's driver that a station file names: this project's, or one that a lab's own package brings."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.errors import raises
from toolee_robot.config import HandConfig
from toolee_robot.errors import ConfigError
from toolee_robot.robots import HANDS
from toolee_robot.runtime.clock import HostClock
from toolee_robot.stations.hand import WIRED_HANDS, emulated_hand, hand_drivers, open_hand


def test_a_labs_own_driver_is_found_by_its_entry_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "our_lab_hands.py").write_text("def open_ours(model, config, clock):\n    return model, config.port\n")
    info = tmp_path / "our_lab_hands-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: our_lab_hands\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[toolee_robot.devices]\n"
        "hand.shadow_right = our_lab_hands:open_ours\n"
        "hand.inspire_rh56 = our_lab_hands:no_such\n"
    )
    with raises(ConfigError, "config.hand_driver"):
        open_hand(HandConfig("shadow_right", port="here"), HostClock())
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    ours: object = open_hand(HandConfig("shadow_right", port="here"), HostClock())
    assert ours == (HANDS["shadow_right"], "here")
    drivers = hand_drivers()
    assert drivers["shadow_right"] == "our_lab_hands:open_ours"
    assert drivers["inspire_rh56"] == drivers["ability_hand"] == drivers["mount"] == "toolee_robot", "ours stays ours"


def test_every_hand_on_a_line_has_an_emulator_with_its_number() -> None:
    for name in WIRED_HANDS:
        with emulated_hand(HandConfig(name)) as emulator:
            assert emulator.port.startswith("/dev/")
    with raises(ConfigError, "config.hand_driver"):
        emulated_hand(HandConfig("shadow_right"))

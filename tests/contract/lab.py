"""A lab's own devices, from its station file, and the person at the terminal who takes part."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from toolee_robot.robots import MOUNT
from toolee_robot.station import HandConfig, StationConfig, load_station

OPTIONS = {
    "test_camera_contract.py": "--camera",
    "test_hand_contract.py": "--hand",
    "test_person_contract.py": "--person",
}
"""Option that names the station file of a suite, in which the rig `lab` is that file's device."""


def station_of(config: pytest.Config, option: str) -> StationConfig:
    return load_station(Path(config.getoption(option)))


def hand_of(config: pytest.Config) -> HandConfig:
    hand = station_of(config, "--hand").hand
    if hand.model == MOUNT:
        pytest.skip("a mount has no fingers")
    return hand


def teller(config: pytest.Config) -> Callable[[str], None]:
    """What shows a line to the person."""
    capture = config.pluginmanager.getplugin("capturemanager")

    def tell(text: str) -> None:
        capture.suspend()
        print(f"\n{text}", flush=True)
        capture.resume()

    return tell


def asker(config: pytest.Config) -> Callable[[str], None]:
    """What asks the person to do something, and waits for Enter."""
    capture = config.pluginmanager.getplugin("capturemanager")

    def ask(text: str) -> None:
        capture.suspend(in_=True)
        try:
            print(f"\n{text} Then press Enter.", flush=True)
            input()
        except EOFError:
            pytest.fail("nobody is at the terminal: name the file of the suite, or give -n0")
        finally:
            capture.resume()

    return ask

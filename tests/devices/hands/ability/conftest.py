"""The driver on the emulated hand."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from toolee_robot.devices.hands.ability import AbilityHand
from toolee_robot.robots import HandModel, hand_model
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.ability_hand import AbilityEmulator
from toolee_robot.station import HandConfig
from toolee_robot.types import HandMounting

MOUNTING = HandMounting(position=(0.0, 0.0, 0.03), fingers=(0.0, 0.0, 1.0), thumb=(1.0, 0.0, 0.0))


@pytest.fixture(scope="session")
def model() -> HandModel:
    return hand_model(HandConfig("ability_hand", mounting=MOUNTING))


@pytest.fixture
def emulator() -> Iterator[AbilityEmulator]:
    with AbilityEmulator() as emulator:
        yield emulator


@pytest.fixture
def hand(emulator: AbilityEmulator, model: HandModel) -> Iterator[AbilityHand]:
    with AbilityHand(model, emulator.port, HostClock()) as hand:
        yield hand

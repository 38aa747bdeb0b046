"""The driver on the emulated hand."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from toolee_robot.devices.hands.shadow import ShadowHand
from toolee_robot.robots import HandModel, hand_model
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.shadow_hand import ShadowEmulator
from toolee_robot.types import HandEfforts

EFFORTS = HandEfforts(touch=60.0, grip=300.0, newtons_per_unit=0.03)


@pytest.fixture(scope="session")
def model() -> HandModel:
    return hand_model("shadow_right")


@pytest.fixture
def emulator() -> Iterator[ShadowEmulator]:
    interval = sys.getswitchinterval()
    sys.setswitchinterval(5e-4)  # driver and emulator are in this process
    try:
        with ShadowEmulator() as emulator:
            yield emulator
    finally:
        sys.setswitchinterval(interval)


@pytest.fixture
def hand(emulator: ShadowEmulator, model: HandModel) -> Iterator[ShadowHand]:
    with ShadowHand(model, emulator.port, EFFORTS, HostClock()) as hand:
        yield hand

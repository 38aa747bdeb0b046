"""The drivers on the emulated hands. The Inspire's is on either wire, its motors four times as fast as real ones."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from tests.rigs.wired_hands import EFFORTS, MOUNTING
from toolee_robot.devices.hands import inspire as inspire_driver
from toolee_robot.devices.hands.ability import AbilityHand
from toolee_robot.devices.hands.inspire import InspireHand
from toolee_robot.devices.hands.shadow import ShadowHand
from toolee_robot.robots import HandModel, hand_model
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.hands.ability import AbilityEmulator
from toolee_robot.sim_backend.hands.inspire import InspireEmulator, ModbusEmulator
from toolee_robot.sim_backend.hands.shadow import ShadowEmulator
from toolee_robot.station import HandConfig

PACE = 4.0
InspireWire = InspireEmulator | ModbusEmulator


@pytest.fixture(scope="session")
def inspire_model() -> HandModel:
    return hand_model(HandConfig("inspire_rh56", mounting=MOUNTING))


@pytest.fixture(scope="session")
def ability_model() -> HandModel:
    return hand_model(HandConfig("ability_hand", mounting=MOUNTING))


@pytest.fixture(scope="session")
def shadow_model() -> HandModel:
    return hand_model("shadow_right")


@pytest.fixture(
    params=[
        pytest.param(InspireEmulator, id="rs485"),
        pytest.param(ModbusEmulator, id="modbus", marks=pytest.mark.nightly),  # `test_modbus.py` is in every run
    ]
)
def inspire(request: pytest.FixtureRequest) -> Iterator[InspireWire]:
    with request.param(pace=PACE) as emulator:
        yield emulator


@pytest.fixture
def inspire_hand(inspire: InspireWire, inspire_model: HandModel) -> Iterator[InspireHand]:
    with InspireHand(inspire_model, inspire.port, HostClock()) as hand:
        yield hand


@pytest.fixture
def unhurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reply has a second to come: what this machine holds up is late, and only what never comes is lost."""
    monkeypatch.setattr(inspire_driver, "ANSWER_S", 1.0)


@pytest.fixture
def ability() -> Iterator[AbilityEmulator]:
    with AbilityEmulator() as emulator:
        yield emulator


@pytest.fixture
def ability_hand(ability: AbilityEmulator, ability_model: HandModel) -> Iterator[AbilityHand]:
    with AbilityHand(ability_model, ability.port, HostClock()) as hand:
        yield hand


@pytest.fixture
def shadow() -> Iterator[ShadowEmulator]:
    interval = sys.getswitchinterval()
    sys.setswitchinterval(5e-4)  # driver and emulator are in this process
    try:
        with ShadowEmulator() as emulator:
            yield emulator
    finally:
        sys.setswitchinterval(interval)


@pytest.fixture
def shadow_hand(shadow: ShadowEmulator, shadow_model: HandModel) -> Iterator[ShadowHand]:
    with ShadowHand(shadow_model, shadow.port, EFFORTS, HostClock()) as hand:
        yield hand

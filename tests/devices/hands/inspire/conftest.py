"""The driver on the emulated hand, on either wire; its motors are four times as fast as real ones."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from toolee_robot.devices.hands.inspire import InspireHand, line
from toolee_robot.robots import HandModel, hand_model
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend.inspire_hand import InspireEmulator, ModbusEmulator
from toolee_robot.station import HandConfig
from toolee_robot.types import HandMounting

PACE = 4.0
MOUNTING = HandMounting(position=(0.0, 0.0, 0.08), fingers=(0.0, 0.0, 1.0), thumb=(1.0, 0.0, 0.0))


@pytest.fixture(scope="session")
def model() -> HandModel:
    return hand_model(HandConfig("inspire_rh56", mounting=MOUNTING))


Emulator = InspireEmulator | ModbusEmulator


@pytest.fixture(params=[InspireEmulator, ModbusEmulator], ids=["rs485", "modbus"])
def emulator(request: pytest.FixtureRequest) -> Iterator[Emulator]:
    with request.param(pace=PACE) as emulator:
        yield emulator


@pytest.fixture
def hand(emulator: Emulator, model: HandModel) -> Iterator[InspireHand]:
    with InspireHand(model, emulator.port, HostClock()) as hand:
        yield hand


@pytest.fixture
def unhurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reply has a second to come: what this machine holds up is late, and only what never comes is lost."""
    monkeypatch.setattr(line, "ANSWER_TIME", 1.0)

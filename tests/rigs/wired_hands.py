"""The hands on wires that have a driver and an emulator: one entry each, which all tests of every hand go through."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from toolee_robot.hal import Hand, HandState
from toolee_robot.sim_backend.hands import emulated_hand
from toolee_robot.sim_backend.hands.kit import HandEmulator
from toolee_robot.station import HandConfig
from toolee_robot.types import HandEfforts, HandMounting

MOUNTING = HandMounting(position=(0.0, 0.0, 0.08), fingers=(0.0, 0.0, 1.0), thumb=(1.0, 0.0, 0.0))
"""Any."""
EFFORTS = HandEfforts(touch=60.0, grip=300.0, newtons_per_unit=0.03)
"""Of the emulated Shadow Hand."""
TCP = "tcp://127.0.0.1:6000"
"""Tells the wire only: an emulated hand listens at any port that is free."""


@dataclass(frozen=True)
class Unheard:
    """How a hand goes on telling its state and takes no command, nor acknowledges one."""

    event: str
    says: str
    code: str
    gives: float


@dataclass(frozen=True)
class WiredHand:
    """A hand on one of its wires."""

    config: HandConfig
    label: str
    handle: float
    heats: str
    jams: str = "jam middle"
    slip: float = 0.0
    margin: float = 0.0
    unheard: Unheard | None = None
    pace: float = 1.0
    rest: float = 0.1
    bends: float = 0.8


def _inspire(label: str, port: str | None) -> WiredHand:
    config = HandConfig("inspire_rh56", mounting=MOUNTING, port=port)
    deaf = Unheard("deaf", "register", "no_answer.hand_write", 25.0)  # 25 counts take half of the force
    return WiredHand(config, label, 400.0, "heat index 75", slip=60.0, margin=110.0, unheard=deaf, pace=4.0)


def _robotiq(model: str, label: str) -> WiredHand:
    config = HandConfig(model, mounting=MOUNTING, port=TCP)
    return WiredHand(config, label, 150.0, "heat 90", bends=0.79)  # all that its linkage does


HANDS = {
    "inspire": _inspire("Inspire RH56", None),
    "ability": WiredHand(
        HandConfig("ability_hand", mounting=MOUNTING), "Ability Hand", 55.0, "heat 75", slip=6.0, margin=15.0, rest=0.4
    ),
    "inspire_tcp": _inspire("Inspire Modbus-TCP", TCP),
    "shadow": WiredHand(
        HandConfig("shadow_right", efforts=EFFORTS), "Shadow Hand", 55.0, "heat FFJ3 75", "jam MFJ3", 6.0, 15.0,
        Unheard("controllers off", "its controllers do not follow commands", "device.hand_command", 6.0), rest=0.4,
    ),
    "robotiq": _robotiq("robotiq_2f85", "Robotiq 2F-85"),
    "robotiq_2f140": _robotiq("robotiq_2f140", "Robotiq 2F-140"),
}  # fmt: skip
"""Name -> hand. The motors of the Ability Hand approach their targets with a time constant of 67 ms."""


@contextmanager
def emulated(hand: WiredHand) -> Iterator[tuple[HandConfig, HandEmulator[Any]]]:
    """An emulated hand in this process: what a station file says of it, with its port; and the emulator."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(5e-4)  # driver and emulator are in this process
    try:
        with emulated_hand(hand.config, pace=hand.pace) as emulator:
            yield replace(hand.config, port=emulator.port), emulator
    finally:
        sys.setswitchinterval(interval)


def eventually(condition: Callable[[], bool], within: float = 5.0) -> None:
    """Wait until something is so."""
    end = time.monotonic() + within
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def told(hand: Hand) -> HandState:
    """A hand's state, however busy this machine is."""
    return hand.state(max_age=2.0)

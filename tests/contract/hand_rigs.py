"""The hands that the contract suite runs on, and what can be done to each from outside."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from tests.rigs.wired_hands import WiredHand
from toolee_robot.control import CollisionWorld, RobotModel, plan_handover
from toolee_robot.devices.hands import MountedTool, open_hand
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, Hand
from toolee_robot.robots import SHADOW_HAND, HandModel, hand_model
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.devices.hand import SimHand
from toolee_robot.sim_backend.hands.kit import HandEmulator
from toolee_robot.station import HandConfig, sim_station
from toolee_robot.types import ToolMount

MOUNT = ToolMount(
    position=(0.0, 0.0, 0.14), handle=(1.0, 0.0, 0.0), working_side=(0.0, 0.0, 1.0), mass=1.1,
    center_of_mass=(0.0, 0.0, 0.07), clamp_mass=0.3, body_size=(0.09, 0.09, 0.17), body_position=(0.0, 0.0, 0.085),
    hinge_position=(-0.03, 0.0, 0.1), hinge_axis=(0.0, 1.0, 0.0), stiffness=0.0, travel=0.6,
)  # fmt: skip


class Rig(ABC):
    """A hand, and what can be made of it."""

    hand: Hand
    model: HandModel
    clock: Clock
    senses = True
    rest = 0.1
    reading = 2e-3
    bends = 0.8

    @abstractmethod
    def give(self) -> None:
        """A person lays a handle into the open hand."""

    def cut(self) -> None:
        """The hand falls silent."""
        raise NotImplementedError

    def restore(self) -> None:
        """It answers again."""
        raise NotImplementedError


class SimRig(Rig):
    """The simulated Shadow Hand in the handover's pose."""

    def __init__(self, simulation: SimStation) -> None:
        self._simulation = simulation
        assert isinstance(simulation.station.hand, SimHand)
        self.hand = self._hand = simulation.station.hand
        self.model, self.clock = SHADOW_HAND, simulation.station.clock

    def give(self) -> None:
        assert self._simulation.station.person.request_handover("", 10.0)

    def cut(self) -> None:
        self._hand.cut_link()

    def restore(self) -> None:
        self._hand.restore_link()


class MountRig(Rig):
    """A tool mount: it knows what a person said."""

    senses = False

    def __init__(self) -> None:
        self.model = hand_model(HandConfig("mount", yield_torque=3.3, mount=MOUNT))
        self.clock = HostClock()
        self.hand = MountedTool(self.model, self.clock)

    def give(self) -> None:
        pass


class EmulatedRig(Rig):
    """A driver on its emulated hand."""

    def __init__(self, wired: WiredHand, config: HandConfig, emulator: HandEmulator[Any]) -> None:
        self._wired, self._emulator = wired, emulator
        self.model, self.clock = hand_model(config), HostClock()
        self.hand = open_hand(config, self.clock)
        self.rest, self.bends = wired.rest, wired.bends

    def give(self) -> None:
        self._emulator.hold(self._wired.handle)

    def cut(self) -> None:
        self._emulator.faults.muted = True

    def restore(self) -> None:
        self._emulator.faults.muted = False


class LabRig(Rig):
    """The hand of a station file."""

    rest = 0.5
    reading = 0.01

    def __init__(self, config: HandConfig, ask: Callable[[str], None]) -> None:
        self.model, self.clock, self._ask = hand_model(config), HostClock(), ask
        with open_hand(config, self.clock) as hand:
            ask("Take hold of what the hand holds. It opens, and may close on nothing next: keep out of its fingers.")
            hand.open()
        self.hand = open_hand(config, self.clock)

    def give(self) -> None:
        self._ask("Hold a handle in the open palm: the fingers close on it, and open again some seconds later.")


@cache
def at_handover() -> Array:
    config, robot = sim_station(), RobotModel.of_station(sim_station())
    q_open = robot.description.hand_open
    world = CollisionWorld(robot, config, q_open)
    return plan_handover(robot, config, world, np.array(config.scene.home), q_open).q[-1]

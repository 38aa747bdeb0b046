"""What `hal.Hand` promises, asked of every hand: the simulated hand, the tool mount, and the drivers of the Inspire, on
both of its wires, the Ability Hand and the Shadow Hand on their emulators."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from functools import cache

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.config import HandConfig, StationConfig
from toolee_robot.control import CollisionWorld, RobotModel, plan_handover
from toolee_robot.errors import DeviceError, StaleDataError
from toolee_robot.frames import Array
from toolee_robot.hal import Clock, Hand, HandState
from toolee_robot.hardware.hands.ability import AbilityHand
from toolee_robot.hardware.hands.inspire import InspireHand
from toolee_robot.hardware.hands.mount import MountedTool
from toolee_robot.hardware.hands.shadow import ShadowHand
from toolee_robot.robots import PALM, SHADOW_HAND, HandModel, hand_model
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.ability_hand import AbilityEmulator
from toolee_robot.sim_backend.devices.hand import SimHand
from toolee_robot.sim_backend.inspire_hand import InspireEmulator, ModbusEmulator
from toolee_robot.sim_backend.shadow_hand import ShadowEmulator
from toolee_robot.types import HandEfforts, HandMounting, ToolMount

MOUNTING = HandMounting(position=(0.0, 0.0, 0.08), fingers=(0.0, 0.0, 1.0), thumb=(1.0, 0.0, 0.0))
MOUNT = ToolMount(
    position=(0.0, 0.0, 0.14), handle=(1.0, 0.0, 0.0), working_side=(0.0, 0.0, 1.0), mass=1.1,
    center_of_mass=(0.0, 0.0, 0.07), clamp_mass=0.3, body_size=(0.09, 0.09, 0.17), body_position=(0.0, 0.0, 0.085),
    hinge_position=(-0.03, 0.0, 0.1), hinge_axis=(0.0, 1.0, 0.0), stiffness=0.0, travel=0.6,
)  # fmt: skip


class Rig(ABC):
    """A hand, and what can be made of it.

    Attributes:
        senses: Whether it can tell what it holds, and when it is silent.
        rest: Time until its fingers stand after a stop [s].
    """

    hand: Hand
    model: HandModel
    clock: Clock
    senses = True
    rest = 0.1

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


class InspireRig(Rig):
    """The Inspire driver on the emulated hand, whose motors are four times as fast as real ones."""

    def __init__(self, emulator: InspireEmulator | ModbusEmulator) -> None:
        self._emulator = emulator
        self.model = hand_model(HandConfig("inspire_rh56", mounting=MOUNTING))
        self.clock = HostClock()
        self.hand = InspireHand(self.model, emulator.port, self.clock)

    def give(self) -> None:
        self._emulator.tell(lambda hand: hand.hold(400.0))

    def cut(self) -> None:
        self._emulator.faults.muted = True

    def restore(self) -> None:
        self._emulator.faults.muted = False


class AbilityRig(Rig):
    """The Ability Hand's driver on the emulated hand."""

    rest = 0.4  # its motors approach their targets with a time constant of 67 ms

    def __init__(self, emulator: AbilityEmulator) -> None:
        self._emulator = emulator
        self.model = hand_model(HandConfig("ability_hand", mounting=MOUNTING))
        self.clock = HostClock()
        self.hand = AbilityHand(self.model, emulator.port, self.clock)

    def give(self) -> None:
        self._emulator.hold(55.0)

    def cut(self) -> None:
        self._emulator.faults.muted = True

    def restore(self) -> None:
        self._emulator.faults.muted = False


class ShadowRig(Rig):
    """The Shadow Hand's driver on the emulated hand, over a websocket."""

    rest = 0.4

    def __init__(self, emulator: ShadowEmulator) -> None:
        self._emulator = emulator
        self.model = SHADOW_HAND
        self.clock = HostClock()
        self.hand = ShadowHand(self.model, emulator.port, HandEfforts(60.0, 300.0, 0.03), self.clock)

    def give(self) -> None:
        self._emulator.hold(55.0)

    def cut(self) -> None:
        self._emulator.faults.muted = True

    def restore(self) -> None:
        self._emulator.faults.muted = False


@cache
def at_handover() -> Array:
    config, robot = StationConfig(), RobotModel.of_station(StationConfig())
    q_open = robot.description.hand_open
    world = CollisionWorld(robot, config, q_open)
    return plan_handover(robot, config, world, np.array(config.scene.home), q_open).q[-1]


TIERS = {
    "simulated": pytest.mark.sim,
    "mount": pytest.mark.unit,
    "inspire": pytest.mark.realtime(light=True),
    "inspire_tcp": pytest.mark.realtime(light=True),
    "ability": pytest.mark.realtime(light=True),
    "shadow": pytest.mark.realtime(light=True),
}


def on(*rigs: str, nightly: tuple[str, ...] = ()) -> pytest.MarkDecorator:
    """Which hands a promise is asked of, and which of them only in the night, for the time that it takes."""
    chosen = [pytest.param(rig, marks=TIERS[rig]) for rig in rigs]
    chosen += [pytest.param(rig, marks=(TIERS[rig], pytest.mark.nightly)) for rig in nightly]
    return pytest.mark.parametrize("rig", chosen, indirect=True)


@pytest.fixture
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    if request.param == "mount":
        yield MountRig()
    elif request.param == "inspire":
        with InspireEmulator(pace=4.0) as emulator:
            yield InspireRig(emulator)
    elif request.param == "inspire_tcp":
        with ModbusEmulator(pace=4.0) as modbus:
            yield InspireRig(modbus)
    elif request.param == "ability":
        with AbilityEmulator() as ability:
            yield AbilityRig(ability)
    elif request.param == "shadow":
        with ShadowEmulator() as shadow:
            yield ShadowRig(shadow)
    else:
        with SimStation.build(StationConfig(), 100, SimOptions(q_start=at_handover())) as simulation:
            yield SimRig(simulation)


def state(rig: Rig) -> HandState:
    return rig.hand.state(max_age=1.0)


@on("simulated", "mount", "inspire", "inspire_tcp", "ability", "shadow")
def test_its_state_is_that_of_its_model(rig: Rig) -> None:
    assert isinstance(rig.hand, Hand)
    assert rig.hand.joint_names == rig.model.joints
    with rig.hand as hand:
        before = state(rig)
        assert before.joints.q.shape == before.joints.qd.shape == (len(rig.model.joints),)
        assert np.all(np.isfinite(before.joints.q))
        assert 0.0 <= rig.clock.now() - before.joints.stamp < 1.0
        known = {*(finger.name for finger in rig.model.fingers), PALM}
        assert known >= set(before.contact_forces)
        assert set(before.contact_forces) >= known - {PALM} if rig.senses else not before.contact_forces
        assert not before.holding
        assert before.fault == ""
        rig.clock.sleep(0.1)
        assert hand.state(max_age=1.0).joints.stamp > before.joints.stamp
    with raises(DeviceError, "device.closed") if rig.senses else nullcontext():
        hand.state()


@on("simulated", "mount", "inspire", "inspire_tcp", "ability", "shadow")
def test_it_holds_what_it_closed_on_and_lets_go_when_it_opens(rig: Rig) -> None:
    with rig.hand as hand:
        hand.open()
        rig.give()
        hand.close()
        held = state(rig)
        assert held.holding
        assert held.fault == ""
        assert all(force >= 0.0 for force in held.contact_forces.values())
        if rig.senses:
            assert held.contact_forces[rig.model.opposing.name] > 1.0
        rig.clock.sleep(0.3)
        assert state(rig).holding
        hand.stop()
        rig.clock.sleep(0.1)
        assert state(rig).holding, "a stop never lets go"
        hand.open()
        assert not state(rig).holding
        opened = np.abs(state(rig).joints.q - rig.model.posture("open"))
        assert opened[len(rig.model.wrist) :].max(initial=0.0) < 0.1


@on("inspire", "inspire_tcp", "ability", "shadow", nightly=("simulated",))
def test_closed_on_nothing_it_holds_nothing(rig: Rig) -> None:
    with rig.hand as hand:
        hand.close()
        assert not state(rig).holding
        bent = state(rig).joints.q - rig.model.posture("open")
        assert np.abs(bent).max() > 0.8


@on(nightly=("simulated", "inspire", "inspire_tcp", "ability", "shadow"))
def test_a_time_out_is_an_error_and_keeps_the_grip(rig: Rig) -> None:
    with rig.hand as hand:
        with raises(DeviceError, "device.timeout"):
            hand.close(timeout=0.05)
        hand.open()
        rig.give()
        hand.close()
        with raises(DeviceError, "device.timeout"):
            hand.close(timeout=0.001)
        rig.clock.sleep(0.2)
        assert state(rig).holding


@on(nightly=("simulated", "inspire", "inspire_tcp", "ability", "shadow"))
def test_a_hand_that_is_silent_has_no_state_and_keeps_its_grip(rig: Rig) -> None:
    with rig.hand as hand:
        rig.give()
        hand.close()
        rig.cut()
        rig.clock.sleep(0.3)
        with raises(StaleDataError, "stale_data.hand"):
            hand.state()
        rig.restore()
        rig.clock.sleep(0.4)
        assert state(rig).holding


@on("inspire", "inspire_tcp", "ability", "shadow")
def test_it_is_watched_and_stopped_by_other_threads_while_it_closes(rig: Rig) -> None:
    with rig.hand as hand, ThreadPoolExecutor() as pool:
        closing = pool.submit(hand.close)
        for _ in range(10):
            assert state(rig).joints.q.shape == (len(rig.model.joints),)
            time.sleep(0.02)
        hand.stop()
        with raises(DeviceError, "device.stopped"):
            closing.result(2.0)
        time.sleep(rig.rest)
        stands = state(rig).joints.q
        time.sleep(0.1)
        np.testing.assert_allclose(state(rig).joints.q, stands, atol=2e-3)

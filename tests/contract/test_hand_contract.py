"""What `hal.Hand` promises, asked of every hand.

The simulated hand, the tool mount, and every driver on its emulator, the Inspire's on both of its wires; with --hand
lab.yaml, the station file's.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import numpy as np
import pytest

from tests.contract.hand_rigs import EmulatedRig, LabRig, MountRig, Rig, SimRig, at_handover
from tests.contract.lab import asker, hand_of
from tests.errors import raises
from tests.rigs.wired_hands import HANDS, emulated
from toolee_robot.errors import DeviceError, StaleDataError
from toolee_robot.hal import Hand, HandState
from toolee_robot.robots import PALM
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.station import sim_station

EMULATED = tuple(name for name in HANDS if name != "robotiq_2f140")
OTHERS = tuple(name for name in EMULATED if name != "robotiq")
"""Their own drivers' tests are in `tests/devices/hands`."""
TIERS = {
    "simulated": pytest.mark.sim,
    "mount": pytest.mark.unit,
    **dict.fromkeys(EMULATED, pytest.mark.realtime(light=True)),
    "lab": pytest.mark.realtime,
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
    elif request.param == "lab":
        yield LabRig(hand_of(request.config), asker(request.config))
    elif request.param in HANDS:
        with emulated(HANDS[request.param]) as (config, emulator):
            yield EmulatedRig(HANDS[request.param], config, emulator)
    else:
        with SimStation.build(sim_station(), 100, SimOptions(q_start=at_handover())) as simulation:
            yield SimRig(simulation)


def state(rig: Rig) -> HandState:
    return rig.hand.state(max_age=1.0)


@on("simulated", "mount", "robotiq", "lab", nightly=OTHERS)
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


@on("simulated", "mount", "robotiq", "lab", nightly=OTHERS)
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


@on("robotiq", "lab", nightly=("simulated", *OTHERS))
def test_closed_on_nothing_it_holds_nothing(rig: Rig) -> None:
    with rig.hand as hand:
        hand.close()
        assert not state(rig).holding
        bent = state(rig).joints.q - rig.model.posture("open")
        assert np.abs(bent).max() > rig.bends


@on("robotiq", "lab", nightly=OTHERS)  # the simulated hand has nothing to do when it holds the tool: it returns at once
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


@on("robotiq", nightly=("simulated", *OTHERS))
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


@on("robotiq", "lab", nightly=OTHERS)
def test_it_is_watched_and_stopped_by_other_threads_while_it_closes(rig: Rig) -> None:
    with rig.hand as hand, ThreadPoolExecutor() as pool:
        closing = pool.submit(hand.close)
        for _ in range(10):
            assert state(rig).joints.q.shape == (len(rig.model.joints),)
            time.sleep(0.02)
        hand.stop()
        with raises(DeviceError, says="stopped"):
            closing.result(2.0)
        time.sleep(rig.rest)
        stands = state(rig).joints.q
        time.sleep(0.1)
        np.testing.assert_allclose(state(rig).joints.q, stands, atol=rig.reading)

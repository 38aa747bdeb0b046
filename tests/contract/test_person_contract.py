"""What `hal.Person` promises, asked of every person: the simulated one, and the one on a robot's digital inputs; with
--person lab.yaml, the station file's."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from tests.contract.lab import station_of, teller
from tests.rigs.panel import ONE_CONTACT, SWITCH_HELD, TWO_CONTACTS, Operator, Panel
from toolee_robot.devices.person import DigitalInputPerson, open_person
from toolee_robot.hal import CLEAR_TIME, Arm, Clock, Person
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.world import Sample
from toolee_robot.station import PersonConfig, StationConfig, sim_station
from toolee_robot.stations.lab import ur_driver
from toolee_robot.tasks.common.motions import HOLD_SWITCH
from toolee_robot.tasks.common.watches import PersonProof

LATE = 1.0  # [s] that a slow person takes


class Rig(ABC):
    """Somebody with the tool at the arm, and what can be made of them."""

    person: Person
    clock: Clock
    patience = 4.0  # [s] for a question that will be answered
    late = 0.5  # [s] that the end of a wait may be

    @abstractmethod
    def stay(self) -> None:
        """From now on they ignore what they are asked to do."""

    @abstractmethod
    def linger(self) -> None:
        """They step back, but LATE."""

    @abstractmethod
    def return_once(self) -> None:
        """They step back, come back within CLEAR_TIME, and step back again."""

    @abstractmethod
    def stick_switch(self) -> None:
        """The hold-to-run switch reads held, whatever they do; or they leave it."""

    def elapsed(self, question: Callable[[], bool], answer: bool) -> float:
        """Ask; how long it took [s]."""
        began = self.clock.now()
        assert question() is answer
        return self.clock.now() - began


class SimRig(Rig):
    def __init__(self, sim: SimStation) -> None:
        self._sim, self.person, self.clock = sim, sim.person, sim.station.clock
        sim.person.stays, sim.person.lingers, sim.person.holds_switch = False, 0.0, True
        sim.observers.clear()
        sim.person.step_in()

    def stay(self) -> None:
        self._sim.person.stays = True

    def linger(self) -> None:
        self._sim.person.lingers = LATE

    def return_once(self) -> None:
        due: list[float] = []

        def watch(sample: Sample) -> None:
            if not self.person.zone_occupied() and not due:
                due.append(sample.stamp + 0.5 * CLEAR_TIME)
            if due and sample.stamp >= due[0]:
                self._sim.observers.clear()
                self._sim.person.step_in()
                self._sim.observers.append(go)
                due[0] = sample.stamp + 0.2

        def go(sample: Sample) -> None:
            if sample.stamp >= due[0]:
                self._sim.observers.clear()
                self._sim.person.center = self._sim.person.center + 5.0

        self._sim.observers.append(watch)

    def stick_switch(self) -> None:
        self._sim.person.holds_switch = False


class InputsRig(Rig):
    def __init__(self, config: PersonConfig) -> None:
        self.panel, self.clock = Panel(), HostClock()
        self._operator = Operator(self.panel)
        self._tell: Callable[[str], object] = self._operator.tell
        self.person = self.device = DigitalInputPerson(config, self.panel.read, self.clock, lambda p: self._tell(p))

    def stay(self) -> None:
        self._tell = lambda _: None

    def _on_release(self, act: Callable[[], None]) -> None:
        def tell(prompt: str) -> None:
            if "close the door" in prompt:
                threading.Thread(target=act).start()
            else:
                self._operator.tell(prompt)

        self._tell = tell

    def linger(self) -> None:
        def late() -> None:
            time.sleep(LATE)
            self.panel.step_back()

        self._on_release(late)

    def return_once(self) -> None:
        def go_and_come() -> None:
            self.panel.step_back()
            time.sleep(0.3 * CLEAR_TIME)
            self.panel.closed = False
            time.sleep(0.2)
            self.panel.closed = True

        self._on_release(go_and_come)

    def stick_switch(self) -> None:
        self.panel.high = SWITCH_HELD


class LabRig(Rig):
    """Somebody at the door and the switch of a station file, who does what is printed."""

    patience = 60.0

    def __init__(self, config: StationConfig, arm: Arm, tell: Callable[[str], None]) -> None:
        self.clock, self._tell, self._asks = HostClock(), tell, True
        self.person = self.device = open_person(config, arm, self.clock, self._told)

    def _told(self, prompt: str) -> None:
        if self._asks:
            self._tell(prompt.replace("Put the hammer", "Open the door, and put the hammer"))

    def stay(self) -> None:
        self._asks = False
        self._tell("Leave door and switch as they are.")

    stick_switch = stay

    def linger(self) -> None:
        pytest.skip("somebody who is slow on purpose")

    def return_once(self) -> None:
        pytest.skip("somebody who comes back on purpose")


@pytest.fixture(scope="module")
def sim() -> Iterator[SimStation]:
    with SimStation.build(sim_station(), 0, SimOptions()) as sim:
        yield sim


@pytest.fixture(scope="module")
def arm(request: pytest.FixtureRequest) -> Iterator[Arm]:
    config = station_of(request.config, "--person")
    assert config.arm.host is not None, "the station file lacks arm.host"
    with ur_driver(config, config.arm.host) as arm:
        yield arm


@pytest.fixture(
    params=[
        pytest.param("simulated", marks=pytest.mark.sim),
        pytest.param("one contact", marks=(pytest.mark.realtime(light=True), pytest.mark.nightly)),
        pytest.param("two contacts", marks=pytest.mark.realtime(light=True)),
        pytest.param("lab", marks=pytest.mark.realtime),
    ]
)
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    if request.param == "simulated":
        yield SimRig(request.getfixturevalue("sim"))
        return
    if request.param == "lab":
        lab = LabRig(station_of(request.config, "--person"), request.getfixturevalue("arm"), teller(request.config))
        with lab.device:
            yield lab
        return
    rig = InputsRig(ONE_CONTACT if request.param == "one contact" else TWO_CONTACTS)
    if request.param == "two contacts":
        rig.late = np.inf  # in every run, on a busy machine
    with rig.device:
        yield rig


def test_it_is_a_person(rig: Rig) -> None:
    assert isinstance(rig.person, Person)
    assert rig.person.zone_occupied(), "somebody is at the arm, or nothing was read yet"


def test_release_returns_once_the_zone_was_empty_for_its_time(rig: Rig) -> None:
    assert rig.elapsed(lambda: rig.person.release("Step back.", rig.patience), True) >= CLEAR_TIME
    assert not rig.person.zone_occupied()


def test_release_waits_for_somebody_who_is_slow(rig: Rig) -> None:
    """LAB.md, defect 10: it asked once."""
    rig.linger()
    assert rig.elapsed(lambda: rig.person.release("Step back.", rig.patience), True) >= LATE + CLEAR_TIME
    assert not rig.person.zone_occupied()


def test_release_does_not_count_an_empty_zone_that_fills_again(rig: Rig) -> None:
    rig.return_once()
    took = rig.elapsed(lambda: rig.person.release("Step back.", 2.0), not isinstance(rig, InputsRig))
    # On the panel the confirmation of before is void, and nobody gives another one.
    assert took >= 1.3 * CLEAR_TIME
    if not isinstance(rig, InputsRig):
        assert not rig.person.zone_occupied()


def test_nobody_who_stays_is_released_and_the_wait_ends(rig: Rig) -> None:
    rig.stay()
    assert 0.9 <= rig.elapsed(lambda: rig.person.release("Step back.", 1.0), False) <= 1.0 + rig.late


def test_no_answer_in_time_is_a_refusal(rig: Rig) -> None:
    rig.stay()
    assert rig.person.take_tool("Take it.", 0.3) is False


def test_the_switch_is_taken_anew(rig: Rig) -> None:
    assert rig.person.hold_switch(HOLD_SWITCH, rig.patience)
    assert rig.person.hold_to_run_held()


def test_a_switch_that_does_not_change_is_not_taken(rig: Rig) -> None:
    rig.stick_switch()
    assert not rig.person.hold_switch(HOLD_SWITCH, 0.5)


def test_a_handover_shows_every_change(rig: Rig) -> None:
    proof = PersonProof(rig.person)
    assert proof.hold_switch(HOLD_SWITCH, rig.patience)
    proof.request_handover("Put the hammer into the hand.", rig.patience)
    assert proof.release("Step back.", rig.patience)
    assert proof.missing == ()
    assert not proof.zone_occupied()

"""The Inspire driver in the loop: its emulated hand moves the simulated fingers, and feels what they touch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.cli.app import EXIT_USER, run
from toolee_robot.control import CollisionWorld, RobotModel, plan_handover
from toolee_robot.errors import UserError
from toolee_robot.hal import Hand
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.inspire_hand import InspireEmulator, ModbusEmulator
from toolee_robot.station import StationConfig, load_station
from toolee_robot.stations.driven_hand import DrivenHandStation
from toolee_robot.stations.simulated import HandDriver, StandIn, open_station

EXAMPLES = Path(__file__).parents[3] / "examples"
EXAMPLE = EXAMPLES / "inspire.yaml"


@pytest.fixture(scope="module")
def config() -> StationConfig:
    return load_station(EXAMPLE)


@pytest.fixture(scope="module")
def options(config: StationConfig) -> SimOptions:
    robot = RobotModel.of_station(config)
    q_open = robot.description.hand_open
    world = CollisionWorld(robot, config, q_open)
    return SimOptions(q_start=plan_handover(robot, config, world, np.array(config.scene.home), q_open).q[-1])


@pytest.mark.realtime
def test_it_holds_by_contact_what_the_person_lays_into_it_and_tells_a_loss(
    config: StationConfig, options: SimOptions
) -> None:
    with DrivenHandStation(config, 100, options, None) as driven:
        station = driven.station
        assert isinstance(station.hand, Hand)
        station.hand.open()
        assert station.person.request_handover("", 10.0)
        station.hand.close()
        state = station.hand.state(max_age=1.0)
        assert state.holding
        assert state.assisted
        assert 0.0 <= station.clock.now() - state.joints.stamp < 1.0
        truth = driven.simulation.world.robot.hand_state()[0]
        assert np.median(np.abs(truth - state.joints.q)) < 0.1, "the simulated fingers are where the driver's are"
        assert station.person.release("", 10.0)
        grip = driven.simulation.world.grip
        assert grip is not None
        grip.release()
        station.hand.state(max_age=1.0)
        station.clock.sleep(0.5)
        assert not station.hand.state(max_age=1.0).holding


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("name", "knuckles"), [("ability", [0, 2, 4, 6]), pytest.param("shadow", [3, 7, 11, 16], marks=pytest.mark.nightly)]
)
def test_the_others_hold_by_contact_too(name: str, knuckles: list[int]) -> None:
    config = load_station(EXAMPLES / f"{name}.yaml")
    robot = RobotModel.of_station(config)
    q_open = robot.description.hand_open
    way = plan_handover(robot, config, CollisionWorld(robot, config, q_open), np.array(config.scene.home), q_open)
    with DrivenHandStation(config, 100, SimOptions(q_start=way.q[-1]), None) as driven:
        hand = driven.station.hand
        hand.open()
        assert driven.station.person.request_handover("", 10.0)
        hand.close()
        state = hand.state(max_age=1.0)
        assert state.holding
        assert state.assisted
        truth = driven.simulation.world.robot.hand_state()[0]
        distance = np.abs(truth - state.joints.q)[knuckles]
        assert np.median(distance) < 0.1, "the simulated knuckles are where the driver's are"


@pytest.mark.nightly
@pytest.mark.realtime
@pytest.mark.parametrize("kind", [InspireEmulator, ModbusEmulator])
def test_a_hand_emulated_elsewhere_moves_them_too(
    config: StationConfig, options: SimOptions, kind: type[InspireEmulator] | type[ModbusEmulator]
) -> None:
    with kind() as emulator, DrivenHandStation(config, 100, options, emulator.port) as driven:
        emulator.tell(lambda hand: hand.hold(400.0))
        assert driven.station.person.request_handover("", 10.0)
        driven.station.hand.close()
        state = driven.station.hand.state(max_age=1.0)
        assert state.holding
        assert state.assisted


@pytest.mark.sim
def test_a_strap_adds_to_what_the_fingers_hold(config: StationConfig, options: SimOptions) -> None:
    assert config.hand.strap_force == 60.0
    with SimStation.build(config, 100, options) as simulation:
        assert simulation.station.person.request_handover("", 10.0)
        simulation.station.hand.close()
        assert simulation.world.grip is not None
        assert simulation.world.grip.limits.across > 60.0


@pytest.mark.parametrize(
    "words",
    [
        ["--hand", "inspire"],
        ["--hand-port", "/dev/pts/9"],
        ["--hand", "inspire", "--config", str(EXAMPLE), "--arm", "ur-rtde"],
    ],
)
def test_options_that_do_not_go_together(words: list[str], tmp_path: Path) -> None:
    assert run(["hammer", "--out", str(tmp_path), *words]) == EXIT_USER


def test_both_drivers_at_once_are_refused(config: StationConfig) -> None:
    with raises(UserError, "user.option"):
        open_station(config, stand_in=StandIn("127.0.0.77", 0.2), hand_driver=HandDriver())

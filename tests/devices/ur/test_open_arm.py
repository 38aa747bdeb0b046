"""A lab's arm, from the station file and an address: under the supervisor from the first motion on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tests.errors import raises
from tests.rigs.people import People
from tests.sim_backend.kinematics import line
from tests.stand_in import HOME, stand_in
from toolee_robot.control import RobotModel
from toolee_robot.errors import LimitError, NotReadyError, PersonNearError
from toolee_robot.hal import Arm, MotionOutcome
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.station import sim_station
from toolee_robot.stations.lab import open_arm
from toolee_robot.types import ArmModel

HOST = "127.0.0.34"
CONFIG = sim_station()
CONFIG = replace(CONFIG, supervisor=replace(CONFIG.supervisor, data_cycles=50.0, overruns=50))  # a busy machine

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def controller() -> Iterator[ControllerProcess]:
    with stand_in(ArmModel.UR10, HOST) as process:
        hand = RobotModel.of_station(CONFIG).description
        payload = hand.hand_payload(hand.hand_open)
        process.fault("payload", mass=payload.mass, cog=payload.center_of_mass.tolist())
        yield process


def test_the_arm_of_a_station_file_moves_slowly_and_by_hand_with_a_person_who_lets_it(
    controller: ControllerProcess,
) -> None:
    people = People()
    with open_arm(CONFIG, HOST, people) as arm:
        assert isinstance(arm, Arm)
        q = arm.state().q_commanded
        with raises(LimitError, code="limit.speed"):
            arm.execute(line([q, q + 0.1], 0.3))
        people.holds_switch = False
        with raises(PersonNearError, code="person_near.before_motion"):
            arm.execute(line([q, q + 0.02], 1.5))
        with raises(PersonNearError, code="person_near.freedrive"), arm.freedrive():
            pass
        people.holds_switch = True
        assert people.hold_switch("", 1.0)
        assert arm.execute(line([q, q + 0.02], 1.5)).outcome is MotionOutcome.COMPLETED
        with arm.freedrive():
            pass
    np.testing.assert_allclose(controller.state()["q"], HOME + 0.02, atol=1e-3)


def test_a_robot_with_another_payload_is_refused(controller: ControllerProcess) -> None:
    controller.fault("payload", mass=1.0, cog=[0.0, 0.0, 0.0])
    with raises(NotReadyError, code="not_ready.checks_failed") as refused, open_arm(CONFIG, HOST, People()):
        pass
    assert "payload" in str(refused.value)

"""The simulated arm's force reading: what a wrong payload leaves in it is gone once it was zeroed."""

from __future__ import annotations

import numpy as np
import pytest

from tests.contract.rigs import sim_rig
from tests.errors import raises
from toolee_robot.config import StationConfig
from toolee_robot.control import RobotModel
from toolee_robot.errors import NotReadyError
from toolee_robot.types import Payload

pytestmark = pytest.mark.sim


def test_a_zeroed_force_reading_has_no_offset_until_the_payload_changes() -> None:
    hand = RobotModel.of_station(StationConfig()).description
    right = hand.hand_payload(hand.hand_open)
    with sim_rig() as rig:

        def force() -> float:
            rig.sleep(0.1)
            return float(np.linalg.norm(rig.arm.state().wrench[:3]))

        rig.arm.set_payload(Payload(right.mass - 0.5, right.center_of_mass))
        assert force() > 3.0
        rig.arm.zero_wrench()
        assert force() < 0.5
        rig.arm.set_payload(right)
        assert force() == pytest.approx(0.5 * 9.81, abs=0.5)
        refused: list[str] = []

        def try_it() -> None:
            with raises(NotReadyError, code="not_ready.moving"):
                rig.arm.zero_wrench()
            refused.append("moving")

        rig.after(0.5, try_it)
        rig.execute(rig.nudge())
        assert refused == ["moving"]

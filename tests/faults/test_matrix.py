"""The matrix lists every fault of the safety page once; a failure while the machine stalled is measured again."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import get_args

import numpy as np
import pytest

from tests.faults import matrix
from tests.faults.rows.commands import into_itself, into_the_table
from tests.rigs.strikes import Swing, plan_swing
from toolee_robot.control.supervisor_checks import check_clear, check_limits
from toolee_robot.errors import CollisionError
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.types import ArmModel, Trajectory


def test_every_row_is_listed_once_and_its_number_is_on_the_safety_page() -> None:
    rows = list(matrix.matrix(list(matrix.PARTS), list(ArmModel), get_args(ProfileName)))
    names = [(row.number, row.fault, row.phase, row.on, row.expected) for row in rows]
    assert len(set(names)) == len(names)
    numbers = re.findall(r"^\| (\d+) \|", matrix.PAGE.read_text(), flags=re.MULTILINE)
    assert [int(number) for number in numbers] == sorted({row.number for row in rows})


def strike(model: ArmModel) -> tuple[Trajectory, float]:
    plan = plan_swing(model).plan
    return plan.strike, plan.contact_time - 0.03


@pytest.mark.parametrize("model", ArmModel)
@pytest.mark.parametrize("command", [into_the_table, into_itself])
def test_a_motion_into_something_breaks_no_other_rule(
    model: ArmModel, command: Callable[[Swing, Array], Trajectory]
) -> None:
    """Wherever in the swing it is sent from; else its row would measure another refusal."""
    swing = plan_swing(model)
    for k in np.linspace(0, len(swing.strike.q) - 1, 7).astype(int):
        motion = command(swing, swing.strike.q[k])
        check_limits(motion, swing.robot, swing.config, swing.world)
        with pytest.raises(CollisionError):
            check_clear(motion.q, swing.world, frozenset())

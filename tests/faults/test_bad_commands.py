from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.faults.rows import bad_commands as bad
from tests.rigs.strikes import Swing, plan_swing
from toolee_robot.control.supervisor_checks import check_clear, check_limits
from toolee_robot.errors import CollisionError
from toolee_robot.frames import Array
from toolee_robot.types import ArmModel, Trajectory


@pytest.mark.parametrize("model", ArmModel)
@pytest.mark.parametrize("command", [bad.into_the_table, bad.into_itself])
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

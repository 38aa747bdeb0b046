"""The postures in which the arm weighs a tool, at the handover of several stations."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from toolee_robot.control import CollisionWorld, RobotModel
from toolee_robot.control.planning.views import plan_handover
from toolee_robot.control.planning.wrist_turns import plan_wrist_turns
from toolee_robot.control.tool_weight import LEAST_TURN, WeighingPrior
from toolee_robot.frames import Array, frame_from_axes
from toolee_robot.station import StationConfig, load_station, sim_station
from toolee_robot.types import Trajectory

EXAMPLES = Path(__file__).parents[2] / "examples"
PRIOR = WeighingPrior(
    posture=(2.1, 0.42),
    hand_mass=0.1,
    hand_moment=np.full(3, 0.02),
    time=(0.15, 0.03),
    aged=(0.0, 0.0),
    pressed=(0.15, 0.03),
    grip=np.array([0.0, 0.0, 0.15]),
    handle=np.array([1.0, 0.0, 0.0]),
    handle_moment=0.04,
)
X_TOOL_EE = frame_from_axes(z=np.array([1.0, 0.0, 0.0]), x=np.array([0.0, 0.0, -1.0]), p=[0.05, 0.0, 0.22])


def _planned(config: StationConfig, tool_off: float) -> tuple[list[Trajectory], Array, CollisionWorld]:
    robot = RobotModel.of_station(config)
    hand, home = robot.description, np.asarray(config.scene.home)
    empty = CollisionWorld(robot, config, hand.hand_open)
    q = plan_handover(robot, config, empty, home, hand.hand_open).q[-1]
    X_hand_ee = hand.hand.grasp.X_hand_tool(0.016) @ X_TOOL_EE
    world = CollisionWorld(robot, config, hand.hand_closed, X_hand_ee, tool_off=tool_off)
    return plan_wrist_turns(robot, config, world, q, (0.6, 0.1), PRIOR, 5), q, world


@pytest.mark.parametrize("name", ["", "mount", "inspire", "ability", "shadow"])
def test_the_wrist_alone_turns_the_tool_far_enough_and_hits_nothing(name: str) -> None:
    config = load_station(EXAMPLES / f"{name}.yaml") if name else sim_station()
    turns, q, world = _planned(config, 0.08)
    assert len(turns) == 5
    np.testing.assert_allclose(turns[0].q[0], q)
    for before, after in pairwise(turns):
        np.testing.assert_allclose(after.q[0], before.q[-1])
    for turn in turns:
        np.testing.assert_allclose(turn.q[:, :3], np.tile(q[:3], (len(turn.q), 1)), atol=1e-9)
        assert world.free(turn.q, 0.0)
        assert world.inside(turn.q)
    Rs = world.robot.arm.fk(np.array([q, *(turn.q[-1] for turn in turns)]))[:, :3, :3]
    down = Rs[:, 2]  # in the flange
    assert np.arccos((down @ down.T).min()) > LEAST_TURN


def test_the_posture_of_the_empty_hand_comes_first() -> None:
    config = sim_station()
    turns, q, world = _planned(config, 0.08)
    goal = turns[3].q[-1]
    again = plan_wrist_turns(world.robot, config, world, q, (0.6, 0.1), PRIOR, 5, [goal])
    assert len(again) == 5
    np.testing.assert_allclose(again[0].q[-1], goal)
    assert all(np.max(np.abs(turn.q[-1] - goal)) > 0.1 for turn in again[1:])
    hits = np.array([goal[0], 0.3, *goal[2:]])  # into the table
    assert not world.free(hits, 0.0)
    assert len(plan_wrist_turns(world.robot, config, world, q, (0.6, 0.1), PRIOR, 5, [hits])) == 5, "without it"


def test_where_nothing_is_free_there_is_no_turn() -> None:
    assert _planned(sim_station(), 0.6)[0] == []

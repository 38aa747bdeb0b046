"""Plans of motions to the places of a station: home, handover, the views of the camera, over the nail."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from toolee_robot.control import (
    CollisionWorld,
    plan_handover,
    plan_strike,
    plan_transfer,
    plan_views,
    slowed_to,
)
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.tasks.bring_up.caps import SlowStation
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tools import NAIL_DRIVERS, make_tool
from toolee_robot.types import Trajectory


class Place(StrEnum):
    """Places of a station that a job visits.

    HOME: `scene.home`. HANDOVER: where a tool is handed over. VIEW: where the camera would look at a tool in the hand.
    NAIL: where a strike would begin, over the nail.
    """

    HOME = "home"
    HANDOVER = "handover"
    VIEW = "view"
    NAIL = "nail"


def plan_to_place(slow: SlowStation, q: Array, place: Place, view: int = 1) -> Trajectory:
    """Plan a collision-free motion of the arm with an empty, open hand.

    The postures of views and strike are those of a nominal hammer, which must also be clear of everything.

    Args:
        slow: The station under its caps.
        q: Present joint positions, (6,) [rad].
        place: Where to go.
        view: Number of the view, from 1.

    Returns:
        The trajectory, from rest to rest, slow enough for a person in reach.

    Raises:
        UserError: There is no such view.
        PlanningError: The place is out of reach, or no way there is clear.
    """
    robot, config, world = slow.robot, slow.config, slow.world
    q_hand = robot.description.hand_open
    if place is Place.HANDOVER:
        move = plan_handover(robot, config, world, q, q_hand)
    else:
        goal = np.asarray(config.scene.home) if place is Place.HOME else _posture(slow, place, view)
        move = plan_transfer(robot, config, world, q, goal)
    return slowed_to(move, world, config.supervisor.handover_speed)


def _posture(slow: SlowStation, place: Place, view: int) -> Array:
    # Of a job, so with the station's own limits: under the caps no strike would be worth a plan.
    robot, config = slow.robot, slow.station
    if place is Place.VIEW and not 1 <= view <= config.task.views:
        raise UserError(f"view {view}: the station has 1 to {config.task.views} (task.views)", code="user.view")
    q_hand, home = robot.description.hand_closed, np.asarray(config.scene.home)
    grasp = nominal_grasp(make_tool(NAIL_DRIVERS[0], 0), config)
    X_hand_ee = grasp.X_hand_ee
    with_tool = CollisionWorld(robot, config, q_hand, X_hand_ee)
    if place is Place.NAIL:
        X_base_nail = config.work.X_base_nail()
        state = home, q_hand, X_hand_ee, X_base_nail
        return plan_strike(robot, config, with_tool, *state, tool=grasp.swung).q_standoff
    count = config.task.views
    return plan_views(robot, config, with_tool, home, q_hand, X_hand_ee, count=count).views[view - 1].q

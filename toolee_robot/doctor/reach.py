"""Check that the planner solves handover, views and strikes in this station, with every kind of hammer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from toolee_robot.control import CollisionWorld, RobotModel, plan_handover, plan_strike, plan_views
from toolee_robot.end_effectors import Category
from toolee_robot.errors import PlanningError
from toolee_robot.findings import Finding, ok, warn
from toolee_robot.frames import Array, inverse
from toolee_robot.station import StationConfig
from toolee_robot.tools import NAIL_DRIVERS, SWUNG_MASS, Tool, ToolKind, make_tool
from toolee_robot.types import Payload

SLOWER = 0.9
"""Share of the wanted speed below which a strike is reported as slow."""


def check_reach(config: StationConfig) -> Iterator[Finding]:
    """Plan handover, views and strikes from the home posture with nominal grasps; nothing is moved."""
    robot = RobotModel.of_station(config)
    home, model = np.array(config.scene.home), robot.description
    yield _handover(robot, config, home, model.hand_open)
    tools = [make_tool(kind, _seed(kind)) for kind in NAIL_DRIVERS]
    grips = [model.hand.grasp.X_hand_tool(t.handle.grip_radius) @ _face(t) for t in tools]
    swung = [Payload(t.mass, t.center_of_mass).seen_from(inverse(_face(t))) for t in tools]
    yield _views(robot, config, home, model.hand_closed, grips[0])
    for name, work in config.work.each():
        what = "strike" if len(work.names) == 1 else f"strike at {name}"
        one = replace(config, work=work)
        yield _strikes(what, robot, one, home, model.hand_closed, list(zip(grips, swung, strict=True)))


def _seed(kind: ToolKind) -> int:
    """Seed of the first hammer of a kind whose mass suits one hand."""
    return next(seed for seed in range(100) if SWUNG_MASS[0] <= make_tool(kind, seed).mass <= SWUNG_MASS[1])


def _face(tool: Tool) -> Array:
    return tool.ee(Category.HAMMER_HEAD).X_tool_ee


def _handover(robot: RobotModel, config: StationConfig, home: Array, q_hand: Array) -> Finding:
    try:
        plan_handover(robot, config, CollisionWorld(robot, config, q_hand), home, q_hand)
    except PlanningError as error:
        return Finding.of_error("handover", error, "move scene.handover_position")
    return ok("handover", "the hand reaches the place of the handover")


def _views(robot: RobotModel, config: StationConfig, home: Array, q_hand: Array, X_hand_ee: Array) -> Finding:
    world = CollisionWorld(robot, config, q_hand, X_hand_ee)
    try:
        plan_views(robot, config, world, home, q_hand, X_hand_ee, count=config.task.views)
    except PlanningError as error:
        return Finding.of_error("views", error, "move the camera, or lower task.views")
    return ok("views", f"the camera sees the tool from {config.task.views} sides")


def _strikes(
    name: str, robot: RobotModel, config: StationConfig, home: Array, q_hand: Array, grips: list[tuple[Array, Payload]]
) -> Finding:
    X_base_nail, wanted = config.work.X_base_nail(), config.strike.speed
    speeds: list[float] = []
    failures: list[Finding] = []
    for X_hand_ee, tool in grips:
        world = CollisionWorld(robot, config, q_hand, X_hand_ee)
        try:
            plan = plan_strike(robot, config, world, home, q_hand, X_hand_ee, X_base_nail, tool=tool)
        except PlanningError as error:
            failures.append(
                Finding.of_error(name, error, "move the nail (work.nail_xy or work.nails), or raise the stand")
            )
        else:
            speeds.append(plan.speed)
    if not speeds:
        return failures[0]
    message = f"{len(speeds)} of {len(grips)} kinds of hammers strike the nail, at {min(speeds):.2f} m/s or more"
    if failures:
        return warn(name, f"{message}; with another, {failures[0].message}", failures[0].remedy)
    if min(speeds) < SLOWER * wanted:
        return warn(name, f"{message}; {wanted} m/s were wanted", "move the nail, or lower strike.speed")
    return ok(name, message)

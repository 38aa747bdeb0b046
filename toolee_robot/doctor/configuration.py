"""Checks of the station file: values, calibration, and whether the planner solves handover, views and strikes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from datetime import date
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control import CollisionWorld, RobotModel, plan_handover, plan_strike, plan_views
from toolee_robot.end_effectors import Category
from toolee_robot.errors import PlanningError
from toolee_robot.findings import Finding, fail, ok, warn
from toolee_robot.frames import Array, angle_between, inverse
from toolee_robot.station import MEASURED, SIMULATED, StationConfig, unmeasured
from toolee_robot.tools import NAIL_DRIVERS, SWUNG_MASS, Tool, ToolKind, make_tool
from toolee_robot.types import Payload

REDUCED_SPEED = 0.25
"""Reduced speed of ISO 10218-1, the largest with a person in reach [m/s]."""
BEHIND = float(np.deg2rad(110.0))
"""Angle about the base's z from the flange at home from which a place lies behind the arm [rad]. Assumed: a handover
from the side is within a right angle or so."""
OVER_BASE = 0.3
"""Distance from the base's axis under which a place is on no side of it [m], as of a camera that hangs over the arm."""
USUAL_SPEED = 1.5
"""Speed above which a UR's own safety settings usually stop the arm [m/s]."""


def check_limits(config: StationConfig) -> Iterator[Finding]:
    """Check the planner's limits against the arm's, the positions against the workspace, and the load."""
    robot = RobotModel.of_station(config)
    model, arm, supervisor = robot.description, config.arm, config.supervisor
    wrong = []
    for joint, mine, most in zip(model.arm_joints, arm.velocity, model.velocity, strict=False):
        if mine > most * 1.001:
            wrong.append(f"arm.velocity of {joint} is {mine:.2f} rad/s, and the {arm.model} reaches {most:.2f}")
    for joint, q, low, high in zip(model.arm_joints, config.scene.home, model.lower, model.upper, strict=False):
        if not low <= q <= high:
            wrong.append(f"scene.home puts {joint} at {q:.2f} rad, outside {low:.2f} to {high:.2f}")
    load = model.hand_payload(model.hand_closed).mass + SWUNG_MASS[1]
    payload = ARM_DATA[arm.model].payload
    if load > payload:
        wrong.append(f"hand and hammer weigh {load:.1f} kg, and the {arm.model} carries {payload:.1f}")
    inside = np.all(np.less(config.scene.workspace_lower, config.scene.handover_position)) and np.all(
        np.less(config.scene.handover_position, config.scene.workspace_upper)
    )
    if not inside:
        wrong.append("scene.handover_position is outside the workspace")
    yield from (fail("limits", message, "change it in the station file") for message in wrong)
    if not wrong:
        yield ok("limits", f"within the {arm.model}'s; {load:.1f} kg of {payload:.1f} kg payload")
    if supervisor.handover_speed > REDUCED_SPEED:
        message = f"handovers at up to {supervisor.handover_speed} m/s"
        remedy = f"ISO 10218-1 allows {REDUCED_SPEED} m/s near a person: lower supervisor.handover_speed"
        yield warn("handover speed", message, remedy)
    if supervisor.unattended_speed > USUAL_SPEED:
        message = f"up to {supervisor.unattended_speed} m/s"
        yield warn("swing speed", message, "compare it with the robot's own TCP speed limit")


def check_sides(config: StationConfig) -> Finding:
    """Look for places that are typed in the other frame of the base: the joint positions of home have no frame.

    Args:
        config: Configuration of the station.

    Returns:
        OK, or WARN with the places that lie half a turn from where the arm at home is. A place over the base is not
        looked at.
    """
    scene, work = config.scene, config.work
    flange = RobotModel.of_station(config).arm.fk(np.array(scene.home))[:2, 3]
    if np.linalg.norm(flange) < OVER_BASE:
        return ok("sides", "not checked: the arm at home is over its base")
    places = {f"work.nails {nail.name}": nail.xy for nail in work.nails} or {"work.nail_xy": work.nail_xy}
    places |= {"scene.handover_position": scene.handover_position[:2], "camera": config.camera.center[:2]}
    over = [name for name, place in places.items() if np.linalg.norm(place) < OVER_BASE]
    judged = {name: place for name, place in places.items() if name not in over}
    behind = [name for name, place in judged.items() if angle_between(_flat(flange), _flat(place)) > BEHIND]
    if not behind:
        skipped = f"; not checked, over the base: {', '.join(over)}" if over else ""
        return ok("sides", f"nail, handover and camera are on the side of the arm at home{skipped}")
    cause = f"{'it is' if len(behind) == 1 else 'they are'} typed in the other base's frame"
    if len(behind) == len(judged):
        cause = "`frame` names the other base"
    return warn(
        "sides",
        f"{', '.join(behind)}: behind the arm at home, by about half a turn about the base's z",
        f"compare it with `toolee station show`. If your cell differs, {cause} (x and y have the other sign)",
    )


def _flat(place: ArrayLike) -> Array:
    """A place on the table, (2,), as a vector from the base's axis, (3,)."""
    return np.append(place, 0.0)


def check_contacts(config: StationConfig) -> Iterator[Finding]:
    """Check whether door and hold-to-run switch have two complementary contacts each.

    Args:
        config: Configuration of the station.

    Yields:
        OK where both have two, WARN for each that has one; nothing for a station without these inputs.
    """
    person = config.person
    if person is None:
        return
    devices = (
        ("door contacts", "door", "closed", "door_open_input", person.door_open_input),
        ("switch contacts", "switch", "held", "hold_to_run_released_input", person.hold_to_run_released_input),
    )
    single = [device for device in devices if device[-1] is None]
    for name, device, reading, field, _ in single:
        message = (
            f"the {device} has one contact. If it is stuck high or bridged, it reads as {reading}, and only a missing "
            "change shows that"
        )
        remedy = f"wire its second, complementary contact and give person.{field}; until then, before a session: "
        yield warn(name, message, f"{remedy}`toolee doctor --inputs`")
    if not single:
        yield ok("contacts", "door and hold-to-run switch have two complementary contacts each")


def check_measured(path: Path | None, stand_in: bool) -> Finding:
    """Check whether a robot's station file gives everything that a lab must measure.

    Args:
        path: The station file; None for none.
        stand_in: Whether the robot is a stand-in, which may do without.

    Returns:
        OK, or FAIL with the fields that are left out; WARN for a stand-in.

    Raises:
        ConfigError: The file cannot be read.
    """
    missing = list(MEASURED) if path is None else unmeasured(path)
    if not missing:
        return ok("measured", "the file gives everything about the lab")
    message = f"the simulated station's values stand in for {', '.join(missing)}"
    remedy = "measure and enter them" + (": `toolee arm` moves no real robot without them" if stand_in else "")
    return (warn if stand_in else fail)("measured", message, remedy)


def check_calibration(
    config: StationConfig, robot_serial: str | None, camera_serial: str | None, today: date, slow: bool = False
) -> Finding:
    """Check whether the calibration is valid for the connected devices.

    Args:
        config: Configuration of the station.
        robot_serial: Serial number that the robot reports; None if unknown.
        camera_serial: Serial number that the camera reports; None if unknown.
        today: The present date.
        slow: Whether the arm may be moved slowly without a calibration, as a robot may that is brought up.

    Returns:
        OK, or FAIL with the first problem and the number of the others; WARN for what blocks no slow motion.
    """
    calibration = config.calibration
    if calibration is None and slow:
        message = "none: no job and no look with the camera, only the slow motions of `toolee arm`"
        return warn("calibration", message, "`toolee calibrate camera` when the arm moves as it should")
    if calibration is None:
        return fail("calibration", "none", "calibrate the camera to the robot, enter the result in the station file")
    problems = calibration.problems(
        calibration.robot_serial if robot_serial is None else robot_serial,
        calibration.camera_serial if camera_serial is None else camera_serial,
        today,
    )
    if problems:
        message, _, remedy = problems[0].rpartition(": ")
        others = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        return fail("calibration", f"{message}{others}", remedy)
    unknown = [what for what, serial in (("robot", robot_serial), ("camera", camera_serial)) if serial is None]
    whose = "of the simulated camera, " if camera_serial == SIMULATED else ""
    message = f"{whose}of {calibration.measured_on}, residual {calibration.residual * 1e3:.1f} mm"
    if unknown:
        message += f"; not compared with the {' and the '.join(unknown)}"
        return warn("calibration", message, "make sure that it is of these devices")
    return ok("calibration", message)


MOVES = (-0.3, -0.15, 0.0, 0.15, 0.3)
"""Ways along x and y of `base` by which the block is tried elsewhere [m]."""
SLOW = 0.5
"""Speed below which a strike is reported as slow [m/s]: such a strike has less than half of the default's energy."""


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
    speeds, errors = _speeds(robot, config, home, q_hand, grips)
    enough = min(SLOW, 0.9 * config.strike.speed)
    if not errors and min(speeds) >= enough:
        return ok(
            name, f"{len(grips)} of {len(grips)} kinds of hammers strike the nail, at {min(speeds):.2f} m/s or more"
        )
    remedy = _better_place(robot, config, home, q_hand, grips, enough)
    if not speeds:
        return Finding.of_error(name, errors[0], remedy)
    message = f"{len(speeds)} of {len(grips)} kinds of hammers strike the nail, at {min(speeds):.2f} m/s or more"
    if errors:
        return warn(name, f"{message}; with another, {errors[0]}", remedy)
    return warn(name, f"{message}: a nail will take many strikes", f"{remedy}; or raise arm.acceleration")


def _speeds(
    robot: RobotModel, config: StationConfig, home: Array, q_hand: Array, grips: list[tuple[Array, Payload]]
) -> tuple[list[float], list[PlanningError]]:
    """Speeds at the contact [m/s] of the hammers that can strike the nail, and why the others cannot."""
    speeds: list[float] = []
    errors: list[PlanningError] = []
    for X_hand_ee, tool in grips:
        world = CollisionWorld(robot, config, q_hand, X_hand_ee)
        try:
            nail = config.work.X_base_nail()
            speeds.append(plan_strike(robot, config, world, home, q_hand, X_hand_ee, nail, tool=tool).speed)
        except PlanningError as error:
            errors.append(error)
    return speeds, errors


def _better_place(
    robot: RobotModel,
    config: StationConfig,
    home: Array,
    q_hand: Array,
    grips: list[tuple[Array, Payload]],
    least: float,
) -> str:
    """Where the block may stand instead: the nearest place at which every hammer is fast enough."""
    for dx, dy in sorted(product(MOVES, MOVES), key=lambda way: math.hypot(*way))[1:]:
        moved = replace(config, work=config.work.moved(dx, dy, 0.0))
        for grip in grips:
            speeds, errors = _speeds(robot, moved, home, q_hand, [grip])
            if errors or min(speeds) < least:
                break
        else:
            x, y = moved.work.nail_xy
            return f"move the block: with the nail at ({x:.2f}, {y:.2f}) in base every kind of hammer is fast enough"
    return f"move the nail by more than {max(MOVES):.1f} m (work.nail_xy or work.nails), or raise the stand"

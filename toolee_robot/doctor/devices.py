"""Checks of arm, hand, camera and person through the hardware abstraction; nothing is moved."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from toolee_robot.control import CollisionWorld, RobotModel
from toolee_robot.errors import TooleeError
from toolee_robot.findings import Finding, fail, ok, warn
from toolee_robot.hal import Arm, ArmStatus, Clock, Hand, Person, RgbdCamera
from toolee_robot.station import StationConfig

DEPTH_KNOWN = 0.3
"""Least share of an image with known depth."""
EARLY = 0.05
"""Tolerated deviation of a frame's stamp, since clocks differ [s]."""
SLOW = 0.5
"""Duration of reading a frame above which the camera counts as slow [s]."""


def check_arm(arm: Arm, hand: Hand, config: StationConfig) -> Finding:
    """Check the arm's status, and whether a motion can be planned from its present position.

    Args:
        arm: The arm.
        hand: The hand on it.
        config: Configuration of the station.

    Returns:
        OK, or FAIL with the first problem.
    """
    try:
        state = arm.state(config.supervisor.max_data_age)
        q_hand = hand.state().joints.q
    except TooleeError as error:
        return Finding.of_error("arm", error, "check its connection")
    if state.status is not ArmStatus.READY:
        return fail("arm", state.status.replace("_", " "), "make it ready at the teach pendant")
    q = state.joints.q
    robot = RobotModel.of_station(config)
    lower, upper = robot.description.lower[:6], robot.description.upper[:6]
    if not (q.shape == (6,) and np.all(np.isfinite(q)) and np.all((lower <= q) & (q <= upper))):
        return fail("arm", f"joints {np.round(q, 2)} rad are outside the limits", "jog it back inside")
    flange = robot.arm.fk(q)[:3, 3]
    scene = config.scene
    if not (np.all(flange >= scene.workspace_lower) and np.all(flange <= scene.workspace_upper)):
        message = f"the flange, at {np.round(flange, 2)} m, is outside the workspace"
        return fail("arm", message, "jog it inside, or change scene.workspace_lower and _upper")
    closest = CollisionWorld(robot, config, q_hand).closest(q)
    if closest.distance < config.strike.clearance:
        return fail("arm", f"stands too near: {closest}", "jog it away, or correct the station file")
    return ok("arm", f"ready, {arm.rate:.0f} Hz, clear of everything by {closest.distance * 1e3:.0f} mm")


def check_hand(hand: Hand, config: StationConfig) -> Finding:
    """Check the hand's joints, faults and temperature.

    Args:
        hand: The hand.
        config: Configuration of the station.

    Returns:
        OK, FAIL with the first problem, or WARN if the hand holds something.
    """
    robot = RobotModel.of_station(config)
    try:
        state = hand.state()
    except TooleeError as error:
        return Finding.of_error("hand", error, "check its cable and its power")
    if hand.joint_names != robot.description.hand_joints:
        return fail("hand", "its joints are not the model's", "use a driver for this hand")
    if state.fault:
        return fail("hand", state.fault, "clear the fault in its own software, then look again")
    hottest = state.temperature
    if hottest is not None and hottest > config.supervisor.max_hand_temperature:
        most = config.supervisor.max_hand_temperature
        return fail("hand", f"{hottest:.0f} °C, {most:.0f} °C are allowed", "let it cool down")
    if robot.description.hand.clamps and not state.holding:
        return ok("hand", "a tool mount, which has no sensors: look that it is empty")
    if state.holding:
        return warn("hand", "it holds something", "take it out: a job begins with an empty hand")
    warmth = "" if hottest is None else f", {hottest:.0f} °C"
    return ok("hand", f"answers, empty, {len(state.joints.q)} joints{warmth}")


def check_camera(camera: RgbdCamera, clock: Clock, config: StationConfig) -> Iterator[Finding]:
    """Check that the camera delivers new frames with depth, and that its intrinsics are the configured ones.

    Args:
        camera: The camera.
        clock: The station's clock.
        config: Configuration of the station.

    Yields:
        Findings about the frames, the intrinsics and the depth.
    """
    name = "camera"
    try:
        first = camera.read()
        asked = clock.now()
        second = camera.read()
        now = clock.now()
    except TooleeError as error:
        yield Finding.of_error(name, error, "check its cable; plug it into a port of its own")
        return
    if not second.stamp > first.stamp:
        yield fail(name, "it repeats the same frame", "restart the camera's driver")
    elif not asked - EARLY <= second.stamp <= now + EARLY:
        message = f"a frame asked for now says that it is {now - second.stamp:.2f} s old"
        yield fail(name, message, "its clock is not the station's, or its frames queue: correct its driver")
    elif now - asked > SLOW:
        message = f"a frame takes {now - asked:.2f} s"
        yield warn(name, message, "jobs take longer: look for load on this machine and on its port")
    else:
        yield ok(name, f"new frames, {(now - second.stamp) * 1e3:.0f} ms old when they are here")
    if not second.intrinsics.agrees(config.camera.intrinsics):
        yield fail(
            "intrinsics",
            "the camera's are not the station file's",
            "enter what `toolee camera show` prints under camera",
        )
    known = float(np.mean(np.isfinite(second.depth) & (second.depth > 0)))
    if known < DEPTH_KNOWN:
        yield fail("depth", f"known for {known:.0%} of the image", "look for sun, glass, or a covered lens")
    else:
        yield ok("depth", f"known for {known:.0%} of the image")


def check_person(person: Person) -> Finding:
    """Report whether a person is in the zone, which is no fault before a handover but prevents fast motion."""
    if person.zone_occupied():
        return ok("person", "somebody is inside, or the station cannot tell: nothing fast will move")
    return ok("person", "nobody is inside")

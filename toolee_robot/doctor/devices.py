"""Checks of hand and camera; nothing is moved."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from toolee_robot.control import RobotModel
from toolee_robot.control.planning.views import DISTANCE
from toolee_robot.devices.cameras import StreamedCamera
from toolee_robot.devices.cameras.lens_choice import UNKNOWN_LENS
from toolee_robot.errors import TooleeError
from toolee_robot.findings import Finding, fail, ok, warn
from toolee_robot.hal import Clock, Hand, RgbdCamera
from toolee_robot.station import StationConfig
from toolee_robot.types import RgbdFrame

DEPTH_KNOWN = 0.3
"""Least share of an image with known depth."""
EARLY = 0.05
"""Tolerated deviation of a frame's stamp, since clocks differ [s]."""
SLOW = 0.5
"""Duration of reading a frame above which the camera counts as slow [s]."""


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
        return fail("hand", state.fault, "clear the fault in its own software, then check again")
    hottest = state.temperature
    if hottest is not None and hottest > config.supervisor.max_hand_temperature:
        most = config.supervisor.max_hand_temperature
        return fail("hand", f"{hottest:.0f} °C, above the allowed {most:.0f} °C", "let it cool down")
    if robot.description.hand.clamps and not state.holding:
        return ok("hand", "a tool mount, which has no sensors: check that it is empty")
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
        yield Finding.of_error(name, error, "check its cable, and give it its own USB port")
        return
    if not second.stamp > first.stamp:
        yield fail(name, "it repeats the same frame", "restart the camera's driver")
    elif not asked - EARLY <= second.stamp <= now + EARLY:
        message = f"a new frame's time stamp is {now - second.stamp:.2f} s old"
        yield fail(name, message, "its clock is not the station's, or its frames queue: correct its driver")
    elif now - asked > SLOW:
        message = f"a frame takes {now - asked:.2f} s"
        yield warn(name, message, "jobs take longer: check the load on this computer and on its port")
    else:
        yield ok(name, f"new frames, {(now - second.stamp) * 1e3:.0f} ms old on arrival")
    if not second.intrinsics.agrees(config.camera.intrinsics):
        yield fail(
            "intrinsics",
            "the camera's are not the station file's",
            "enter what `toolee camera show` prints under camera",
        )
    known = float(np.mean(np.isfinite(second.depth) & (second.depth > 0)))
    if known < DEPTH_KNOWN:
        yield fail("depth", f"known for {known:.0%} of the image", "check for sun, glass, or a covered lens")
    else:
        yield ok("depth", f"known for {known:.0%} of the image")


BRIGHT, DARK = 250, 5
"""Values of the brightest and of the darkest channel of a pixel that is over- or underexposed [of 255]."""
OVEREXPOSED, UNDEREXPOSED = 0.05, 0.30
"""Shares of such pixels above which the exposure is warned of. Assumed: a lamp in the picture is under the first, dark
surroundings under the second."""
HEAD = 0.10
"""Length of a tool's head that may be nearer to the camera than its face [m]; the views are of the face."""


def check_exposure(frame: RgbdFrame, automatic: bool | None) -> Iterator[Finding]:
    """Check the exposure of a camera's colour images.

    Args:
        frame: A frame.
        automatic: Whether the camera chooses the exposure; None if unknown.

    Yields:
        The findings.
    """
    brightest = frame.rgb.max(axis=2)
    over, under = float(np.mean(brightest >= BRIGHT)), float(np.mean(brightest <= DARK))
    message = f"{over:.1%} overexposed, {under:.1%} underexposed"
    if over > OVEREXPOSED:
        yield warn("exposure", message, "lower camera.device.exposure, or turn the lamp away")
    elif under > UNDEREXPOSED:
        yield warn("exposure", message, "raise camera.device.exposure, or add light")
    else:
        yield ok("exposure", message)
    if automatic:
        yield warn("auto-exposure", "the camera chooses the exposure of each view", "give camera.device.exposure")


def check_lens(camera: StreamedCamera) -> Finding:
    """Check whether the lens is known, and tell which one holds.

    Args:
        camera: The camera, open.

    Returns:
        OK with the lens and how far it displaces pixels; WARN where nobody knows it.
    """
    chosen = camera.lens
    if camera.profile.undistorted is None and not chosen.lens.known:
        return warn(
            "lens",
            chosen.words,
            "the recording does not say whether its images are undistorted: record again, or add `undistorted: true` "
            "or `false` to its recording.json",
        )
    if not chosen.lens.known:
        return warn("lens", chosen.words, UNKNOWN_LENS)
    return ok("lens", chosen.words)


def check_range(config: StationConfig) -> Finding:
    """Check the camera's least range against the views of the job, which the planner puts before it.

    Args:
        config: Configuration of the station.

    Returns:
        The finding.
    """
    device, (near, far) = config.camera.device, DISTANCE
    if device is None:
        return warn("range", "the station file names no camera", "give camera.device.least_range, of its data sheet")
    least, nearest = device.least_range, near - HEAD
    message = f"measures from {least:.2f} m; views are {near:.2f} to {far:.2f} m away, the tool down to {nearest:.2f} m"
    if least > near:
        lost = "no view" if least > far else f"no view nearer than {least:.2f} m"
        remedy = f"take a smaller depth image or another camera: {lost} would have a depth of the tool's face"
        return fail("range", message, remedy)
    if least > nearest:
        return warn("range", message, "parts of a tool will lack depth: take a smaller depth image, if it has one")
    return ok("range", message)

"""Checks of the supervisor on a trajectory and on the arm's state before a motion. None changes any state."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Self

import numpy as np

from toolee_robot.control.arm_dynamics import ArmDynamics
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.limits import Mode, carried_speed, check_trajectory
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import CollisionError, LimitError, NotReadyError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmState, ArmStatus, Person
from toolee_robot.station import StationConfig
from toolee_robot.types import Trajectory

STEP = 0.015
"""Largest joint step between two configurations checked for collisions [rad]: 2 cm at full reach."""
CLEARANCE = 0.002
"""Least clearance at these configurations [m]; a motion that starts with less may not reduce it further."""
OFF_COMMAND = 0.03
"""Largest deviation from the commanded position at rest [rad]; an arm beyond it was moved, or yields to a load."""
AT_REST = 0.05
"""Joint speed below which the arm counts as standing still [rad/s]."""


def is_finite(trajectory: Trajectory) -> bool:
    """Whether a trajectory contains neither NaN nor infinity."""
    return all(np.all(np.isfinite(x)) for x in (trajectory.times, trajectory.q, trajectory.qd, trajectory.qdd))


def check_limits(trajectory: Trajectory, robot: RobotModel, config: StationConfig, world: CollisionWorld) -> None:
    """Check a trajectory against the limits of configuration, model and workspace.

    Args:
        trajectory: The trajectory.
        robot: Model of the arm, with its own velocity limits.
        config: The configured limits and workspace.
        world: Bodies of hand and tool.

    Raises:
        LimitError: A limit is violated, or a value is not finite.
    """
    velocity = np.minimum(config.arm.velocity, robot.description.velocity[:6])
    limits = replace(config.arm, velocity=tuple(velocity.tolist()))
    check_trajectory(trajectory, robot.arm, limits, config.scene, world)


def check_speed(trajectory: Trajectory, world: CollisionWorld, speed: float, mode: Mode) -> None:
    """Check the speed of hand and tool.

    Args:
        trajectory: The trajectory.
        world: Bodies of hand and tool.
        speed: Largest permitted speed [m/s].
        mode: Mode of operation, for the message.

    Raises:
        LimitError: A point of hand or tool exceeds the speed; code `limit.speed`.
    """
    fastest = carried_speed(trajectory, world)
    if np.max(fastest) > speed:
        raise LimitError(
            f"hand or tool would move at {np.max(fastest):.2f} m/s at {trajectory.times[np.argmax(fastest)]:.2f} s, "
            f"{speed:.2f} m/s are allowed in {mode} mode: nothing is sent; plan a slower motion",
            code="limit.speed",
        )


def check_momentum(trajectory: Trajectory, dynamics: ArmDynamics, most: float) -> None:
    """Check the momentum of arm, hand and tool, above which the robot would stop itself.

    Args:
        trajectory: The trajectory.
        dynamics: Dynamics of arm, hand and tool.
        most: Largest permitted momentum [kg m/s].

    Raises:
        LimitError: It is exceeded; code `limit.momentum`.
    """
    largest = float(np.max(dynamics.momentum(trajectory.q, trajectory.qd)))
    if largest > most:
        raise LimitError(
            f"arm, hand and tool would have a momentum of {largest:.1f} kg m/s, supervisor.momentum allows {most:g}: "
            "nothing is sent; plan a slower motion",
            code="limit.momentum",
        )


def check_ready(state: ArmState) -> None:
    """Check that the robot's safety system permits motion and that the arm stands still.

    Raises:
        NotReadyError: Codes `not_ready.status` and `not_ready.moving`.
    """
    if state.status is not ArmStatus.READY:
        raise NotReadyError(
            f"the robot is in {state.status.replace('_', ' ')}: a person must make it ready there",
            code="not_ready.status",
        )
    fastest = float(np.max(np.abs(state.joints.qd)))
    if not fastest < AT_REST:  # NaN included
        raise NotReadyError(f"the arm still moves ({fastest:.2f} rad/s): wait until it stands", code="not_ready.moving")


def check_place(state: ArmState) -> None:
    """Check that the arm is where it was commanded.

    Raises:
        LimitError: It is not; code `limit.off_command`.
    """
    off = float(np.max(np.abs(state.joints.q - state.q_commanded)))
    if not off <= OFF_COMMAND:  # NaN included
        raise LimitError(
            f"the arm stands {off:.3f} rad from its commanded position (allowed {OFF_COMMAND}). Somebody has moved "
            "it, or it leans on something. Free it, reset it, then plan from its present state",
            code="limit.off_command",
        )


def check_clear(q: Array, world: CollisionWorld, exempt: frozenset[tuple[str, str]]) -> None:
    """Check a path for collisions.

    Args:
        q: Joint positions along the path, (N, 6) [rad].
        world: The collision model.
        exempt: Pairs of body groups that may touch.

    Raises:
        CollisionError: Two bodies touch; the message names the closest pair.
    """
    along = np.concatenate([[0.0], np.cumsum(np.max(np.abs(np.diff(q, axis=0)), axis=1))])
    count = max(2, int(np.ceil(along[-1] / STEP)) + 1)
    rows = np.unique(np.searchsorted(along, np.linspace(0.0, along[-1], count)).clip(0, len(q) - 1))
    start = world.closest(q[0], CLEARANCE, exempt).distance
    need = min(CLEARANCE, start - 1e-6)
    if need > 0.0 and world.free(q[rows], need, exempt):
        return
    closest = world.closest(q[rows], CLEARANCE, exempt)
    raise CollisionError(
        f"the motion would bring {closest} together: nothing was moved; clear the way or move the target",
        code="collision.motion",
    )


UNSURE = "as the readings of their inputs are late or have not settled"
"""Why a person forbids motion where nothing was seen of them, but their inputs are not known."""


def why_person_forbids(person: Person, mode: Mode) -> str:
    """Why a person forbids motion in a mode.

    Args:
        person: The person at the station.
        mode: The mode of operation.

    Returns:
        The reason, which tells what is seen from what is assumed for want of a reading; empty if nothing forbids it.
    """
    certain = person.readings_certain()  # asked first: a late reading that comes meanwhile tells nothing of the others
    if mode is Mode.UNATTENDED:
        if not person.zone_occupied():
            return ""
        who = "somebody is" if certain else "somebody may be"
        reason = f"{who} within the arm's reach"
    else:
        if person.hold_to_run_held():
            return ""
        who = "the person at the station does not hold" if certain else "nobody is known to hold"
        reason = f"{who} the hold-to-run switch"
    return reason if certain else f"{reason}, {UNSURE}"


PERIOD = 0.01
"""Polling period [s], well under the arm's braking time."""


class Watcher:
    """Context in which a thread polls a stop condition and stops the arm when it holds.

    The stop is repeated until the context ends, since a stop before the arm has begun to move has no effect.

    Args:
        reason_to_stop: Returns the reason for a stop, empty while the motion may continue; an exception counts as a
            reason.
        stop: Stops the arm; called from the watcher's thread.
        unsure: Prefix of the reason when `reason_to_stop` raises.
        period: Polling period [s].

    Attributes:
        reason: The first reason for a stop; empty if none.
    """

    def __init__(
        self, reason_to_stop: Callable[[], str], stop: Callable[[], None], unsure: str, period: float = PERIOD
    ) -> None:
        self.reason = ""
        self._reason_to_stop, self._stop, self._unsure, self._period = reason_to_stop, stop, unsure, period
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watcher", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._over.wait(self._period):
            self.reason = self.reason or self._ask()
            if self.reason:
                self._stop()

    def _ask(self) -> str:
        try:
            return self._reason_to_stop()
        except Exception as error:  # noqa: BLE001 - after any error, safety is unknown
            return f"{self._unsure}: {error}"

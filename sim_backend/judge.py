"""The judge: ground truth about a run, for the command line's report and the tests, never for the task.

It observes every step of the simulated world and determines the error of an in-hand estimate of the end effector (EE)
at its time, where and how fast the face met the nail at each strike, and the nail's outcome. Only the face counts: a
handle, a cheek or the hand may drive a nail, too, but that is no hit.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from toolee_robot.errors import TooleeError
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.hal import Clock
from toolee_robot.sim_backend.physics.bodies import pb
from toolee_robot.sim_backend.physics.nail import SLIDE, Nail, NailOutcome
from toolee_robot.sim_backend.physics.wood import driving_work
from toolee_robot.sim_backend.truth import (
    NOT_BY_FACE,
    OFF_FACE,
    NailTruth,
    PoseError,
    StrikeTruth,
    StruckBy,
    Verdict,
    driven_off_face,
    pose_error,
    strike_offset,
    strike_tilt,
)
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.types import InHandEstimate

HISTORY_PERIOD = 1 / 240  # [s] between recorded poses
STRIKE_SPEED = 0.15  # [m/s] approach speed above which a contact is a strike, not a touch
ALONG = 0.7  # share of the face's speed along the nail's axis below which what meets nothing passes by
REARM_GAP = 0.010  # [m] distance to which the face must retract from the head before the next strike
MISS_DEPTH = 0.003  # [m] below the head's top at which a face without contact has missed
FACE_DEPTH = 0.003  # [m] along the face's normal within which a contact lies on the face, its rim or its crown
FACE_NORMAL = np.cos(np.deg2rad(45.0))  # of the angle between the contact's normal and the face's, at least
FAR = 0.10  # [m] distance between face and nail beyond which strikes are not looked for


class PoseHistory:
    """The true poses of the EE in the hand.

    Args:
        world: The world.
        clock: See `Judge`.
    """

    def __init__(self, world: SimWorld, clock: Clock | None = None) -> None:
        self._world, self._clock = world, clock
        self._stamps: list[float] = []
        self._Xs_hand_ee: list[Array] = []

    def now(self) -> float:
        """Time by which poses are kept [s]."""
        return self._world.time if self._clock is None else self._clock.now()

    def after_step(self) -> None:
        """Keep the pose after a step, if the last one is old enough."""
        now = self.now()
        if not self._stamps or now - self._stamps[-1] >= HISTORY_PERIOD:
            self._stamps.append(now)
            self._Xs_hand_ee.append(inverse(self._world.X_base_hand()).dot(self._world.X_base_ee()))

    def X_hand_ee(self, stamp: float) -> Array:
        """The true pose of the EE in the hand, interpolated.

        Args:
            stamp: Time [s].

        Returns:
            X_hand_ee, 4x4.

        Raises:
            TooleeError: The time lies outside of the run.
        """
        margin = 2 * HISTORY_PERIOD
        if not self._stamps or not self._stamps[0] - margin <= stamp <= self._stamps[-1] + margin:
            message = f"there is no ground truth at {stamp:.3f} s: give a time within the run"
            raise TooleeError(message, code="toolee.outside_of_run")
        i = bisect_left(self._stamps, stamp)
        if i == 0 or i == len(self._stamps):
            return self._Xs_hand_ee[min(i, len(self._stamps) - 1)].copy()
        s = (stamp - self._stamps[i - 1]) / (self._stamps[i] - self._stamps[i - 1])
        A, B = self._Xs_hand_ee[i - 1], self._Xs_hand_ee[i]
        R = Slerp([0.0, 1.0], Rotation.from_matrix(np.stack([A[:3, :3], B[:3, :3]])))(s)
        return transform(R, (1 - s) * A[:3, 3] + s * B[:3, 3])


class Judge(PoseHistory):
    """Observes a world; `after_step` must be called after every step.

    Args:
        world: The world.
        clock: The clock on which the stamps are; None for the world's own. Behind a controller it is the controller's:
            the steps of a tick are computed in a burst, closer together on it than in simulated time.
    """

    def __init__(self, world: SimWorld, clock: Clock | None = None) -> None:
        super().__init__(world, clock)
        self._strikes: list[StrikeTruth] = []
        self._open = False  # the last of the strikes is still going on
        self._armed = False
        self._approach_speed = self._face_speed = 0.0  # [m/s] along the nail's axis and in all; before the contact
        self._protrusion_before = world.nail.protrusion

    def after_step(self) -> None:
        """Record the result of a step."""
        super().after_step()
        self._watch_strike(self.now())

    def _watch_strike(self, now: float) -> None:
        nail = self._world.nails[self._strikes[-1].nail] if self._open else self._world.nail
        face = self._world.tool.face()
        if math.dist(face, nail.entry) > FAR:  # the usual case, kept cheap
            self._armed, self._open = True, False
            return
        X_base_nail = nail.head_pose()
        gap = float(X_base_nail[:3, 2].dot(X_base_nail[:3, 3] - face))
        force, struck_by = self._contact()
        if gap > REARM_GAP and struck_by is StruckBy.NOTHING:
            self._armed, self._open = True, False
            self._approach_speed = self._speed_along(X_base_nail)
            return
        if self._open:
            last = self._strikes[-1]
            protrusion = nail.protrusion
            self._strikes[-1] = replace(
                last,
                struck_by=_most_telling(last.struck_by, struck_by),
                peak_force=max(last.peak_force, force),
                protrusion_mm=protrusion * 1e3,
                work=driving_work(nail.spec, last.protrusion_before_mm * 1e-3, protrusion, nail.bend_angle),
            )
        elif self._armed and (struck_by is not StruckBy.NOTHING or gap < -MISS_DEPTH):
            self._armed = False
            passes = struck_by is StruckBy.NOTHING and self._approach_speed < ALONG * self._face_speed
            if self._approach_speed >= STRIKE_SPEED and not passes:
                self._begin(now, force, struck_by, X_base_nail)
        else:
            self._approach_speed = self._speed_along(X_base_nail)

    def _begin(self, now: float, force: float, struck_by: StruckBy, X_base_nail: Array) -> None:
        world, X_base_ee = self._world, self._world.X_base_ee()
        mass = float(pb.getDynamicsInfo(world.tool_body, -1, physicsClientId=world.client)[0])
        before = self._protrusion_before * 1e3
        x, y, z = (world.X_base_hand()[:3, :3].T @ X_base_ee[:3, 2]).tolist()
        self._strikes.append(
            StrikeTruth(
                stamp=now,
                struck_by=struck_by,
                offset_mm=strike_offset(X_base_nail, X_base_ee) * 1e3,
                tilt_deg=float(np.rad2deg(strike_tilt(X_base_nail, X_base_ee))),
                nail_bend_deg=float(np.rad2deg(world.nail.bend_angle)),
                normal_in_hand=(x, y, z),
                speed=self._approach_speed,
                energy=0.5 * mass * self._approach_speed**2,
                work=0.0,
                peak_force=force,
                protrusion_before_mm=before,
                protrusion_mm=world.nail.protrusion * 1e3,
                nail=next(name for name, nail in world.nails.items() if nail is world.nail),
            )
        )
        self._open = True

    def _speed_along(self, X_base_nail: Array) -> float:
        """Speed [m/s] of the face's centre along the nail's axis; also remembers the protrusion before contact."""
        self._protrusion_before = self._world.nail.protrusion
        face = self._world.tool.face_velocity()
        self._face_speed = math.hypot(*face)
        return float(X_base_nail[:3, 2].dot(face))

    def _contact(self) -> tuple[float, StruckBy]:
        """Sum of the normal forces [N] of tool on nail in the last step, and what met the nail's head."""
        world = self._world
        if not pb.getContactPoints(bodyA=world.nail.body, physicsClientId=world.client):  # nearly always
            return 0.0, StruckBy.NOTHING
        contacts = self._contacts(world.tool_body)
        if contacts:
            X_base_ee = world.X_base_ee()
            force = float(sum(contact[9] for contact in contacts))
            on_face = any(_on_face(X_base_ee, contact) for contact in contacts)
            return force, StruckBy.FACE if on_face else StruckBy.OTHER_PART
        return 0.0, StruckBy.HAND if self._contacts(world.robot_body) else StruckBy.NOTHING

    def _contacts(self, body: int) -> list[tuple[Any, ...]]:
        """Contacts of a body with the nail's head that carry a force, as pybullet's tuples."""
        world = self._world
        contacts = pb.getContactPoints(
            bodyA=body, bodyB=world.nail.body, linkIndexB=SLIDE, physicsClientId=world.client
        )
        return [contact for contact in contacts if contact[9] > 0.0]

    @property
    def strikes(self) -> tuple[StrikeTruth, ...]:
        """All strikes so far; the last one may still be going on."""
        return tuple(self._strikes)

    def estimate_error(self, stamp: float, estimate: InHandEstimate) -> PoseError:
        """Error of an estimate.

        Args:
            stamp: Time of the frames of which it was made [s].
            estimate: The estimate.

        Returns:
            The error.
        """
        return pose_error(estimate.X_hand_ee, self.X_hand_ee(stamp), estimate.category)

    def verdict(self, estimates: Sequence[tuple[float, InHandEstimate]] = ()) -> Verdict:
        """The figures of the run so far.

        Args:
            estimates: Stamp [s] and estimate of each in-hand pose, in the order in which they were made.

        Returns:
            The figures.
        """
        first_strike = self._strikes[0].stamp if self._strikes else np.inf
        known = [e for e in estimates if np.all(np.isfinite(e[1].X_hand_ee))]
        candidates = [e for e in known if e[0] <= first_strike] or known
        candidates = [e for e in candidates if e[1].usable] or candidates
        error = self.estimate_error(*candidates[-1]) if candidates else None
        strikes = self._strikes
        return Verdict(
            nails=tuple(
                NailTruth(
                    name,
                    self._outcome(name, nail),
                    nail.protrusion * 1e3,
                    float(np.rad2deg(nail.bend_angle)),
                    float(np.rad2deg(nail.lean_angle)),
                    nail.largest_shift * 1e3,
                )
                for name, nail in self._world.nails.items()
            ),
            pose_error_mm=error.position_mm if error else None,
            pose_error_deg=error.angle_deg if error else None,
            strike_offset_mm=float(np.median([b.offset_mm for b in strikes])) if strikes else None,
            strike_tilt_deg=float(np.median([b.tilt_deg for b in strikes])) if strikes else None,
            contact_speed=float(np.median([b.speed for b in strikes])) if strikes else None,
            hits=sum(b.hit for b in strikes),
            off_face_strikes=sum(b.struck_by in (StruckBy.OTHER_PART, StruckBy.HAND) for b in strikes),
            misses=sum(b.struck_by is StruckBy.NOTHING for b in strikes),
        )

    def _outcome(self, name: str, nail: Nail) -> str:
        """How a nail stands: what drove it down counts, and the face alone does."""
        if nail.outcome is NailOutcome.FLUSH and driven_off_face(self._strikes, name) >= OFF_FACE:
            return NOT_BY_FACE
        return nail.outcome.value


def _most_telling(before: StruckBy, now: StruckBy) -> StruckBy:
    """What a strike was by: the face if it met the head at any time, or else what did first."""
    return now if now is StruckBy.FACE or before is StruckBy.NOTHING else before


def _on_face(X_base_ee: Array, contact: tuple[Any, ...]) -> bool:
    """Whether one of pybullet's contacts of the tool with another body lies on the tool's face."""
    normal = X_base_ee[:3, 2]
    depth = float((np.asarray(contact[5]) - X_base_ee[:3, 3]) @ normal)  # of the point on the tool
    # pybullet's normal points from the other body to the tool.
    return abs(depth) <= FACE_DEPTH and float(-np.asarray(contact[7]) @ normal) >= FACE_NORMAL

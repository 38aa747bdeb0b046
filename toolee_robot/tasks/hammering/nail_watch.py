"""Look at the nail itself whenever the tool is looked at: one that leans or has been bent is not struck."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolee_robot.control.collision_shapes import Body
from toolee_robot.perception.nail.appearance import NailPose
from toolee_robot.perception.nail.sight import HeadOffset, NailSight
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import JobEnded, Outcome
from toolee_robot.types import RgbdFrame

LEANS, SURE = np.deg2rad(10.0), 2.0
"""Lean of a nail as it was set that is not struck [rad], and how surely, in standard deviations of the lean."""
ASIDE = 0.0023
"""Distance of its head from the axis on which it was set at which a nail may be bent [m]: of heads pushed by 3 mm or
more few are missed, and few straight nails look so (`benchmarks/bent_nails.py`): it has to be seen twice."""
SAME_SIDE = np.deg2rad(60.0)
"""Angle within which a head is displaced to the same side at two looks [rad]: what was taken for a head at one look is
elsewhere at the next."""
WRONG = " (if the camera is wrong, set `task.watch_nail: false` in the station file)"
STANDS = 0.010
"""Least height of a nail whose foot and head can be told apart [m]."""


class NailWatch:
    """The camera's view of one nail in the course of a job.

    Args:
        config: Configuration of the station with this nail.
        observer: Receives messages.
    """

    def __init__(self, config: StationConfig, observer: TaskObserver) -> None:
        work = config.work
        self._sight = NailSight(
            config.camera.X_base_camera, work.p_base_entry, work.nail_diameter, work.nail_head_diameter, work.nail_axis
        )
        self._watched, self._observer = config.task.watch_nail, observer
        self._begun = self._told = False
        self._aside: HeadOffset | None = None  # where the head was seen at the last look if the nail looked bent

    @property
    def suspected(self) -> bool:
        """Whether the nail looked bent at the last look."""
        return self._aside is not None

    def look(self, frames: Sequence[RgbdFrame], height: float, sigma: float, others: Sequence[NailPose] = ()) -> None:
        """See whether the nail stands as it should.

        Args:
            frames: What the camera took at this look at the tool; none, and nothing is seen.
            height: Height of the nail's head over the wood [m].
            sigma: Standard deviation of it [m]; infinite where it is not known.
            others: Where other nails stand in the wood.

        Raises:
            JobEnded: The nail leans or is bent.
        """
        if not self._watched or not frames or not np.isfinite(sigma) or height < ASIDE:
            return
        if self._begun:
            head = self._sight.again(frames, height, sigma)
            if head is not None:
                self._judge(head)
            return
        if height < STANDS:
            return
        lean = self._sight.first(frames, height, others)
        self._begun = lean is not None
        if lean is None:
            if not self._told:
                self._observer.message("the camera does not see the nail, so it cannot watch it for bending")
            self._told = True
        elif leans(lean, height):
            angle, sigma = np.rad2deg(np.arctan2([lean.distance, lean.sigma], height))
            raise JobEnded(
                Outcome.BENT,
                f"the camera sees the nail lean by {angle:.0f} ± {sigma:.0f}°. Set it upright, or use another{WRONG}",
            )

    def _judge(self, head: HeadOffset) -> None:
        """Tell of a head aside; after the strikes that follow it must be seen so once more before the job ends."""
        before, self._aside = self._aside, head if is_aside(head) else None
        if self._aside is None:
            return
        far, least = head.distance * 1e3, head.least * 1e3
        seen = f"the camera sees the nail's head {far:.0f} mm beside its axis, at least {least:.1f} mm"
        if is_bent(before, head):
            raise JobEnded(Outcome.BENT, f"{seen}, for the second time. The nail is bent: pull it out{WRONG}")
        self._observer.message(f"{seen}; it may be bent, looking again soon")


def nail_of(body: Body) -> NailPose:
    """Where a nail stands, by its body of the collision checks."""
    middle, into_wood = body.X_joint_shape[:3, 3], body.X_joint_shape[:3, 2]
    half = float(body.geometry.halfSide[2]) * into_wood
    return NailPose(middle + half, middle - half)


def is_aside(head: HeadOffset) -> bool:
    """Whether a nail's head was seen so far beside the axis on which it was set that the nail may be bent."""
    return head.surely_beyond(ASIDE)


def is_bent(before: HeadOffset | None, now: HeadOffset | None) -> bool:
    """Whether two looks in a row, with strikes in between, see a nail bent.

    Args:
        before: Where the head was seen at the first one; None where it was not seen.
        now: The same of the second one.

    Returns:
        Whether it is aside at both, and to the same side.
    """
    if before is None or now is None or not (is_aside(before) and is_aside(now)):
        return False
    return bool(before.offset @ now.offset > np.cos(SAME_SIDE) * before.distance * now.distance)


def leans(lean: HeadOffset, height: float) -> bool:
    """Whether a nail leans too far to be struck.

    Args:
        lean: Where its head is seen, from its foot.
        height: Height of the head over the wood [m].

    Returns:
        Whether it does.
    """
    return lean.distance - SURE * lean.sigma > height * float(np.tan(LEANS))

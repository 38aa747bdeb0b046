"""A guarded touch: zero the force at rest, then lower the face until it meets something, and make sure that it did.

The motion ends when the mean force of a window exceeds a threshold that follows from the noise, which is measured at
rest once in a job. What still presses on the face at rest is a contact; what presses on the tool's side shows that the
face is not where it is believed to be; where nothing presses, there was a phantom, and the face goes on.

Where the face met the thing is the place from which the force has risen, found in the course of force over height: on
the way down, or where the noise is too large for that, on a slow way up until the force is gone. If that way up leaves
the height unsure, the face presses once more, and harder. What it tells of the stiffness of tool and hand makes the
heights of the other touches of the nail better, those before it too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.control.contact import protrusion
from toolee_robot.control.motion.contact_force import SLOPE_RANGE, UNKNOWN, Course, Releases, Rise, onset
from toolee_robot.control.motion.touch_force import (
    CONFIRM_SHARE,
    MAX_PHANTOMS,
    WINDOW_WAY,
    TouchSettings,
    touch_settings,
)
from toolee_robot.control.planning.straight import plan_straight
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import ZERO_TIME, ContactGuard, MotionReport
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.motions import Motions

NOISE_TIME, NOISE_TIMES = 1.0, 3
"""Time over which the noise is measured at rest [s], and how many times at most before the force is too noisy."""
CONFIRM_TIME = 0.1
"""Time at rest over which a contact must still press on the face [s]."""
SIDEWAYS_TIME = 0.5
"""Time at rest over which a force from the side is told from noise [s]: with a CB3's the mean of that time has a
standard deviation of 1 N along each axis, and at least 4 N count."""
LEAN_TIME, LEAN_TIMES, NEAR = 0.08, 20, 0.10
"""The face leans against something if over this time at rest [s], or the window's where that is longer, so many times,
the force differs from its zero by the threshold, and the zero was taken within this distance of the flange [m]; farther
away the offset itself may have changed. A tool that swings comes to rest meanwhile."""
ZERO_SHARE = 0.1
"""A zero is kept when the force at rest differs from it by at most this share of the threshold; a force so noisy that
the face is released slowly is zeroed before every measurement."""
FREE = 0.0015
"""Way of a release beyond the place where the force should be gone [m]."""
UNSURE = 0.0003
"""Standard deviation of a height, by its release and those before, above which the thing is touched again [m]: of 6,000
drawn first releases of 12 to 23 N with a CB3's noise 3 % are above it, and nine that are off by over 1 mm, all of
them."""


class SidewaysContactError(Exception):
    """The tool presses against something beside its way, where its face should have come down on something.

    Args:
        force: The force across the way [N].

    Attributes:
        force: That force [N].
    """

    def __init__(self, force: float) -> None:
        super().__init__(f"{force:.0f} N from the side")
        self.force = force


@dataclass(frozen=True)
class Contact:
    """What a touch met.

    Attributes:
        felt: Height over the wood [m] of the face's centre plane on the nail's axis where the face met it, by the
            estimated pose of the face in the hand, as this touch alone tells it.
        deviation: Standard deviation of that height [m]; 0 where the way down told it.
        releases: The releases of all touches; None where the way down told the height.
        number: Which of them this one is.
    """

    felt: float
    deviation: float = 0.0
    releases: Releases | None = None
    number: int = 0

    @property
    def height(self) -> float:
        """That height [m] by what all touches of this nail have told so far."""
        return self.felt if self.releases is None else self.releases.height(self.number)

    def surer(self, other: Contact) -> Contact:
        """Choose between two touches of the same thing; the other one is forgotten.

        Args:
            other: Another touch.

        Returns:
            The one that tells the height better.
        """
        better, worse = (self, other) if self.deviation < other.deviation else (other, self)
        worse.disbelieve()
        return better

    def disbelieve(self) -> None:
        """Forget what it told of the stiffness: nothing was met here."""
        if self.releases is not None:
            self.releases.drop(self.number)


class Touch:
    """Guarded touches of one nail.

    Args:
        motions: The arm and its motions.
        config: Configuration of the station with this nail.
    """

    def __init__(self, motions: Motions, config: StationConfig) -> None:
        self._motions, self._config, self._robot = motions, config, motions.robot
        self._settings: TouchSettings | None = None
        self._releases = Releases()
        self._up = config.work.wood_normal  # out of the wood, in `base`

    @property
    def noisy(self) -> bool:
        """Whether the force is so noisy that a touch tells a height to some tenths of a millimetre only."""
        return self._settings is not None and self._settings.release is not None

    def prepare(self, *, keep: bool = False) -> bool:
        """Zero the force at rest, before a touch, unless it still is zero; the first time, measure its noise.

        Args:
            keep: Whether a noisy force keeps its zero, too, of the other touch of the same measurement: what that zero
                is off by then counts for neither.

        Returns:
            Whether the face is free; if the arm feels a force, nothing is zeroed.

        Raises:
            DeviceError: The force is too noisy for `strike.touch_force`, or the arm cannot zero it.
        """
        motions = self._motions
        settings = self._settings
        if settings is not None and motions.zeroed_within(NEAR):
            duration = max(LEAN_TIME, settings.window)
            for looked in range(1, LEAN_TIMES + 1):
                rest = float(np.linalg.norm(np.mean(motions.forces(duration), axis=0)))
                # A noisy force does not show that it still is zero.
                share = ZERO_SHARE if settings.release is None else CONFIRM_SHARE if keep else 0.0
                if rest <= share * settings.force:
                    return True
                # To wait for a tool that swings is shorter than to zero.
                if rest <= settings.force and (settings.release is not None or looked * duration >= ZERO_TIME):
                    break
            else:
                return False
        motions.zero_wrench()
        if self._settings is None:
            self._settings = self._measured()
        return True

    def forget(self) -> None:
        """Forget what the touches so far have told of the stiffness."""
        self._releases = Releases()

    def lower(self, what: str, reach: float, held: HeldTool) -> Contact | None:
        """Lower the face square to the wood until it touches something; `prepare` was called just before.

        Args:
            what: What is touched, for the recording.
            reach: How far below the face the thing may lie [m]; the face goes on by the travel that the force is
                averaged over, without which a contact at the very end would not be felt.
            held: What the hand holds.

        Returns:
            What it met; None if it met nothing.

        Raises:
            SidewaysContactError: Something presses on the tool from the side.
            DeviceError: The force jumps without a contact, again and again.
            TooleeError: A motion failed.
        """
        motions, settings = self._motions, self._settings
        best: Contact | None = None
        assert settings is not None, "prepare() comes first"
        # The wrist as it is while nothing presses on the face: it gives way under the contact.
        X_flange_ee = self._robot.X_flange_hand(motions.q_hand) @ held.X_hand_ee
        end = self._height(X_flange_ee) - reach - 2.0 * WINDOW_WAY
        for force in settings.forces:
            guard = ContactGuard(force, averaging_window=settings.window)
            left = max(self._height(X_flange_ee) - end, 0.001)
            world = motions.world(held)
            down = plan_straight(self._robot, self._config, world, motions.q, -left, self._up, settings.speed)
            report = motions.execute(f"touch the {what}", down, held, guard, at_work=True)
            if report.contact is None:
                return best
            pressing = float(np.mean(motions.forces(max(CONFIRM_TIME, settings.window)), axis=0) @ self._up)
            if pressing < CONFIRM_SHARE * settings.force:
                if best is None:
                    self._check_sides(CONFIRM_SHARE * settings.force)
                continue
            course = self._course(report, report.contact.stamp, X_flange_ee)
            rise = onset(course) or Rise(float(course.heights[-1]), UNKNOWN.stiffness, np.inf)
            found = Contact(rise.height)
            if settings.release is not None:
                released = self._release(what, rise, pressing, held, X_flange_ee)
                if released is None:
                    continue
                found = released
            X_base_ee = self._robot.arm.fk(report.contact.q) @ X_flange_ee
            motions.observer.contact(report.contact.stamp, float(course.forces[-1]), X_base_ee)
            best = found if best is None else best.surer(found)
            if best.deviation <= UNSURE:
                break
        if best is not None:
            return best
        raise DeviceError(
            f"the force rose above {settings.force:.0f} N {MAX_PHANTOMS} times, at last {settings.largest:.0f} N, "
            f"without contact on the way to the {what}. Keep tool and cables from swinging or pulling, then check "
            "the force with `toolee doctor`",
            code="device.force_noise",
        )

    def _check_sides(self, least: float) -> None:
        """Refuse what presses on the tool at rest with at least this force [N] across the way down."""
        rest = np.mean(self._motions.forces(SIDEWAYS_TIME), axis=0)
        sideways = float(np.linalg.norm(rest - (rest @ self._up) * self._up))
        if sideways >= least:
            raise SidewaysContactError(sideways)

    def _measured(self) -> TouchSettings:
        """Settings by the noise at rest; the longer it is measured, the better it is known."""
        motions = self._motions
        forces = np.empty((0, 3))
        for last in range(NOISE_TIMES):
            forces = motions.read_noise(NOISE_TIME, forces)
            try:
                return touch_settings(forces, motions.arm.rate, self._config.strike)
            except DeviceError:
                if last == NOISE_TIMES - 1:
                    raise
        raise AssertionError

    @property
    def _zeros(self) -> int:
        """Number of readings of the zero, where the force was zeroed just before the touch."""
        assert self._settings is not None, "prepare() comes first"
        return 0 if self._settings.release is None else round(ZERO_TIME * self._motions.arm.rate)

    def _height(self, X_flange_ee: Array) -> float:
        X_base_ee = self._robot.arm.fk(self._motions.q) @ X_flange_ee
        return protrusion(X_base_ee, self._config.work.X_base_nail(0.0))

    def _release(self, what: str, down: Rise, force: float, held: HeldTool, X_flange_ee: Array) -> Contact | None:
        """Lift the face slowly from what it presses on with a force [N], which it met as the way down tells.

        Returns:
            What was touched; None if no force goes with the way up, so that nothing was.
        """
        motions, settings, releases = self._motions, self._settings, self._releases
        assert settings is not None, "prepare() comes first"
        # A release tells the stiffness far better than the way down does.
        belief = releases.belief()
        if belief is UNKNOWN:
            pressed = max(force / down.stiffness, down.height - self._height(X_flange_ee))
            speed = settings.release_speed(down.stiffness)
        else:
            pressed = force / belief.stiffness
            speed = settings.release_speed(belief.stiffness, belief.deviation)
        world, way = motions.world(held), min(pressed, SLOPE_RANGE - FREE) + FREE
        up = plan_straight(self._robot, self._config, world, motions.q, way, self._up, speed)
        report = motions.execute(f"release the {what}", up, held, at_work=True)
        course = self._course(report, np.inf, X_flange_ee)
        rise = onset(course)
        if rise is None or rise.stiffness * (rise.height - np.min(course.heights)) < CONFIRM_SHARE * settings.force:
            return None
        sure = onset(course, belief) or rise
        return Contact(sure.height, sure.deviation, releases, releases.add(course, rise.stiffness))

    def _course(self, report: MotionReport, until: float, X_flange_ee: Array) -> Course:
        """The forces in a motion up to a time [s], over the height of the face above the wood."""
        assert self._settings is not None, "prepare() comes first"
        rows = report.stamps <= until
        wood = self._config.work.X_base_nail(0.0)
        poses = self._robot.arm.fk(report.q_measured[rows]) @ X_flange_ee
        heights = np.array([protrusion(X, wood) for X in poses])
        return Course(heights, report.wrenches[rows, :3] @ self._up, self._settings.variance, self._zeros)

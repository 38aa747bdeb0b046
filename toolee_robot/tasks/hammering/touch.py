"""A guarded touch: zero the force at rest, then lower the face until it meets something, and make sure that it did.

The motion ends when the mean force of a window exceeds a threshold that follows from the noise, which is measured at
rest once in a job. What still presses on the face at rest is a contact; what does not was a phantom, and the face goes
on. Where the face met the thing is the place from which the force has risen, found in the course of force over height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.config import StationConfig
from toolee_robot.control.planning.straight import plan_straight
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.control.slip import protrusion
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard, MotionReport
from toolee_robot.tasks.common.motions import UP, Motions
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.types import JointState

NOISE_TIME, NOISE_TIMES = 1.0, 3
"""Time over which the noise is measured at rest [s], and how many times at most before the force is too noisy."""
WINDOW_WAY = 0.00144
"""Travel over which the force of a touch is averaged [m]: 48 ms, six readings of a CB3, at 0.03 m/s."""
QUIET = 1.0
"""Standard deviation of the force up to which a touch goes at `strike.touch_speed` [N]; with more, slower."""
SLOWEST = 0.2
"""Least speed of a touch as a share of `strike.touch_speed`."""
SIGMAS = 4.5
"""Threshold of a contact in standard deviations of the window's mean force: one touch in some fifty with a CB3's noise
is a phantom, which is recognised."""
ZERO_TIME = 0.5
"""Time over which an arm zeroes its force [s]; see `hal.Arm.zero_wrench`."""
MAX_FACTOR = 1.5
"""The noise may raise the threshold to this multiple of `strike.touch_force`; with more, nothing is touched."""
CONFIRM_TIME, CONFIRM_SHARE = 0.1, 0.5
"""A contact is sure when over this time [s] at rest at least this share of the threshold still presses on the face."""
MAX_PHANTOMS = 3
"""Number of phantoms in one touch after which the force is not to be relied on."""
LEAN_TIME, NEAR = 0.16, 0.10
"""The face leans against something if over this time at rest [s] the force differs from its zero by the threshold, and
the zero was taken within this distance of the flange [m]; farther away the offset itself may have changed."""
SLOPE_RANGE = 0.008
"""Height above the end of a touch over which the rise of the force is examined [m]."""


@dataclass(frozen=True)
class TouchSettings:
    """How to touch with the force's present noise.

    Attributes:
        force: Mean force that counts as a contact [N].
        window: Averaging window [s].
        speed: Speed of the touch [m/s].
    """

    force: float
    window: float
    speed: float


class Touch:
    """Guarded touches of one job.

    Args:
        motions: The arm and what it carries.
        config: Configuration of the station.
        robot: Kinematic model of arm and hand.
        observer: Receives the contacts.
    """

    def __init__(self, motions: Motions, config: StationConfig, robot: RobotModel, observer: TaskObserver) -> None:
        self._motions, self._config, self._robot, self._observer = motions, config, robot, observer
        self._settings: TouchSettings | None = None

    def prepare(self) -> bool:
        """Zero the force at rest, before a touch; the first time, measure its noise.

        Returns:
            Whether the face is free; if the arm feels a force, nothing is zeroed.

        Raises:
            DeviceError: The force is too noisy for `strike.touch_force`, or the arm cannot zero it.
        """
        motions = self._motions
        if self._settings is not None and motions.zeroed_within(NEAR):
            felt = np.linalg.norm(np.mean(motions.forces(LEAN_TIME), axis=0))
            if felt > self._settings.force:
                return False
        motions.zero_wrench()
        if self._settings is None:
            self._settings = self._measured()
        return True

    def lower(self, what: str, reach: float) -> float | None:
        """Lower the face until it touches something; `prepare` was called just before.

        Args:
            what: What is touched, for the recording.
            reach: Length of the motion without a contact [m].

        Returns:
            Height over the wood [m] of the face's centre plane on the nail's axis where the face met the thing, by the
            estimated pose of the face in the hand; None if it met nothing.

        Raises:
            DeviceError: The force jumps without a contact, again and again.
            TooleeError: A motion failed.
        """
        motions, settings = self._motions, self._settings
        assert settings is not None, "prepare() comes first"
        # The wrist as it is while nothing presses on the face: it gives way under the contact.
        X_flange_ee = self._robot.X_flange_hand(motions.q_hand) @ motions.X_hand_ee
        guard = ContactGuard(settings.force, averaging_window=settings.window)
        end = self._height(X_flange_ee) - reach
        for _ in range(MAX_PHANTOMS):
            left = max(self._height(X_flange_ee) - end, 0.001)
            down = plan_straight(self._robot, self._config, motions.world(), motions.q, -left, UP, settings.speed)
            report = motions.execute(f"touch the {what}", down, guard, at_work=True)
            if report.contact is None:
                return None
            pressing = np.mean(motions.forces(max(CONFIRM_TIME, settings.window)), axis=0)
            if pressing @ self._up > CONFIRM_SHARE * settings.force:
                return self._contact(report, report.contact, X_flange_ee)
        raise DeviceError(
            f"{MAX_PHANTOMS} times the force rose above {settings.force:.0f} N while the {what} was approached, and "
            "nothing was there: see that nothing swings or pulls at tool and cables, then look at the force with "
            "toolee doctor",
            code="device.force_noise",
        )

    def _measured(self) -> TouchSettings:
        """Settings by the noise at rest; the longer it is measured, the better it is known."""
        motions = self._motions
        forces = np.empty((0, 3))
        for last in range(NOISE_TIMES):
            forces = np.concatenate([forces, motions.forces(NOISE_TIME)])
            try:
                return touch_settings(forces, motions.arm.rate, self._config)
            except DeviceError:
                if last == NOISE_TIMES - 1:
                    raise
        raise AssertionError

    @property
    def _up(self) -> Array:
        """Direction out of the wood in `base`, (3,)."""
        return -self._config.work.X_base_nail(0.0)[:3, 2]

    def _height(self, X_flange_ee: Array) -> float:
        X_base_ee = self._robot.arm.fk(self._motions.q) @ X_flange_ee
        return protrusion(X_base_ee, self._config.work.X_base_nail(0.0))

    def _contact(self, report: MotionReport, contact: JointState, X_flange_ee: Array) -> float:
        rows = report.stamps <= contact.stamp
        poses = self._robot.arm.fk(report.q_measured[rows]) @ X_flange_ee
        wood = self._config.work.X_base_nail(0.0)
        heights = np.array([protrusion(X, wood) for X in poses])
        forces = report.wrenches[rows, :3] @ self._up
        self._observer.contact(contact.stamp, float(forces[-1]), self._robot.arm.fk(contact.q) @ X_flange_ee)
        return onset(heights, forces)


def touch_settings(forces: Array, rate: float, config: StationConfig) -> TouchSettings:
    """Choose threshold, window and speed of a touch by the noise of the force.

    The threshold bears the noise of the window's mean, correlated as it is, and of the zero.

    Args:
        forces: Readings of the force at rest, one a cycle, (N, 3) [N].
        rate: Rate of the readings [Hz].
        config: Configuration of the station.

    Returns:
        The settings.

    Raises:
        DeviceError: The force is too noisy for the configured threshold.
    """
    strike = config.strike
    sigma = float(np.sqrt(np.mean(np.var(forces, axis=0, ddof=1))))
    speed = strike.touch_speed * min(1.0, max(QUIET / max(sigma, 1e-9), SLOWEST))
    window = WINDOW_WAY / speed
    # The zero is a mean, too, of a longer time.
    needed = SIGMAS * deviation_of_mean(forces, rate, window) * float(np.sqrt(1.0 + window / ZERO_TIME))
    if needed > MAX_FACTOR * strike.touch_force:
        raise DeviceError(
            f"at rest the force varies so much (standard deviation {sigma:.1f} N) that only {needed:.0f} N would be a "
            f"sure contact, strike.touch_force is {strike.touch_force:g} N: nothing is touched. Check the payload, "
            "wait until nothing swings, or raise it as far as the hand can bear",
            code="device.force_noise",
        )
    return TouchSettings(max(strike.touch_force, needed), window, speed)


def deviation_of_mean(forces: Array, rate: float, duration: float) -> float:
    """Estimate the standard deviation of the force's mean over some time, whatever the noise's correlation.

    Args:
        forces: Readings at rest, (N, 3) [N].
        rate: Rate of the readings [Hz].
        duration: Time over which the mean is taken, shorter than that of the readings [s].

    Returns:
        The deviation, mean square of the axes [N].
    """
    n = max(round(duration * rate), 1)
    centred = forces - forces.mean(axis=0)
    means = np.stack([np.convolve(axis, np.full(n, 1.0 / n), mode="valid") for axis in centred.T])
    # The mean of all readings, which was subtracted, holds a share of each window's own deviation.
    return float(np.sqrt(np.mean(means**2) / (1.0 - n / len(forces))))


def onset(heights: Array, forces: Array) -> float:
    """Find where a force began to rise, by the least squares of a force that is constant above and linear below.

    Args:
        heights: Falling heights, (N,) [m]; the last one is where the contact was detected.
        forces: Upward forces, (N,) [N].

    Returns:
        The height at which the line begins [m].
    """
    near = heights < heights[-1] + SLOPE_RANGE
    x, f = heights[near], forces[near]
    best, where = np.inf, float(heights[-1])
    for begin in np.arange(x[-1] + 0.0001, x[-1] + 0.75 * SLOPE_RANGE, 0.0001):
        ramp = np.maximum(begin - x, 0.0)
        A = np.column_stack([np.ones_like(x), ramp])
        solution, *_ = np.linalg.lstsq(A, f, rcond=None)
        rest = float(np.sum((A @ solution - f) ** 2))
        if solution[1] > 0.0 and rest < best:
            best, where = rest, float(begin)
    return where

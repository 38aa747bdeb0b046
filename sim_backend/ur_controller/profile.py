"""Profiles of the controller: how well it follows and measures, and when it stops by itself.

`ideal` follows and measures exactly. `harsh` has the values of the model's generation, CB3 or e-Series. Each value is
marked: P, published by Universal Robots; M, measured elsewhere; A, assumed, since neither was found. None of them was
measured on a robot by this project. docs/reference/ur_controller.md has the table with the sources.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf, isfinite
from typing import Literal

from toolee_robot.errors import UserError

ProfileName = Literal["ideal", "harsh"]
REFERENCE_GAIN, REFERENCE_LOOKAHEAD = 1200.0, 0.03
"""`gain` and `lookahead_time` [s] of servoj at which a lag is given: those at which a UR10e's was measured."""

RATIOS_SINCE = (5, 15)
"""Version from which a controller reports joint_position_deviation_ratio and collision_detection_ratio."""


@dataclass(frozen=True)
class ServoLag:
    """How `servoj` lags behind its targets.

    A target takes effect after `dead_time`, is smoothed by a first-order filter, and followed by a proportional law
    whose velocity has a first-order lag.

    Attributes:
        dead_time: Time between the call and its first effect [s].
        smoothing: Time constant of the filter as a share of `lookahead_time`.
        rate: Gain of the proportional law divided by the argument `gain` [1/s].
        velocity_lag: Time constant of the velocity [s].
    """

    dead_time: float
    smoothing: float
    rate: float
    velocity_lag: float

    def lag(self, gain: float, lookahead: float, period: float) -> float:
        """Lag behind a target that moves at constant velocity.

        Args:
            gain: `gain` of servoj.
            lookahead: `lookahead_time` of servoj [s].
            period: Period of the controller [s]; a target holds for one.

        Returns:
            The lag [s].
        """
        dead = round(self.dead_time / period) * period
        return dead + self.smoothing * lookahead + 1.0 / (self.rate * gain) - 0.5 * period

    def with_lag(self, lag: float, period: float) -> ServoLag:
        """Change the lag at the reference values: the dead time in whole periods, then the law's gain.

        Args:
            lag: The lag at REFERENCE_GAIN and REFERENCE_LOOKAHEAD [s].
            period: Period of the controller [s].

        Returns:
            The changed law.

        Raises:
            UserError: The lag is not finite, or so short that the proportional law would be twice as fast.
        """
        law = 1.0 / (self.rate * REFERENCE_GAIN)
        both = lag - self.smoothing * REFERENCE_LOOKAHEAD + 0.5 * period  # dead time and law
        if not (both >= 0.5 * law and isfinite(lag)):
            shortest = 0.5 * law + self.smoothing * REFERENCE_LOOKAHEAD - 0.5 * period
            raise UserError(
                f"a lag of {lag:g} s is not possible: give {shortest:.4f} s or more, at a gain of {REFERENCE_GAIN:g} "
                f"and a lookahead of {REFERENCE_LOOKAHEAD} s"
            )
        dead = max(0, round((both - law) / period)) * period
        return replace(self, dead_time=dead, rate=1.0 / (REFERENCE_GAIN * (both - dead)))


@dataclass(frozen=True)
class EncoderNoise:
    """Noise of the measured joints, white, the same for all joints.

    Attributes:
        position: Standard deviation of a position [rad].
        velocity: Standard deviation of a velocity [rad/s].
    """

    position: float = 0.0
    velocity: float = 0.0


@dataclass(frozen=True)
class ForceErrors:
    """Errors of the measured wrench; each pair is for forces [N] and torques [Nm].

    Attributes:
        noise: Standard deviation of the noise, per axis.
        correlation: Correlation time of the noise [s].
        offset: Norm of the offset at rest.
        pose_drift: Largest change of the offset, per axis, as the arm moves.
        time_drift: Change of the offset, norm, as the controller warms up.
        warm_up: Time constant of that [s].
        friction: Friction that the estimate misses, as a share of each joint's largest torque; 0 for a sensor.
        inertia: Share of the torque for the arm's acceleration that the estimate misses; 0 for a sensor.
        zeroed: Whether the controller can zero it (`zero_ftsensor`).
    """

    noise: tuple[float, float] = (0.0, 0.0)
    correlation: float = 0.0
    offset: tuple[float, float] = (0.0, 0.0)
    pose_drift: tuple[float, float] = (0.0, 0.0)
    time_drift: tuple[float, float] = (0.0, 0.0)
    warm_up: float = 600.0
    friction: float = 0.0
    inertia: float = 0.0
    zeroed: bool = True


@dataclass(frozen=True)
class SafetyLimits:
    """Limits whose violation causes a protective stop; `inf` for none.

    Attributes:
        force: Force on the flange [N], low-pass filtered: as estimated from joint currents, a strike appears weaker.
        force_time: Time constant of that filter, also for power and torques [s].
        following_error: Deviation of a joint from its set-point [rad].
        joint_position: Largest joint position in both directions, (6,), as a fraction of the model's.
        joint_speed: Joint velocity as a fraction of the model's limit.
        tcp_speed: Speed of the TCP [m/s].
        power: Mechanical power on the environment [W].
        momentum: Momentum of arm and payload [kg m/s].
        collision_torque: Torque of the environment at a joint, as a share of its largest torque.
        motion_torque: Torque for the planned motion, as a share of the joint's largest torque.
        torque_jump: Change of that torque in one tick, likewise.
        sudden_stop: Joint speed with which a motion may end while the program goes on without another one [rad/s].
    """

    force: float = 150.0
    force_time: float = 0.02
    following_error: float = 0.2
    joint_position: tuple[float, ...] = (1.0,) * 6
    joint_speed: float = 1.1
    tcp_speed: float = 5.0
    power: float = inf
    momentum: float = inf
    collision_torque: float = inf
    motion_torque: float = inf
    torque_jump: float = inf
    sudden_stop: float = inf


@dataclass(frozen=True)
class StopDecelerations:
    """Deceleration of the fastest joint in each kind of stop [rad/s^2].

    Attributes:
        program: The program ends, or lets go of the arm, during a motion.
        protective: A protective stop.
        safeguard: A safeguard stop.
        emergency: An emergency stop, a fault or a violation.
    """

    program: float = 5.0
    protective: float = 15.0
    safeguard: float = 15.0
    emergency: float = 15.0


@dataclass(frozen=True)
class Profile:
    """How a controller follows, measures and stops.

    Attributes:
        name: Name of the profile.
        servo: Lag of `servoj`; None for none.
        encoders: Noise of the measured joints.
        force: Errors of the measured wrench.
        limits: Limits of the safety system.
        stops: Decelerations of the stops.
        version: Version of the software: major, minor, bugfix, build; None for the model's.
        safeguard_resumes: Whether closing the safeguard resumes the program that it paused, as on a CB3 controller
            without a safeguard reset input.
    """

    name: str
    servo: ServoLag | None = None
    encoders: EncoderNoise = EncoderNoise()
    force: ForceErrors = ForceErrors()
    limits: SafetyLimits = field(default_factory=SafetyLimits)
    stops: StopDecelerations = StopDecelerations()
    version: tuple[int, int, int, int] | None = None
    safeguard_resumes: bool = False

    @property
    def reports_ratios(self) -> bool:
        """Whether the version is one that reports how near deviation and collision detection are to a stop."""
        return self.version is not None and self.version[:2] >= RATIOS_SINCE


IDEAL = Profile("ideal")

CB3_LIMITS = SafetyLimits(
    # 150 N, 300 W and 25 kg m/s: M, the defaults in an installation of PolyScope 3 (of a UR5).
    power=300.0,
    momentum=25.0,
    # A, from here on. Half of a joint's torque is about what the 150 N do at the lever of its usual load.
    following_error=0.1,
    collision_torque=0.5,
    motion_torque=1.0,
    torque_jump=0.5,
    sudden_stop=0.1,
)

CB3 = Profile(
    "harsh",
    # 54 ms at a gain of 1200 and a lookahead of 0.03 s (A): 24 + 15 + 19 - 4 ms. Three cycles of dead time as the
    # e-Series has two to three (M); 35 ms were measured on a UR5 at 2000 and 0.03 s (M, ROS 2 driver, issue 1311).
    servo=ServoLag(dead_time=0.024, smoothing=0.5, rate=1.0 / (1200 * 0.019), velocity_lag=0.015),
    encoders=EncoderNoise(position=5e-5, velocity=3e-3),  # A
    # 3.6 N and 7 N: M (UR forum, topic 229); +-10 N and +-5 Nm of accuracy: P; the rest: A, within that accuracy.
    force=ForceErrors(
        noise=(3.6, 0.6),
        correlation=0.02,
        offset=(7.0, 1.0),
        pose_drift=(3.0, 0.6),
        time_drift=(1.5, 0.3),
        friction=0.01,
        inertia=0.1,
        zeroed=False,
    ),
    limits=CB3_LIMITS,
    stops=StopDecelerations(program=5.0, protective=10.0, safeguard=10.0, emergency=15.0),  # A
    safeguard_resumes=True,  # A: an installation without a safeguard reset input
)

E_SERIES = Profile(
    "harsh",
    # 34 ms at a gain of 1200 and a lookahead of 0.03 s (M: UR10e, UR client library, issue 86): 4 + 15 + 16 - 1 ms, of
    # which the same issue gives two to three cycles to the way there and back.
    servo=ServoLag(dead_time=0.004, smoothing=0.5, rate=1.0 / (1200 * 0.016), velocity_lag=0.015),
    encoders=EncoderNoise(position=2e-5, velocity=1e-3),  # A
    # UR10e: 5.0 N and 0.2 Nm of precision, 5.5 N and 0.5 Nm of accuracy (P); how they divide up: A.
    force=ForceErrors(
        noise=(1.5, 0.06), correlation=0.004, offset=(4.0, 0.4), pose_drift=(1.5, 0.1), time_drift=(1.0, 0.05)
    ),
    # 1000 W and 100 kg m/s: A, an installation with the least restricted limits, which Universal Robots asks for where
    # joints need their torque and the risk assessment permits it.
    limits=replace(CB3_LIMITS, power=1000.0, momentum=100.0),
    stops=StopDecelerations(program=5.0, protective=15.0, safeguard=10.0, emergency=20.0),  # A
    version=(5, 22, 0, 1214729),  # has the deviation and collision ratios, and is the newest that ur_rtde 1.6.5 accepts
)


def usual_lag(e_series: bool) -> ServoLag:
    """The lag of a generation, for controllers whose profile has none.

    Args:
        e_series: Whether the controller is an e-Series controller.

    Returns:
        The lag.
    """
    lag = (E_SERIES if e_series else CB3).servo
    assert lag is not None, "both generations have one"
    return lag


def profile(name: str, e_series: bool) -> Profile:
    """A profile by its name.

    Args:
        name: `ideal` or `harsh`.
        e_series: Whether the controller is an e-Series controller.

    Returns:
        The profile.

    Raises:
        KeyError: There is no profile of this name.
    """
    return {"ideal": IDEAL, "harsh": E_SERIES if e_series else CB3}[name]

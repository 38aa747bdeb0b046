"""Parameters of the hammering job: strikes, decisions, and the bounds that the supervisor enforces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from toolee_robot.station.values import STRICT, Count, NotNegative, Positive


@dataclass(frozen=True)
class StrikeConfig:
    """Parameters of a strike, and of the guarded touch that measures the nail."""

    __pydantic_config__ = STRICT
    speed: Positive = 1.2
    """Wanted speed of the face at the contact [m/s]. Stopping takes the hand some 90 mm from 1.2 m/s and 140 mm from
    1.5 m/s; beside the block, the hand has less than the latter with a short hammer."""
    run_up: Positive = 0.20
    """Length of the straight run-up to the nail [m]."""
    deepest: Annotated[float, Field(ge=0.001)] | None = None
    """Largest distance of the commanded face beyond the contact [m]; a servo that lags goes there, too, only later.
    Null only for a hand whose wrist gives way by some 90 mm at 1.2 m/s: the strike is then a straight line that brakes
    from the contact on. With a rigid hand or mount 0.01 for the first strikes on a robot, then 0.02: the strike is a
    swing that turns back there, and the faster the deeper that is. A hand whose wrist gives way may have 0.1, for
    swings that are as fast as a straight line and, where `supervisor.unattended_speed` permits it, faster."""
    touch_speed: Positive = 0.03
    """Speed of the guarded touch that measures where the face meets the nail [m/s]."""
    touch_force: Positive = 8.0
    """Force that ends the guarded touch [N]; must be below what a compliant wrist transmits at the end of a long
    hammer."""
    contact_force: Positive = 15.0
    """Force that counts as the contact of a strike [N]."""
    max_load: Annotated[float, Field(gt=0, le=1)] = 0.6
    """Largest joint position deviation ratio and collision detection ratio of the controller in a strike, where it has
    them; at 1 the robot stops itself. After a strike with more, the job ends."""
    max_torque_share: Positive = 1.0
    """Largest computed torque of a joint in a strike as a share of its largest one, without friction and rotors. After
    a strike with more, the job ends. No straight strike is planned with more than 0.9, and no stop asks for more than
    0.9 by its braking."""
    clearance: NotNegative = 0.008
    """Least distance between any two bodies during a strike, other than face and nail [m]."""


@dataclass(frozen=True)
class TaskConfig:
    """Thresholds with which the hammering job decides to continue, to look at the tool again, or to end."""

    __pydantic_config__ = STRICT
    max_strikes: Count = 40
    """Number of strikes after which the job gives up."""
    flush_protrusion: Positive = 0.001
    """Largest protrusion over the wood that counts as flush [m]."""
    min_progress: NotNegative = 0.0002
    """Least depth that a strike must drive the nail; a strike below it has not moved the nail [m]."""
    slip_per_strike: NotNegative = 0.0015
    """Standard deviation of the tool's drift in the hand per strike [m]."""
    slip_angle_per_strike: NotNegative = np.pi / 450
    """Standard deviation of the tool's rotational drift in the hand per strike [rad]."""
    abort_slip: Positive = 0.015
    """Slip between two looks at the tool above which it must be gripped again [m]."""
    abort_slip_angle: Positive = np.pi / 12
    """Rotational slip between two looks at the tool above which it must be gripped again [rad]."""
    views: Count = 6
    """Number of views of the first look at the tool."""
    views_again: Count = 2
    """Number of views of each later look."""
    strikes_between_looks: Count = 4
    """Number of strikes after which the tool is looked at again; up to half as many more if it is held steadily and
    they finish the nail."""
    watch_nail: bool = True
    """Whether the camera's frames of these looks also tell that the nail leans or is bent, which ends the job."""
    handover_timeout: Positive = 30.0
    """Time that a person has to hand over the tool, and to answer each question [s]."""


@dataclass(frozen=True)
class SupervisorConfig:
    """Bounds that the supervisor enforces in addition to the joint limits."""

    __pydantic_config__ = STRICT
    handover_speed: Positive = 0.25
    """Largest speed of flange and tool in HANDOVER mode, with a person in reach [m/s]: the reduced speed of
    ISO 10218-1."""
    unattended_speed: Positive = 1.5
    """Largest speed of flange and tool in UNATTENDED mode, with nobody in reach [m/s]: a common safety setting of UR
    arms."""
    tracking_error: Positive = 0.05
    """Largest deviation of a measured joint from its command [rad]; see `MotionWatch`."""
    data_cycles: Positive = 3.0
    """Largest age of the newest reading during a motion [control cycles]: 24 ms on a CB3, 6 ms on an e-Series, where a
    computer without a real-time kernel may need 10; see `MotionWatch`."""
    overruns: Count = 3
    """Largest number of successive late command cycles; see `MotionWatch`. A strike with a sharp `servo` bears no more
    on either generation; at `servoj`'s default gain and lookahead an e-Series bears 10."""
    max_data_age: Positive = 0.1
    """Largest age of the arm's newest reading before a motion starts [s]."""
    early_contact: Positive = 0.024
    """Largest distance before the expected contact at which a strike may meet the nail [m]."""
    late_contact: Positive = 0.030
    """Largest distance beyond the expected contact at which a strike may meet the nail [m]; at 1.2 m/s and 125 Hz the
    force is detected some 15 mm behind the contact."""
    max_hand_temperature: Positive = 65.0
    """Temperature of the hand above which no further strike starts [deg C]."""
    ask_before_swing: bool = True
    """Whether a person must confirm the first swing of a job."""

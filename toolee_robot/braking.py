"""Stop on the path: slow the clock of a running trajectory to a standstill, within the joints' limits.

With s the time on the trajectory and r = ds/dt: q'' = q_ss r^2 + q_s r'. What the joints' acceleration limit leaves
beside q_ss r^2 decides how fast r may fall (time scaling; Bobrow, Dubowsky and Gibson 1985). Joints that stop each for
themselves would leave the straight line that a tool in contact needs.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.types import Trajectory

SLOWEST = 0.5
"""[1/s] The rate falls at least this fast, so that every stop ends."""


def brake_on_path(
    trajectory: Trajectory, start: float, period: float, acceleration: float, jerk: float
) -> Iterator[tuple[Array, Array]]:
    """q, qd (n,) each `period` [s], from full rate at time `start` [s] on the trajectory to rest.

    acceleration [rad/s^2] and jerk [rad/s^3] bound every joint. Ends at the trajectory's end at the latest.
    """
    s, rate, fall = start, 1.0, 0.0
    while rate > 0.0 and s < trajectory.duration:
        _, q_s = trajectory.sample(s)
        q_ss = (trajectory.sample(s + period)[1] - trajectory.sample(s - period)[1]) / (2 * period)
        fastest = max(float(np.abs(q_s).max()), 1e-6)
        # A joint that still speeds up along the path brakes with all of its limit and that acceleration besides.
        free = np.maximum(acceleration + np.sign(q_s) * q_ss * rate**2, 0.0) / np.maximum(np.abs(q_s), 1e-6)
        change = jerk / fastest
        # The fall itself must have faded when the rate reaches zero.
        fall = max(min(float(free.min()), fall + change * period, np.sqrt(2 * change * rate)), SLOWEST)
        following = max(rate - fall * period, 0.0)
        s = min(s + (rate + following) / 2 * period, trajectory.duration)
        rate = following
        q, qd = trajectory.sample(s)
        yield q, qd * rate

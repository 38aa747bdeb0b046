"""What `toolee arm` may ask of a robot's joints, as the stand-in's trace shows it."""

from __future__ import annotations

import numpy as np

from toolee_robot.sim_backend.ur_controller.faults.fault_port import Trace

SPEED, ACCELERATION = 0.1, 1.0
"""[rad/s], [rad/s^2] The caps."""
WINDOW = 0.1
"""[s] Over which speeds are means, for a late command shows as two steps in one tick."""


def assert_slow(trace: Trace, rate: float) -> None:
    """The set-points that a controller of this rate [Hz] got, and the joints themselves, stay within the caps."""
    n = round(WINDOW * rate)
    for q in (trace.q_target, trace.q):
        speeds = (q[n:] - q[:-n]) * rate / n
        assert np.abs(speeds).max() <= SPEED * (n + 2) / n
        assert np.abs(speeds[n:] - speeds[:-n]).max() * rate / n <= 1.4 * ACCELERATION

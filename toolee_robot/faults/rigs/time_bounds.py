"""Motion bounds during fault injection, wide enough that a busy machine does not add faults of its own.

Rows about late data or late commands use the stricter bounds.
"""

from __future__ import annotations

from dataclasses import replace

from toolee_robot.config import ServoConfig
from toolee_robot.hal import MotionWatch

SERVO = ServoConfig(lag=0.05)
"""Of the ideal stand-in, which lags by a cycle and the network; the rest is for a busy machine."""
PATIENT = MotionWatch(tracking_error=0.05, data_cycles=100.0, overruns=100)
"""Tolerates late data and late commands."""
STRICT_AGE = replace(PATIENT, data_cycles=3.0)
"""For late data."""
SHORT_AGE = replace(PATIENT, data_cycles=10.0)
"""For connections that stay open without data."""
STRICT_LOOP = replace(PATIENT, tracking_error=0.3, overruns=3)
"""For late commands."""

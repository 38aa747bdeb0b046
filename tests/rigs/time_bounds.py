"""Motion bounds during fault injection, wide enough that a busy machine does not add faults of its own.

Rows about late data or late commands use the stricter bounds.
"""

from __future__ import annotations

from dataclasses import replace

from toolee_robot.hal import MotionWatch

PATIENT = MotionWatch(tracking_error=0.05, data_cycles=100.0, overruns=100)
"""Tolerates late data and late commands."""
CLOSE = replace(PATIENT, tracking_error=0.03)
"""For joints that are pushed back: at 2 rad/s each cycle of permitted lag hides 0.02 rad of it at 125 Hz."""
STRICT_AGE = replace(PATIENT, data_cycles=3.0)
"""For late data."""
SHORT_AGE = replace(PATIENT, data_cycles=10.0)
"""For connections that stay open without data."""
STRICT_LOOP = replace(PATIENT, tracking_error=0.3, overruns=3)
"""For late commands."""

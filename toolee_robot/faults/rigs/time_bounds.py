"""Bounds under which faults are injected: the matrix has to tell its faults from a machine that is busy with others.

Rows that are about late data or late commands bring their own.
"""

from __future__ import annotations

from dataclasses import replace

from toolee_robot.hal import MotionWatch

PATIENT = MotionWatch(tracking_error=0.05, data_cycles=100.0, overruns=100)
STRICT_AGE = replace(PATIENT, data_cycles=3.0)
SHORT_AGE = replace(PATIENT, data_cycles=10.0)
STRICT_LOOP = replace(PATIENT, tracking_error=0.3, overruns=3)

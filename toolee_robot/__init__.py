"""toolee_robot: a robot-control stack for real hammering, after the paper ToolEENet."""

import os

# Waiting threads spin for some microseconds, then sleep, unless the user says otherwise. Measured on 2 cores: a pose
# takes 24 ms with these, 31 ms with threads that sleep at once, 22 ms with ones that spin for good; beside a program
# that keeps one core busy (a simulation, a second job) 34, 27 and 59 ms (nine in ten under 39, 34 and 197 ms).
# OpenMP reads this once, when torch is first imported: this package must come before it.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
    os.environ.setdefault("GOMP_SPINCOUNT", "1000")

__version__ = "0.1.0"

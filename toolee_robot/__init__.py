"""toolee_robot: a robot-control stack for real hammering, after the paper ToolEENet."""

import os

# Waiting threads spin for some microseconds, then sleep, unless the user says otherwise. Measured on 2 cores: a pose
# takes 27 ms with threads that sleep at once, 20 ms with these, 19 ms with ones that spin for good; beside a program
# that keeps one core busy (a simulation, a second job) 28 ms, 34 ms and over a second.
# OpenMP reads this once, when torch is first imported.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
    os.environ.setdefault("GOMP_SPINCOUNT", "1000")

__version__ = "0.1.0"

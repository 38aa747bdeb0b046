"""toolee_robot: a robot-control stack for real hammering, after the paper ToolEENet."""

import os

# Waiting threads spin for some tens of microseconds, then sleep, unless the user says otherwise. Measured on 2 cores of
# a virtual machine, medians for a pose: 26 ms with these, 52 with a tenth of the spins, 21 where they spin for good;
# beside a program that keeps one core busy 77, 40 and 225 ms. Chosen for cores that have nothing else to do.
# OpenMP reads this once, when torch is first imported: this package must come before it.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
    os.environ.setdefault("GOMP_SPINCOUNT", "10000")

__version__ = "0.1.0"

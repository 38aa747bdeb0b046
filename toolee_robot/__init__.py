"""toolee_robot: a robot-control stack for real hammering, after the paper ToolEENet."""

import os

# Waiting threads sleep instead of spinning, unless the user says otherwise. Measured on 2 cores: with one of them busy
# (a simulation, a second job), spinning turns a pose estimate of 13 ms into one of 1.4 s; asleep, it takes 32 ms.
# OpenMP reads this once, when torch is first imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = "0.1.0"

"""The simulated station in pybullet: UR10 and Shadow Hand, work and nail, camera, the person who hands the tool over.

    from toolee_robot.sim_backend import SimOptions, SimStation
    with SimStation.build(StationConfig(), seed=0) as simulation:
        task(simulation.station)         # the hardware abstraction: all that a task may touch
        simulation.judge.verdict()       # the ground truth, for the report and the tests

Import it as `toolee_robot.sim_backend`.
"""

if __name__ != "toolee_robot.sim_backend":
    raise ImportError("import toolee_robot.sim_backend: the short name would make a second copy of every module")

import toolee_robot.sim_backend.quiet  # noqa: F401  (first: it loads pybullet without its greeting)
from toolee_robot.sim_backend.options import InHandOffset, SimOptions
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.sim_backend.world import Sample

__all__ = ["InHandOffset", "Sample", "SimOptions", "SimStation"]

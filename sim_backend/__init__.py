"""The simulated station in pybullet: UR10 and Shadow Hand, work and nail, camera, the person who hands the tool over.

    from toolee_robot.sim_backend import SimOptions, SimStation
    with SimStation.build(sim_station(), seed=0) as simulation:
        task(simulation.station)         # the hardware abstraction: all that a task may touch
        simulation.judge.verdict()       # ground truth, for the report and the tests

Import it as `toolee_robot.sim_backend`.
"""

if __name__ != "toolee_robot.sim_backend":
    raise ImportError("import toolee_robot.sim_backend: the short name would create a second copy of every module")


from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from toolee_robot.sim_backend.options import InHandOffset, SimOptions
    from toolee_robot.sim_backend.station import SimStation
    from toolee_robot.sim_backend.world import Sample

__all__ = ["InHandOffset", "Sample", "SimOptions", "SimStation"]

_HOMES = {"InHandOffset": "options", "Sample": "world", "SimOptions": "options", "SimStation": "station"}


def __getattr__(name: str) -> object:
    """Load a public name on first use: the process of the controller stand-in needs no pybullet and no meshes."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)

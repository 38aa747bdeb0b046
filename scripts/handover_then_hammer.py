"""The whole job in Python: a simulated station, the camera's perception, one hammer, one nail.

Example: `python scripts/handover_then_hammer.py --seed 7`
"""

import tyro

from toolee_robot.perception import ToolPerception
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.station import sim_station
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tasks.hammering.task import HammeringTask


def main(seed: int = 0, gui: bool = False) -> None:
    """Run the job.

    Args:
        seed: Another hammer, grasp and room.
        gui: Show pybullet's window.
    """
    config, perception = sim_station(), ToolPerception.load()
    with SimStation.build(config, seed, SimOptions(gui=gui)) as sim:
        result = HammeringTask(sim.station, perception, config, nominal_grasp(sim.tool, config)).run()
        print(f"{result.outcome}: {result.reason} ({len(result.strikes)} strikes)")
        print(sim.judge.verdict(result.estimates))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)

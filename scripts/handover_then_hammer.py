"""The whole job in Python: a simulated station, the camera's perception, one hammer, one nail.
Example: `python scripts/handover_then_hammer.py --seed 7`"""

import numpy as np
import tyro

from toolee_robot.config import StationConfig
from toolee_robot.perception import ToolPerception
from toolee_robot.robots import nominal_X_hand_tool
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.tasks.hammering import Grasp, HammeringTask
from toolee_robot.types import Category


def main(seed: int = 0, gui: bool = False) -> None:
    """Run the job.

    Args:
        seed: Another hammer, grasp and room.
        gui: Show pybullet's window.
    """
    config, perception = StationConfig(), ToolPerception.load()
    with SimStation.build(config, seed, SimOptions(gui=gui)) as sim:
        tool = sim.tool
        X_hand_tool = nominal_X_hand_tool(float(np.mean(tool.handle.radii_at(0.0))))
        grasp = Grasp(X_hand_tool, tool.ee(Category.HAMMER_HEAD).X_tool_ee, tool.mass, tool.center_of_mass)
        result = HammeringTask(sim.station, perception, config, grasp).run()
        print(f"{result.outcome}: {result.reason} ({len(result.blows)} blows)")
        print(sim.judge.verdict(result.estimates))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)

"""Drive a nail with a hammer known from its data sheet alone: `python -m examples.new_hammer`."""

import numpy as np

from toolee_robot import HammeringTask, StationConfig, ToolPerception, open_station
from toolee_robot.frames import frame_from_axes
from toolee_robot.hal import Station
from toolee_robot.robots import hand_model
from toolee_robot.sim_backend import SimOptions
from toolee_robot.station import sim_station
from toolee_robot.tasks.common.outcome import HammerResult
from toolee_robot.tasks.hammering.grasp import Grasp
from toolee_robot.tools import ToolKind, make_tool

# Measured with a ruler and scales. The `tool` frame: origin where the hand holds the handle, z towards the head, x to
# the side of the face, which is 260 mm up the handle and 53 mm out.
HANDLE_RADIUS = 0.015  # [m]
X_TOOL_FACE = frame_from_axes(z=np.array([1.0, 0.0, 0.0]), x=np.array([0.0, 0.0, -1.0]), p=[0.053, 0.0, 0.260])
MASS = 0.50  # [kg]
CENTER_OF_MASS = np.array([0.0, 0.0, 0.155])  # [m]


def drive_nail(station: Station, perception: ToolPerception, config: StationConfig) -> HammerResult:
    """The job with this hammer, on any station."""
    X_hand_tool = hand_model(config.hand).grasp.X_hand_tool(HANDLE_RADIUS)
    grasp = Grasp(X_hand_tool, X_TOOL_FACE, MASS, CENTER_OF_MASS)
    return HammeringTask(station, perception, config, grasp).run()


if __name__ == "__main__":
    config = sim_station()
    hammer = make_tool(ToolKind.BALL_PEEN_HAMMER, 9)  # what the simulated person hands over
    with open_station(config, options=SimOptions(tool=hammer)) as simulated:
        print(drive_nail(simulated.station, ToolPerception.load(), config).reason)

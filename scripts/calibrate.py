"""A camera's calibration in Python: a simulated lab, views of a printed board on the flange, the solution, its error.

Example: `python scripts/calibrate.py --seed 7`

`toolee calibrate` calibrates a lab: camera, tip and nail, with a record.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import tyro

from toolee_robot.calibration.board import SHEETS
from toolee_robot.calibration.hand_eye.solve import calibrate
from toolee_robot.calibration.session import observe
from toolee_robot.control import RobotModel
from toolee_robot.station import sim_station
from toolee_robot.stations.simulated import simulated_board
from toolee_robot.tasks.calibration.collect import Collector, save, session_of
from toolee_robot.tasks.calibration.views import plan_views


def main(seed: int = 0, poses: int = 15, sheet: str = "a3") -> None:
    """Calibrate the simulated camera.

    Args:
        seed: Another place of the board on the flange, scale of the print and noise.
        poses: Number of views.
        sheet: Size of the printed board's sheet.
    """
    lab = simulated_board(sim_station(), SHEETS[sheet], distance=0.12, mass=1.2, seed=seed)
    robot, board = RobotModel.of_station(lab.measured), lab.plate.board
    with TemporaryDirectory() as folder, lab.build(seed) as sim:
        views = plan_views(robot, lab.measured, lab.plate, poses, seed)
        collector = Collector(sim.station, lab.measured, robot, board, print)
        session = session_of(sim.station, [save(Path(folder), view) for view in collector.take_all(views)])
        seen = observe(Path(folder), session, board, robot.arm.fk)
    expected = lab.measured.camera.X_base_camera[:3, 3]  # by tape: it tells a half turn of the base
    calibration = calibrate(seen.observations, board, session.intrinsics, expected=expected)
    off = (calibration.X_base_camera - lab.true.camera.X_base_camera) @ [*calibration.target, 1.0]
    print(f"X_base_camera, from {len(seen.observations)} views:\n{np.round(calibration.X_base_camera, 5)}")
    print(f"off by {np.linalg.norm(off) * 1e3:.2f} mm at {calibration.target[2]:.2f} m (the simulation knows)")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)

"""Swings planned for random nails and in-hand offsets: speed, effective mass, energy, planning time.

    python -m benchmarks.swing --model UR10e --draws 50

Nothing is moved. Exit code 1: a median planning time misses its target.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control import CollisionWorld, RobotModel, plan_strike
from toolee_robot.control.arm_dynamics import ArmDynamics
from toolee_robot.control.planning.swing_problem import Face
from toolee_robot.errors import PlanningError
from toolee_robot.sim_backend.devices.operator import handed_over
from toolee_robot.sim_backend.options import InHandOffset
from toolee_robot.station import StationConfig, sim_station
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tools import ToolKind, make_tool, test_seeds
from toolee_robot.types import ArmModel

DEPTHS = (0.010, 0.020, 0.100)
"""Places beyond the contact within which the command turns back [m]."""
_LONGEST_MS = 150.0
"""Largest median planning time of a swing that is asked for, of processor time [ms]."""


@dataclass(frozen=True)
class Strike:
    """A planned strike at one nail.

    Attributes:
        speed: Speed of the face at the contact [m/s].
        effective_mass: Mass that strikes if arm, hand and grip were rigid [kg].
        torque: Largest ratio of a joint's torque to its rated one.
        planning_ms: Processor time of the planning [ms].
    """

    speed: float
    effective_mass: float
    torque: float
    planning_ms: float

    @property
    def energy(self) -> float:
        """Kinetic energy along the nail's axis [J]."""
        return 0.5 * self.effective_mass * self.speed**2


def planned(base: StationConfig, draws: int, seed: int) -> list[Strike]:
    """Plan strikes at random nails, each with its own in-hand offset of one claw hammer; those that can be planned."""
    robot, rng = RobotModel.of_station(base), np.random.default_rng(seed)
    q_hand, home = robot.description.hand_closed, np.array(base.scene.home)
    tool = make_tool(ToolKind.CLAW_HAMMER, test_seeds(1)[0])
    grasp = nominal_grasp(tool, base)
    strikes: list[Strike] = []
    for _ in range(draws):
        xy = (float(rng.uniform(0.55, 0.95)), float(rng.uniform(-0.30, 0.45)))
        X_hand_ee = handed_over(grasp.X_hand_tool, InHandOffset.draw(rng)) @ grasp.X_tool_ee
        config = replace(base, work=replace(base.work, nail_xy=xy))
        X_base_nail = config.work.X_base_nail(float(rng.uniform(0.0, 0.02)))
        world = CollisionWorld(robot, config, q_hand, X_hand_ee)
        began = time.process_time()
        state = home, q_hand, X_hand_ee, X_base_nail
        try:
            plan = plan_strike(robot, config, world, *state, tool=grasp.swung, speed=np.inf)
        except PlanningError:
            continue
        milliseconds = 1e3 * (time.process_time() - began)
        dynamics = ArmDynamics(robot, q_hand, X_hand_ee, grasp.swung)
        face = Face.build(robot.arm, robot.X_flange_hand(q_hand) @ X_hand_ee, X_base_nail)
        along = face.place(plan.q_contact[None])[1][0, 2]
        # 1 / (J M^-1 J^T): Khatib, "Inertial properties in robotic manipulation", 1995.
        mass = float(1.0 / (along @ np.linalg.solve(dynamics.at_rest(plan.q_contact)[0], along)))
        torques = dynamics.torques(plan.strike.q, plan.strike.qd, plan.strike.qdd)
        torque = float(np.max(np.abs(torques) / ARM_DATA[base.arm.model].torque))
        strikes.append(Strike(plan.speed, mass, torque, milliseconds))
    return strikes


def main(arguments: Sequence[str] | None = None) -> int:
    """Plan and print: medians, and of the speed the 5th percentile."""
    limits = sim_station()
    parser = argparse.ArgumentParser(prog="python -m benchmarks.swing", description="Plan swings.")
    parser.add_argument("--model", type=ArmModel, choices=list(ArmModel), default=ArmModel.UR10)
    parser.add_argument("--draws", type=int, default=50, help="nails, each with its own in-hand offset")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--acceleration", type=float, nargs="+", default=[min(limits.arm.acceleration)], help="of every joint, rad/s^2"
    )
    parser.add_argument("--jerk", type=float, default=limits.arm.jerk, help="of every joint, rad/s^3")
    parser.add_argument(
        "--station-speed", type=float, default=limits.supervisor.unattended_speed, help="of any point, m/s"
    )
    asked = parser.parse_args(arguments)
    slowest = 0.0
    for acceleration in asked.acceleration:
        for deepest in DEPTHS:
            base = replace(
                limits,
                arm=replace(limits.arm, model=asked.model, acceleration=(acceleration,) * 6, jerk=asked.jerk),
                supervisor=replace(limits.supervisor, unattended_speed=asked.station_speed),
                strike=replace(limits.strike, deepest=deepest),
            )
            found = planned(base, asked.draws, asked.seed)
            what = f"{acceleration:g} rad/s^2, {1e3 * deepest:.0f} mm"
            if not found:
                print(f"{what}: no plan")
                continue
            low, speed = np.percentile([s.speed for s in found], [5, 50])
            mass, energy = np.median([(s.effective_mass, s.energy) for s in found], axis=0)
            wall = float(np.median([s.planning_ms for s in found]))
            slowest = max(slowest, wall)
            print(
                f"{what}: {len(found)} of {asked.draws}, {speed:.2f} m/s (5 %: {low:.2f}), {mass:.1f} kg, "
                f"{energy:.2f} J, torque at most {max(s.torque for s in found):.2f} of the rated one, planned in "
                f"{wall:.0f} ms of processor time",
                flush=True,
            )
    return int(slowest >= _LONGEST_MS)


if __name__ == "__main__":
    sys.exit(main())

"""Swings against straight strikes, planned for random nails and in-hand offsets: speed, mass, energy, planning time.

    python -m benchmarks.swing --model UR10e --draws 50

Nothing is moved. Exit code 1: a median planning time misses its target.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control import CollisionWorld, RobotModel, StrikePlan, plan_strike
from toolee_robot.control.arm_dynamics import ArmDynamics
from toolee_robot.control.planning.swing import plan_swing
from toolee_robot.control.planning.swing_problem import Face, SwingLimits
from toolee_robot.control.planning.timing import ramp_length
from toolee_robot.errors import PlanningError
from toolee_robot.frames import Array
from toolee_robot.sim_backend.devices.operator import handed_over
from toolee_robot.sim_backend.options import InHandOffset
from toolee_robot.station import sim_station
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tools import ToolKind, make_tool, test_seeds
from toolee_robot.types import ArmModel

STRAIGHT, STRAIGHT_BOUND = "line", "line 10 mm"
SWING, SWING_BOUND = "swing", "swing 10 mm"
"""Kinds of strikes: straight and swing, each without and with a bound of 10 mm beyond the contact."""
KINDS = (STRAIGHT, SWING, STRAIGHT_BOUND, SWING_BOUND)
DEEPEST = 0.010
_LONGEST_MS = 300.0
"""Largest median planning time of a swing that is asked for."""


@dataclass(frozen=True)
class Strike:
    """A planned strike at one nail.

    Attributes:
        kind: One of `KINDS`.
        nail: Number of the nail.
        speed: Speed of the face at the contact [m/s]; 0 without a plan.
        effective_mass: Mass that strikes if arm, hand and grip were rigid [kg].
        depth: Deepest place of the command beyond the contact [m].
        torque: Largest ratio of a joint's torque to its rated one.
        planning_ms: Planning time [ms]; of a bound straight line that of the unbound one.
        cpu_ms: Processor time of this process in it [ms].
        code: Error code without a plan.
    """

    kind: str
    nail: int
    speed: float = 0.0
    effective_mass: float = 0.0
    depth: float = 0.0
    torque: float = 0.0
    planning_ms: float = 0.0
    cpu_ms: float = 0.0
    code: str = ""

    @property
    def energy(self) -> float:
        """Kinetic energy along the nail's axis [J]."""
        return 0.5 * self.effective_mass * self.speed**2


def compare(
    model: ArmModel, draws: int, seed: int, acceleration: float, jerk: float, station_speed: float
) -> list[Strike]:
    """Plan every kind of strike for random nails, each with its own in-hand offset of one claw hammer."""
    base = sim_station()
    base = replace(
        base,
        arm=replace(base.arm, model=model, acceleration=acceleration, jerk=jerk),
        supervisor=replace(base.supervisor, unattended_speed=station_speed),
    )
    robot, rng = RobotModel.of_station(base), np.random.default_rng(seed)
    q_hand, home = robot.description.hand_closed, np.array(base.scene.home)
    tool = make_tool(ToolKind.CLAW_HAMMER, test_seeds(1)[0])
    grasp = nominal_grasp(tool, base)
    held = grasp.swung
    strikes: list[Strike] = []
    for nail in range(draws):
        xy = (float(rng.uniform(0.55, 0.95)), float(rng.uniform(-0.30, 0.45)))
        X_hand_ee = handed_over(grasp.X_hand_tool, InHandOffset.draw(rng)) @ grasp.X_tool_ee
        X_base_nail = base.work.X_base_nail(float(rng.uniform(0.0, 0.04)))
        X_base_nail[:2, 3] = xy
        config = replace(base, work=replace(base.work, nail_xy=xy))
        world = CollisionWorld(robot, config, q_hand, X_hand_ee)
        args = (robot, config, world, home, q_hand, X_hand_ee, X_base_nail)

        def swing(deepest: float, args: tuple = args) -> StrikePlan:  # type: ignore[type-arg]
            return plan_swing(*args, speed=np.inf, limits=SwingLimits(held, deepest))

        def straight(args: tuple = args) -> StrikePlan:  # type: ignore[type-arg]
            return plan_strike(*args, tool=held, speed=0.99 * station_speed)

        dynamics = ArmDynamics(robot, q_hand, X_hand_ee, held)
        face = Face.build(robot.arm, robot.X_flange_hand(q_hand) @ X_hand_ee, X_base_nail)
        rated = np.array(ARM_DATA[model].torque)
        strikes += _plan(STRAIGHT, nail, straight, dynamics, face, rated)
        strikes += _plan(SWING, nail, lambda: swing(np.inf), dynamics, face, rated)
        strikes += _plan(SWING_BOUND, nail, lambda: swing(DEEPEST), dynamics, face, rated)
    return strikes


def _plan(
    kind: str, nail: int, planner: Callable[[], StrikePlan], dynamics: ArmDynamics, face: Face, rated: Array
) -> Iterator[Strike]:
    began, cpu = time.perf_counter(), time.process_time()
    try:
        plan = planner()
    except PlanningError as error:
        yield Strike(kind, nail, code=error.code)
        return
    elapsed, cpu = 1e3 * (time.perf_counter() - began), 1e3 * (time.process_time() - cpu)
    strike = plan.strike
    along = face.place(plan.q_contact[None])[1][0, 2]
    # 1 / (J M^-1 J^T): Khatib, "Inertial properties in robotic manipulation", 1995.
    mass = float(1.0 / (along @ np.linalg.solve(dynamics.at_rest(plan.q_contact)[0], along)))
    torque = float(np.max(np.abs(dynamics.torques(strike.q, strike.qd, strike.qdd)) / rated))
    yield Strike(kind, nail, plan.speed, mass, plan.brake_length, torque, elapsed, cpu)
    if kind == STRAIGHT:
        v = _bound_speed(plan, face)
        yield Strike(STRAIGHT_BOUND, nail, v, mass, DEEPEST, torque, elapsed, cpu)


def _bound_speed(plan: StrikePlan, face: Face) -> float:
    """Speed from which the straight strike, which brakes from the contact on, stops within DEEPEST [m/s].

    Deceleration and jerk along the line are those of the plan.
    """
    strike = plan.strike
    after = strike.times >= plan.contact_time - 1e-9
    s = face.place(strike.q[after])[0][:, 2]
    t = strike.times[after]
    v = np.gradient(s, t)
    a = np.gradient(v, t)
    jerk = float(np.max(np.abs(np.gradient(a, t))[2:-2]))
    speeds = np.linspace(0.01, plan.speed, 400)
    stops = ramp_length(speeds, float(np.max(np.abs(a))), jerk) <= DEEPEST
    return float(np.max(speeds[stops], initial=0.01))


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare and print: medians, and of speed and energy the 5th percentile."""
    limits = sim_station()
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.swing", description="Compare swings with straight lines."
    )
    parser.add_argument("--model", type=ArmModel, choices=list(ArmModel), default=ArmModel.UR10)
    parser.add_argument("--draws", type=int, default=50, help="nails, each with its own in-hand offset")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--acceleration", type=float, default=limits.arm.acceleration, help="of every joint, rad/s^2")
    parser.add_argument("--jerk", type=float, default=limits.arm.jerk, help="of every joint, rad/s^3")
    parser.add_argument(
        "--station-speed", type=float, default=limits.supervisor.unattended_speed, help="of any point, m/s"
    )
    asked = parser.parse_args(arguments)
    strikes = compare(asked.model, asked.draws, asked.seed, asked.acceleration, asked.jerk, asked.station_speed)
    slowest = 0.0
    for kind in KINDS:
        found = [s for s in strikes if s.kind == kind and s.speed > 0]
        if not found:
            print(f"{kind}: no plan")
            continue
        low, speed = np.percentile([s.speed for s in found], [5, 50])
        mass, energy, depth = np.median([(s.effective_mass, s.energy, s.depth) for s in found], axis=0)
        wall, cpu = np.median([(s.planning_ms, s.cpu_ms) for s in found], axis=0)
        slowest = max(slowest, wall) if kind.startswith(SWING) else slowest
        print(f"{kind}: {len(found)} of {asked.draws}, {speed:.2f} m/s (5 %: {low:.2f}), {mass:.1f} kg, {energy:.2f} J")
        print(f"  {1e3 * depth:.0f} mm deep, torque {max(s.torque for s in found):.2f} of the rated one")
        print(f"  planned in {wall:.0f} ms, {cpu:.0f} ms of processor time")
    return int(slowest >= _LONGEST_MS)


if __name__ == "__main__":
    sys.exit(main())

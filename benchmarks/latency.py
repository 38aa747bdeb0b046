"""Latencies of perception and planning, and the simulation's speed, on this machine: medians and 90th percentiles.

    python -m benchmarks.latency

One call at a time, as on the robot, after calls that do not count. Poses come from the ground truth.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import cycle

import numpy as np
import torch

from toolee_robot.control import CollisionWorld, RobotModel, plan_strike
from toolee_robot.end_effectors import Category
from toolee_robot.errors import PlanningError
from toolee_robot.frames import Array
from toolee_robot.perception import ToolPerception
from toolee_robot.perception.cloud import ee_cloud
from toolee_robot.perception.precision import prefers_bfloat16
from toolee_robot.sim_backend.devices.operator import handed_over
from toolee_robot.sim_backend.options import InHandOffset
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.station import StationConfig, sim_station
from toolee_robot.tasks.common.held_tool import held_region
from toolee_robot.tasks.common.look import largest_displacement
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.hammering.grasp import Grasp, nominal_grasp
from toolee_robot.tasks.hammering.task import HammeringTask
from toolee_robot.types import HoldingHand, RgbdFrame, ToolEstimate

CANDIDATES = (1, 5, 10, 20, 32, 50)
SEED = 100
WARM_UP = 2  # calls that do not count


class _SeenEnough(Exception):
    """Ends the job at its first frame."""


class _FirstFrame(TaskObserver):
    def frame(self, frame: RgbdFrame, estimates: list[ToolEstimate], X_camera_hand: Array) -> None:  # noqa: ARG002
        self.seen = (frame, X_camera_hand)
        raise _SeenEnough


def show(name: str, call: Callable[[], object], repeats: int, target_ms: float | None = None) -> None:
    """Print the latency of a call, and whether its median is under the target."""
    times = []
    for k in range(WARM_UP + repeats):
        start = time.perf_counter()
        call()
        if k >= WARM_UP:
            times.append((time.perf_counter() - start) * 1e3)
    median, p90 = np.percentile(times, [50, 90])
    verdict = "" if target_ms is None else f", {'met' if median < target_ms else 'MISSED'}: under {target_ms:.0f} ms"
    print(f"{name}: {median:.2f} ms, 90 % {p90:.2f} ms{verdict}")


def perception(frame: RgbdFrame, hand: HoldingHand, grasp: Grasp, config: StationConfig, repeats: int) -> None:
    """Measure the networks on the job's first frame."""
    networks = ToolPerception.load()
    detector, pose = networks.detector, networks.pose
    show(f"segmentation ({frame.intrinsics.width}x{frame.intrinsics.height})", lambda: detector.detect(frame), repeats)
    usable = [(d, c) for d in detector.detect(frame) if (c := ee_cloud(frame, d)).usable]
    detection, cloud = next((u for u in usable if u[0].category is Category.HAMMER_HEAD), usable[0])
    show("cloud, one end effector", lambda: ee_cloud(frame, detection), repeats)
    for k in CANDIDATES:
        call = partial(
            pose.estimate, cloud.points, detection.category, cloud.rest, hand, candidates=k, completed=cloud.completed
        )
        show(f"pose, K = {k}", call, repeats, 15.0 if k == pose.candidates else None)
    show(
        f"perception, whole image ({len(usable)} end effectors)", lambda: networks.estimate(frame, hand), repeats, 350.0
    )
    near = replace(hand, region=held_region(config, grasp.X_hand_ee, largest_displacement(grasp.X_hand_ee)))
    target = 100.0 if prefers_bfloat16(torch.device("cpu")) else 150.0
    show("perception about the hand, as in a job", lambda: networks.estimate(frame, near), repeats, target)


def planning(sim: SimStation, robot: RobotModel, grasp: Grasp, config: StationConfig, repeats: int) -> None:
    """Measure inverse kinematics and strike plans, each with another in-hand offset."""
    q, q_hand = sim.station.arm.state().q_commanded, sim.station.hand.state().joints.q
    target, rng = robot.fk(q, q_hand)[0], np.random.default_rng(0)
    drawn = (handed_over(grasp.X_hand_tool, InHandOffset.draw(rng)) @ grasp.X_tool_ee for _ in range(repeats))
    grasps = cycle(list(drawn))

    def plan() -> None:
        X_hand_ee = next(grasps)
        with suppress(PlanningError):
            world = CollisionWorld(robot, config, q_hand, X_hand_ee)
            plan_strike(robot, config, world, q, q_hand, X_hand_ee, config.work.X_base_nail(), tool=grasp.swung)

    show("inverse kinematics, all branches", lambda: robot.ik.solve(target), 10 * repeats)
    show("strike plan", plan, repeats, 100.0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Hand a hammer over, stop the job at its first frame, and measure there."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.latency", description="Measure latencies.")
    parser.add_argument("--repeats", type=int, default=20, help="calls per measurement")
    repeats = parser.parse_args(arguments).repeats
    print(f"torch on {torch.get_num_threads()} threads, {torch.backends.cpu.get_cpu_capability()}")
    config, observer = sim_station(), _FirstFrame()
    with SimStation.build(config, SEED) as sim:
        grasp = nominal_grasp(sim.tool, config)
        with suppress(_SeenEnough):
            HammeringTask(sim.station, PerfectPerception(sim.judge), config, grasp, observer=observer).run()
        frame, X_camera_hand = observer.seen
        robot = RobotModel.of_station(config)
        perception(frame, HoldingHand(X_camera_hand, robot.description.hand.grasp.R_hand_tool), grasp, config, repeats)
        planning(sim, robot, grasp, config, repeats)
        start = time.perf_counter()
        sim.station.clock.sleep(2.0)
        print(f"simulation with the hammer held: {2.0 / (time.perf_counter() - start):.2f} x real time")


if __name__ == "__main__":
    main()

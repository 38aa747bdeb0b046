"""Scene of the benchmark: a hammer in the hand in front of the simulated camera, as in a job."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np

from toolee_robot.control import CollisionWorld, RobotModel, StrikePlan, plan_strike
from toolee_robot.errors import PlanningError, TooleeError
from toolee_robot.frames import Array
from toolee_robot.sim_backend.devices.operator import handed_over
from toolee_robot.sim_backend.ground_truth.perception import PerfectPerception
from toolee_robot.sim_backend.options import InHandOffset
from toolee_robot.sim_backend.station import SimStation
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.held_region import held_region
from toolee_robot.tasks.common.look import largest_displacement
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.hammering.grasp import Grasp, nominal_grasp
from toolee_robot.tasks.hammering.task import HammeringTask
from toolee_robot.types import RgbdFrame, ToolEstimate


class _SeenEnough(Exception):
    """Ends the job at its first frame."""


class _FirstFrame(TaskObserver):
    def __init__(self) -> None:
        self.seen: tuple[RgbdFrame, Array] | None = None

    def frame(self, frame: RgbdFrame, estimates: list[ToolEstimate], X_camera_hand: Array) -> None:  # noqa: ARG002
        self.seen = (frame, X_camera_hand)
        raise _SeenEnough


class BenchScene:
    """The station after the handover, at the first view.

    Args:
        sim: The simulated station.
        config: Its configuration.
        grasp: Nominal grasp of the hammer.
        frame: Frame of the first view.
        X: Pose of the hand in the camera frame, (4, 4).
    """

    def __init__(self, sim: SimStation, config: StationConfig, grasp: Grasp, frame: RgbdFrame, X: Array) -> None:
        self._sim, self._config, self._grasp = sim, config, grasp
        self.frame, self.X_camera_hand = frame, X
        self.robot = RobotModel.of_station(config)
        self.q_arm = sim.station.arm.state().q_commanded
        self.q_hand = sim.station.hand.state().joints.q
        self.region = held_region(config, grasp.X_hand_ee, largest_displacement(grasp.X_hand_ee))

    def random_grasps(self, n: int) -> list[Array]:
        """Draw n poses of the end effector in the hand, (4, 4), as handed over by people."""
        rng = np.random.default_rng(0)
        nominal, X_tool_ee = self._grasp.X_hand_tool, self._grasp.X_tool_ee
        return [handed_over(nominal, InHandOffset.draw(rng)) @ X_tool_ee for _ in range(n)]

    def plan(self, X_hand_ee: Array) -> StrikePlan | None:
        """Plan a strike with a pose of the end effector in the hand, (4, 4); None where there is no plan."""
        with suppress(PlanningError):
            world = CollisionWorld(self.robot, self._config, self.q_hand, X_hand_ee)
            state = self.q_arm, self.q_hand, X_hand_ee, self._config.work.X_base_nail()
            return plan_strike(self.robot, self._config, world, *state, tool=self._grasp.swung)
        return None

    def simulation_speed(self, seconds: float = 2.0) -> float:
        """Measure the real-time factor of the simulation at standstill with the hammer held, over `seconds`."""
        start = time.perf_counter()
        self._sim.station.clock.sleep(seconds)
        return seconds / (time.perf_counter() - start)


@contextmanager
def bench_scene(seed: int) -> Iterator[BenchScene]:
    """Context of a job stopped at its first frame; poses come from the ground truth, since only times are measured.

    Args:
        seed: Seed of the simulated station.

    Yields:
        The scene.

    Raises:
        TooleeError: The job ended before its first frame.
    """
    config, observer = StationConfig(), _FirstFrame()
    with SimStation.build(config, seed) as sim:
        grasp = nominal_grasp(sim.tool, config)
        task = HammeringTask(sim.station, PerfectPerception(sim.judge), config, grasp, observer=observer)
        with suppress(_SeenEnough):
            ended = task.run()
        if observer.seen is None:
            raise TooleeError(
                f"the benchmark's job ended before its first frame: {ended.reason}", code="toolee.bench_job_ended"
            )
        yield BenchScene(sim, config, grasp, *observer.seen)

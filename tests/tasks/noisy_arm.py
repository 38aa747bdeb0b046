"""A simulated arm whose force has a CB3's errors, and what it touches with."""

from __future__ import annotations

import numpy as np

from tests.rigs.job_rig import CONFIG, Bench
from tests.tasks.bench import Log
from toolee_robot.control import Mode, RobotModel, plan_over_nail, plan_strike
from toolee_robot.frames import inverse
from toolee_robot.sim_backend.devices.flange_sensor import ReadingErrors
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.motions import UP, Motions
from toolee_robot.tasks.hammering.touch import Touch
from toolee_robot.types import ArmModel


class Rig:
    """The face over the nail, which an arm with the errors of a CB3's wrench, times `scale`, touches."""

    def __init__(self, bench: Bench, seed: int, scale: float = 1.0, config: StationConfig = CONFIG) -> None:
        self._world, self._config = bench.sim.world, config
        sensor = bench.arm._sensor
        sensor._errors = ReadingErrors(ArmModel.UR10, scale, seed, sensor.period)
        robot = self._robot = RobotModel.of_station(config)
        bench.hand.close()
        self.log = Log()
        motions = self.motions = Motions(bench.station, config, robot, self.log)
        motions.begin()
        grasp = bench.true_grasp
        self.held = HeldTool.nominally(grasp.X_hand_ee, grasp.swung)
        motions.set_payload(robot.payload(motions.q_hand, grasp.X_hand_tool, grasp.mass, grasp.p_tool_com))
        motions.carry(self.held)
        assert motions.person.hold_switch("", 1.0)
        assert motions.person.request_handover("", 1.0)
        assert motions.person.release("", 1.0)
        motions.arm.mode = Mode.UNATTENDED
        self.touch = Touch(motions, config)
        nail = config.work.X_base_nail(self._world.nail.protrusion)
        state = motions.world(self.held), motions.q, motions.q_hand, grasp.X_hand_ee, nail
        self._plan = plan_strike(robot, config, *state, tool=grasp.swung)

    def go_over(self, over: float) -> None:
        """Go to rest so far over the nail [m], and look where the face is: the tool hangs in the hand."""
        self.back_over(over)
        self._world.advance(0.3)
        self.held = self.held.moved(inverse(self._world.X_base_hand()) @ self._world.X_base_ee())

    def back_over(self, over: float) -> None:
        """Go to rest so far over the nail [m], with the face believed where it was."""
        motions = self.motions
        way = plan_over_nail(self._robot, self._config, motions.world(self.held), motions.q, self._plan, over)
        motions.transfer("over the nail", way, self.held)

    def error(self, over: float) -> float:
        """Touch the nail from so far over it [m]; returns the height's error [m], NaN where nothing was met."""
        self.go_over(over)
        assert self.touch.prepare()
        contact = self.touch.lower("nail", over + 0.010, self.held)
        self.motions.straight("up", UP, 0.010, self.held)
        return np.nan if contact is None else contact.felt - self._world.nail.protrusion

"""The tightening job: take the wrench, look at it, turn the nut stroke by stroke to a torque, park the arm."""

from __future__ import annotations

from dataclasses import replace

from toolee_robot.control.collision_shapes import rotated_box_body
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.end_effectors import Category
from toolee_robot.hal import Station
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.handed_task import Ending, HandedTask
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.look import Look, Perceiver
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import Outcome
from toolee_robot.tasks.hammering.grasp import Grasp
from toolee_robot.tasks.hammering.handover import Handover, Prompts
from toolee_robot.tasks.tightening.records import NutWork, TightenResult
from toolee_robot.tasks.tightening.tightening import Tightening

PROMPTS = Prompts(
    "Put the wrench's grip into the open hand, jaw beyond the thumb, flat side to the palm.",
    "Hold the wrench firmly and confirm. The hand then opens.",
)


class TighteningTask(HandedTask[TightenResult]):
    """One tightening job, from the handover to the parked arm.

    Args:
        station: The devices of the station.
        perceiver: Estimates the wrench's pose from frames; None for the nominal pose in the hand, a baseline.
        config: Configuration of the station.
        grasp: Nominal grasp of the wrench.
        work: The nut.
        observer: Receives the events of the job; None for no observer.
    """

    def __init__(
        self,
        station: Station,
        perceiver: Perceiver | None,
        config: StationConfig,
        grasp: Grasp,
        work: NutWork,
        *,
        observer: TaskObserver | None = None,
    ) -> None:
        motions = Motions(station, config, RobotModel.of_station(config), observer or TaskObserver())
        handover = Handover(motions, grasp, (), PROMPTS)
        super().__init__(motions, handover, "wrench", "goes on turning")
        size = work.across_flats
        bolt = rotated_box_body("bolt", work.X_base_nut, (size, size, 2.0 * size))
        motions.keep_clear_of((replace(bolt, group="nail"),))  # what only the tool may touch
        self._look = None if perceiver is None else Look(motions, perceiver, Category.WRENCH_HEAD)
        self._tightening = Tightening(motions, self._look, work)

    def result(self, outcome: Outcome, reason: str) -> TightenResult:
        """See `HandedTask`."""
        turns, torque = tuple(self._tightening.turns), self._tightening.torque
        return TightenResult(outcome, reason, turns=turns, torque=torque, **self._facts(self._look))

    def _work(self, held: HeldTool, *, resumed: bool) -> Ending:
        if resumed:
            self._tightening.leave(held)
        return self._tightening.tighten(held)

    def _tell_ended(self, result: TightenResult) -> None:
        """Nobody is told: who runs the job has its result."""

    def _leave_work(self, held: HeldTool | None) -> None:
        if held is not None:
            self._tightening.leave(held)
        super()._leave_work(held)

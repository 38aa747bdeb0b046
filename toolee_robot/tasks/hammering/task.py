"""The hammering job: take the tool, look at it, strike until every nail is flush, park the arm.

A state machine over the hardware abstraction. Its inputs are the station file, the camera's frames and the sensors of
arm and hand. Every job ends with an `Outcome` and a reason; every exception leaves the arm at a standstill. A job that
was stopped with the tool in the hand can go on after a person has looked:

    result = task.run()
    while task.resumable and a_person_looked_and_confirmed():
        result = task.resume(confirmed=True)
"""

from __future__ import annotations

from collections.abc import Sequence

from toolee_robot.control.robot_model import RobotModel
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.hal import Station
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.handed_task import Ending, HandedTask
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.look import Look, Perceiver
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import HammerResult, Outcome
from toolee_robot.tasks.hammering.grasp import Grasp
from toolee_robot.tasks.hammering.handover import Handover
from toolee_robot.tasks.hammering.nail_series import NailSeries


class HammeringTask(HandedTask[HammerResult]):
    """One hammering job, from the handover to the parked arm.

    Args:
        station: The devices of the station.
        perceiver: Estimates the tool's pose from frames; usually a `ToolPerception`. None strikes with the nominal pose
            in the hand, which is the paper's baseline, for comparison only.
        config: Configuration of the station.
        grasp: Nominal grasp of the tool that will be handed over.
        observer: Receives the events of the job; None for no observer.
        nails: Names of the nails to drive, in order; None for all of the station.

    Raises:
        UserError: A face of which nothing is known is to be struck with where it nominally is (`user.unknown_face`).
    """

    def __init__(
        self,
        station: Station,
        perceiver: Perceiver | None,
        config: StationConfig,
        grasp: Grasp,
        *,
        observer: TaskObserver | None = None,
        nails: Sequence[str] | None = None,
    ) -> None:
        if grasp.ee_off and perceiver is None:
            raise UserError(
                "the tool's face is unknown, so it cannot strike without a look at it. Give tool.face and "
                "tool.face_normal, or leave --variant no_correction out",
                code="user.unknown_face",
            )
        names = tuple(nails or config.work.names)
        motions = Motions(station, config, RobotModel.of_station(config), observer or TaskObserver())
        self._handover = Handover(motions, grasp, names)
        super().__init__(motions, self._handover, "hammer", "goes on striking")
        self._look = None if perceiver is None else Look(motions, perceiver, Category.HAMMER_HEAD)
        self._nails = NailSeries(motions, self._look, names)

    def result(self, outcome: Outcome, reason: str) -> HammerResult:
        """See `HandedTask`."""
        return HammerResult(
            outcome,
            reason,
            self._nails.strikes,
            self._nails.protrusion,
            nail_seconds=self._nails.seconds,
            nails=self._nails.results(outcome, reason),
            weight=self._handover.weight,
            **self._facts(self._look),
        )

    def _work(self, held: HeldTool, *, resumed: bool) -> Ending:
        return self._nails.drive(held, lift=resumed)

    def _told(self, reason: str) -> str:
        return self._nails.told(reason)

    def _tell_ended(self, result: HammerResult) -> None:
        self._motions.observer.ended(result)

"""What tests ask of the fault matrix's simulated station besides: a full log, and things that happen a little later."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.rigs import job_rig
from tests.rigs.job_rig import HOME, Bench
from toolee_robot.hal import MotionReport
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.world import Sample
from toolee_robot.tasks.common.observer import HandCourse
from toolee_robot.tasks.common.outcome import Stage, Strike


class Log(job_rig.Log):
    """Keeps what was reported of motions, stages and strikes, too."""

    def __init__(
        self, at: dict[Stage, Callable[[], None]] | None = None, after: dict[str, Callable[[], None]] | None = None
    ) -> None:
        super().__init__(at, after)
        self.reports: list[MotionReport] = []
        self.stages: list[tuple[str, Stage]] = []
        self.strikes: list[Strike] = []

    def stage_started(self, stage: Stage) -> None:
        self.stages.append(("begin", stage))
        super().stage_started(stage)

    def stage_ended(self, stage: Stage, seconds: float) -> None:
        assert seconds >= 0.0
        self.stages.append(("end", stage))

    def motion(self, name: str, report: MotionReport, hand: HandCourse) -> None:
        self.reports.append(report)
        super().motion(name, report, hand)

    def strike(self, strike: Strike) -> None:
        self.strikes.append(strike)


def soon(bench: Bench, act: Callable[[], None], delay: float = 0.25) -> Callable[[], None]:
    """A function after whose call `act` happens once, `delay` [s] later, in the midst of whatever moves then."""

    def arm_it() -> None:
        due = bench.sim.world.time + delay

        def watch(sample: Sample) -> None:
            if sample.stamp >= due:
                bench.sim.world.observers.remove(watch)
                act()

        bench.sim.world.observers.append(watch)

    return arm_it


def is_home(sim: SimStation) -> bool:
    """Whether the arm stands where a job ends."""
    return bool(np.abs(sim.world.robot.arm_state()[0] - HOME).max() < 5e-3)


def noting(answer: Callable[[str, float], bool], prompts: list[str]) -> Callable[[str, float], bool]:
    """A person's answer to a prompt, which is noted."""

    def ask(prompt: str, timeout: float) -> bool:
        prompts.append(prompt)
        return answer(prompt, timeout)

    return ask

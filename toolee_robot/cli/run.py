"""Do a job with the real robot. In a job no other command moves a real arm.

Example: toolee run hammer lab.yaml
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from toolee_robot.cli.job_options import VARIANT, JobOptions, OnRobot

if TYPE_CHECKING:
    from toolee_robot.app.sources import Source


@dataclass(frozen=True, kw_only=True)
class RunHammer(JobOptions):
    """Drive a nail with the real robot. The arm moves.

    Every device of the station file is opened by its driver.

    Example: toolee run hammer lab.yaml

    Rehearse it first (`toolee rehearse hammer`). Where the station lists several nails they are driven in its order.

    After a stop with the hammer in the hand a person at the terminal may resume the job, or have the hand opened.

    Exit code 0: every nail is flush; 1: one is not, for the reason given; 2: invalid input; 130: interrupted, the arm
    was stopped.
    """

    station: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STATION")]
    """Your station file, with all that a lab measures: docs/how-to/run_a_job.md."""
    variant: Annotated[OnRobot, VARIANT] = "full"
    """What the job does otherwise than the whole system, as the baselines of docs/how-to/run_trials.md."""

    @property
    def variant_name(self) -> str:
        return self.variant

    def source(self) -> Source:
        from toolee_robot.app.sources import Lab, lab_station

        return Lab(lab_station(self.station, self.setup), self.station)


COMMANDS = {"hammer": RunHammer}

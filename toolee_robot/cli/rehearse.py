"""Rehearse a job with your station file: its drivers run on emulated devices. Nothing real moves.

Example: toolee rehearse hammer rehearsal.yaml
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from toolee_robot.cli.job_options import SEED, VARIANT, InSimulation, JobOptions
from toolee_robot.sim_backend.ur_controller.profile import ProfileName

if TYPE_CHECKING:
    from toolee_robot.app.sources import Source


@dataclass(frozen=True, kw_only=True)
class RehearseHammer(JobOptions):
    """Drive a nail with your drivers on emulated devices.

    The devices are emulated in front of a simulated cell.

    Example: toolee rehearse hammer rehearsal.yaml --seed 3

    Nothing real moves. The hammer, and how far the cell differs from the station file, are the seed's. The minutes to
    expect are printed first.

    Exit code 0: every nail is flush; 1: one is not, for the reason given; 2: invalid input; 130: interrupted.
    """

    station: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STATION")]
    """Your station file, with all that a lab measures: docs/how-to/run_a_job.md."""
    seed: Annotated[int, SEED] = 0
    """Seed of the hammer (none was used in training), the grasp, the noise, and the errors of what the file says."""
    real_time_factor: Annotated[
        float | None, tyro.conf.arg(metavar="0.05..1", help_behavior_hint="(default: UR10 0.25, UR10e 0.1)")
    ] = None
    """Rate of the station's time relative to wall-clock time. 1 is real time, which a busy machine does not sustain."""
    profile: Annotated[ProfileName, tyro.conf.arg(metavar="ideal|harsh")] = "harsh"
    """How the controller follows, measures and stops: exactly, or as one of the arm's generation."""
    variant: Annotated[InSimulation, VARIANT] = "full"
    """What the job does otherwise than the whole system, as the baselines of docs/how-to/run_trials.md."""

    @property
    def variant_name(self) -> str:
        return self.variant

    def source(self) -> Source:
        from toolee_robot.app.simulated import Rehearsal
        from toolee_robot.app.sources import lab_station

        config = lab_station(self.station, self.setup)
        return Rehearsal(config, self.station, self.seed, self.real_time_factor, self.profile)


COMMANDS = {"hammer": RehearseHammer}

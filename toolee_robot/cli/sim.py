"""Do a job in simulation: nothing real moves.

Example: toolee sim hammer --seed 100
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from toolee_robot.cli.job_options import SEED, VARIANT, InSimulation, JobOptions
from toolee_robot.cli.options import Flag
from toolee_robot.errors import UserError
from toolee_robot.sensor_kinds import KINDS, SensorKind
from toolee_robot.types import ArmModel

if TYPE_CHECKING:
    from toolee_robot.app.sources import Source


@dataclass(frozen=True, kw_only=True)
class SimHammer(JobOptions):
    """Take a hammer, look at it, and drive a simulated nail.

    Nothing real moves.

    Example: toolee sim hammer --seed 100

    Example: toolee sim hammer --config examples/nails.yaml --nail left

    Where the station lists several nails they are driven in its order, with the same tool. One that bends, sticks or is
    missed does not keep the next one from being driven.

    Exit code 0: every nail is flush; 1: one is not, for the reason given; 2: invalid input; 130: interrupted.
    """

    seed: Annotated[int, SEED] = 0
    """Seed of the hammer (none was used in training), the grasp and the noise."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """Changes of the simulated station: any subset of the fields in docs/reference/station_file.md."""
    robot: Annotated[Literal["UR10", "UR10e"] | None, tyro.conf.arg(metavar="UR10|UR10e", help_behavior_hint="")] = None
    """Model of the arm, instead of the configured one."""
    errors: Annotated[str, tyro.conf.arg(metavar="nominal|exact|YAML")] = "nominal"
    """Errors of what the job is told: those of a careful person, none, or a file with sizes of some, the others
    nominal: docs/concepts/cell_errors.md."""
    sensor: Annotated[
        SensorKind | None, tyro.conf.arg(metavar="|".join(KINDS), help_behavior_hint="(default: one without those)")
    ] = None
    """Kind of the depth camera, which --seed draws, with a lab's errors: docs/dataset.md."""
    variant: Annotated[InSimulation, VARIANT] = "full"
    """What the job does otherwise than the whole system, as the baselines of docs/how-to/run_trials.md:
    no_correction, perfect_perception, position_only, normal_only, one_view, mask_centroid, icp, paper."""
    gui: Flag = False
    """Show pybullet's window (needs a screen)."""

    @property
    def variant_name(self) -> str:
        return self.variant

    @property
    def answered(self) -> bool:
        return not self.json  # a script that was started at a terminal would wait for an answer

    def source(self) -> Source:
        if self.gui and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
            raise UserError(
                "--gui needs a screen and DISPLAY is not set: leave it out, headless does the same job",
                code="user.no_display",
            )
        from toolee_robot.app.simulated import Simulated, cell_errors, simulated_station

        robot = None if self.robot is None else ArmModel(self.robot)
        config = simulated_station(self.config, self.setup, robot, lambda text: print(text, file=sys.stderr))
        return Simulated(config, self.seed, self.gui, cell_errors(self.errors), self.sensor)


COMMANDS = {"hammer": SimHammer}

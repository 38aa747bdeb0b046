"""`toolee hammer`: the whole job, on a simulated station, a lab's own, or a rehearsal of that."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.errors import UserError
from toolee_robot.runtime.clock import check_real_time_factor, is_loopback
from toolee_robot.runtime.gc_pause import gc_spared
from toolee_robot.runtime.yaml_files import read_record
from toolee_robot.sensor_kinds import KINDS, SensorKind
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.station import StationConfig, load_lab_station, load_station, sim_station, with_setup
from toolee_robot.types import ArmModel

if TYPE_CHECKING:
    from toolee_robot.cli.hammering.sources import Source

WORLD_REAL_TIME_FACTOR = {ArmModel.UR10: 0.25, ArmModel.UR10E: 0.1}
"""Default real-time factors. A cycle then takes 32 and 20 ms, at least twice what the world needs for it in a strike,
so that two busy cores keep the servo's schedule within a real robot's bounds."""

HANDS = {"inspire": "inspire_rh56", "ability": "ability_hand", "shadow": "shadow_right"}
"""What --hand names -> what a station file calls it."""


@dataclass(frozen=True)
class Hammer:
    """Take a hammer from a person, look at it, and drive the nail, or one nail after the other.

    Example: toolee hammer --seed 100 --json

    Example: toolee hammer --station rehearsal.yaml --rehearse

    Example: toolee hammer --station lab.yaml

    Example: toolee hammer --config examples/nails.yaml --nail left

    Without --station the station is simulated. With it, every device of the station file is opened by its driver, and a
    real arm moves; with --rehearse the same drivers meet emulated devices in front of a simulated cell.

    Where the station lists several nails they are driven in its order, with the same tool; one that bends, sticks or is
    missed does not keep the next one from being driven.

    After a stop with the hammer in the hand a person at the terminal may resume the job, or have the hand opened.

    Exit code 0: every nail is flush; 1: one is not, for the reason given; 2: invalid input; 130: interrupted, the arm
    was stopped.
    """

    seed: int = 0
    """Seed of the hammer (none was used in training), the grasp and the noise."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""
    nail: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """Drive this one of several nails (work.nails) alone."""
    no_correction: Flag = False
    """Strike with the nominal pose of the tool in the hand: the baseline."""
    errors: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """Sizes of the errors of what a simulated job is told, others nominal: docs/concepts/cell_errors.md."""
    exact: Flag = False
    """Tell the job exactly where camera and nail are and what the tool is like, instead of what a person measures."""
    sensor: Annotated[
        SensorKind | None, tyro.conf.arg(metavar="|".join(KINDS), help_behavior_hint="(default: one without those)")
    ] = None
    """Kind of the simulated depth camera, which --seed draws, with a lab's errors: docs/dataset.md."""
    station: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """Your own station, with all that a lab must measure: docs/how-to/run_a_job.md."""
    rehearse: Flag = False
    """With --station: emulate every device. The hammer and the errors of what the file says are the seed's."""
    view: Flag = False
    """Show the job on a page of this computer, too: the page of `toolee replay`, live (extra viewer)."""
    arm: Literal["sim", "ur-rtde"] = "sim"
    """The simulated arm itself, or a UR arm through the driver of real ones."""
    robot_host: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="")] = None
    """Address of the UR controller, with --arm ur-rtde; with --world a loopback address for the stand-in."""
    world: Annotated[Literal["pybullet"] | None, tyro.conf.arg(metavar="pybullet", help_behavior_hint="")] = None
    """Start a stand-in of the UR controller, with the simulated station as its world."""
    real_time_factor: Annotated[
        float | None, tyro.conf.arg(metavar="0.05..1", help_behavior_hint="(default: UR10 0.25, UR10e 0.1)")
    ] = None
    """With --world or --rehearse: rate of the station's time relative to wall-clock time. 1 is real time, which a busy
    machine does not sustain."""
    controller_profile: Annotated[
        ProfileName | None,
        tyro.conf.arg(
            name="controller-profile",
            aliases=["--profile"],
            metavar="ideal|harsh",
            help_behavior_hint="(default: ideal with --world, harsh with --rehearse)",
        ),
    ] = None
    """With --world or --rehearse: how the controller follows, measures and stops: exactly, or as one of the arm's
    generation."""
    robot: Annotated[Literal["UR10", "UR10e"] | None, tyro.conf.arg(metavar="UR10|UR10e", help_behavior_hint="")] = None
    """Model of the arm, instead of the configured one."""
    hand: Annotated[
        Literal["inspire", "ability", "shadow"] | None,
        tyro.conf.arg(metavar="inspire|ability|shadow", help_behavior_hint=""),
    ] = None
    """The hand of the station file by its own driver, over its wire; an emulated hand, which feels what the
    simulated one touches, is at its other end. Needs a --config with that hand."""
    hand_port: Annotated[str | None, tyro.conf.arg(metavar="PORT", help_behavior_hint="")] = None
    """With --hand: the port of a hand that `toolee emulate hand` emulates, which feels its own --handle instead."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """Changes of the simulated station: any subset of the fields in docs/reference/station_file.md."""
    setup: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """What is set up for this job instead of what the station file says: `tool`, and of `work` the nail's sizes and the
    wood's specific gravity."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs")
    """Parent of the run's folder, which holds summary.json, recording.mcap and picture.png."""
    device: Annotated[str, tyro.conf.arg(metavar="DEVICE")] = "cpu"
    """Where the networks run: cpu or cuda."""
    gui: Flag = False
    """Show pybullet's window (needs a screen)."""
    perfect_perception: Flag = False
    """For tests and ablations only: poses from the simulation's ground truth instead of the camera."""
    ablation: Annotated[
        Literal["position_only", "normal_only", "one_view", "mask_centroid", "icp", "paper", "learnt_grasp"] | None,
        tyro.conf.arg(
            metavar="position_only|normal_only|one_view|mask_centroid|icp|paper|learnt_grasp", help_behavior_hint=""
        ),
    ] = None
    """For trials only: believe only the estimated position, or orientation, of the face; look once only; or take for
    the face's pose the mask's centroid, a registration of the tool's own shape (ICP), what the paper's estimator says,
    or where the hand has moved earlier tools in the mean."""
    paper_weights: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """With --ablation paper: the folder of its training, which docs/how-to/run_trials.md tells."""
    learnt_from: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """With --ablation learnt_grasp: the folder of earlier jobs with this hand, ten or more."""

    def run(self) -> int:
        if not 0 <= self.seed < 2**31:
            raise UserError(f"--seed {self.seed}: give a whole number from 0 to {2**31 - 1}", code="user.seed")
        if self.gui and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
            raise UserError(
                "--gui needs a screen and DISPLAY is not set: leave it out, headless does the same job",
                code="user.no_display",
            )
        if self.ablation is not None and (self.perfect_perception or self.no_correction):
            raise UserError(
                "--ablation with --perfect-perception or --no-correction: there is no perception to leave a part out",
                code="user.option",
            )
        self._check_paper()
        if (self.ablation == "learnt_grasp") != (self.learnt_from is not None):
            raise UserError(
                "--ablation learnt_grasp and --learnt-from DIR, the folder of earlier jobs, go together: give both or "
                "none",
                code="user.option",
            )
        if self.perfect_perception and self.no_correction:
            raise UserError(
                "--perfect-perception with --no-correction changes nothing: leave one out", code="user.option"
            )
        console = Console(stderr=self.json, highlight=False)
        # Only somebody at a terminal can have looked at the robot. With --json a simulated one asks nobody: a script
        # that was started there would wait for an answer.
        interactive = (not self.json or self.station is not None) and console.is_terminal and sys.stdin.isatty()
        with gc_spared():
            source = self._simulated() if self.station is None else self._own(self.station)
            nails = self._nails(source.config)

            # They take seconds to import: after the checks of the options.
            from toolee_robot.cli.hammering.job import HammerJob
            from toolee_robot.cli.run_folder import run_folder
            from toolee_robot.tasks.hammering.ablation import Ablation

        name = "job" if self.station is not None and not self.rehearse else f"seed{self.seed}"
        with run_folder(self.out, name) as folder:
            console.print("[dim]loading the networks and building the station[/dim]")
            ask = (lambda question: console.input(question, markup=False)) if interactive else None
            job = HammerJob(
                source, correction=not self.no_correction, perfect_perception=self.perfect_perception, ask=ask,
                view=self.view, nails=nails, device=self.device, paper_weights=self.paper_weights,
                learnt_from=self.learnt_from,
                ablation=None if self.ablation is None else Ablation(self.ablation),
            )  # fmt: skip
            report = job.run(folder.path, console)
            folder.keep()
        console.print(report.panel(folder.path))
        if self.json:
            print(json_line({**report.figures, "run_folder": str(folder.path)}), flush=True)
        return report.exit_code

    def _check_paper(self) -> None:
        if self.ablation != "paper":
            if self.paper_weights is not None:
                raise UserError("--paper-weights without --ablation paper: leave it out", code="user.option")
        elif self.paper_weights is None:
            from toolee_robot.perception.offline.research.paper_training import HOW_TO_TRAIN

            raise UserError(
                "--ablation paper needs --paper-weights DIR, the folder of a training of the paper's estimator, which "
                f"is not shipped:\n{HOW_TO_TRAIN}",
                code="user.no_paper_weights",
            )

    def _nails(self, config: StationConfig) -> tuple[str, ...]:
        """Names of the nails to drive."""
        names = config.work.names
        if self.nail is None:
            return names
        if self.nail not in names:
            raise UserError(
                f"--nail {self.nail}: the station's nails are {', '.join(names)} (work.nails)", code="user.nail"
            )
        return (self.nail,)

    def _simulated(self) -> Source:
        """The simulated station; refuses options that are for a lab's own one."""
        if self.rehearse:
            raise UserError(
                "--rehearse without --station: give the station file that is rehearsed", code="user.no_station"
            )
        config = sim_station() if self.config is None else load_station(self.config)
        if self.setup is not None:
            before, config = config.tool, with_setup(config, self.setup)
            if config.tool is not before:
                raise UserError(
                    f"{self.setup} gives a tool, and a simulated one is drawn from --seed: leave `tool` out",
                    code="user.option",
                )
        if self.robot is not None:
            config = replace(config, arm=replace(config.arm, model=ArmModel(self.robot)))
        address = self._address(config.arm.model)
        self._check_hand(config)

        from toolee_robot.cli.hammering.sources import SimulatedSource
        from toolee_robot.sim_backend.cell_errors import EXACT, NOMINAL, CellErrors
        from toolee_robot.stations.simulated import HandDriver, StandIn

        stand_in = None if address is None else StandIn(*address, self.controller_profile or "ideal")
        hand_driver = None if self.hand is None else HandDriver(self.hand_port)
        if self.sensor is not None and stand_in is not None:
            raise UserError("--sensor with --arm ur-rtde: cannot be tried together yet", code="user.option")
        if self.exact and self.errors is not None:
            raise UserError("--exact with --errors: leave one out", code="user.option")
        errors = EXACT if self.exact else NOMINAL
        if self.errors is not None:
            errors = read_record(self.errors, CellErrors, "list of errors")
        return SimulatedSource(config, self.seed, self.gui, stand_in, hand_driver, errors, self.sensor)

    def _own(self, path: Path) -> Source:
        """A lab's own station, or its rehearsal; refuses options that are for the simulated one."""
        given = {
            "--arm": self.arm != "sim",
            "--robot-host": self.robot_host is not None,
            "--world": self.world is not None,
            "--robot": self.robot is not None,
            "--hand": self.hand is not None,
            "--hand-port": self.hand_port is not None,
            "--config": self.config is not None,
            "--gui": self.gui,
            "--exact": self.exact,
            "--errors": self.errors is not None,
            "--sensor": self.sensor is not None,
        }
        if not self.rehearse:
            given |= {
                "--seed": self.seed != 0,
                "--real-time-factor": self.real_time_factor is not None,
                "--controller-profile": self.controller_profile is not None,
                "--perfect-perception": self.perfect_perception,
            }
        if wrong := [name for name, is_given in given.items() if is_given]:
            raise UserError(
                f"{', '.join(wrong)} with --station: the station file says which devices there are; leave it out"
                + ("" if self.rehearse else ", or add --rehearse"),
                code="user.option",
            )
        config = load_lab_station(path)
        if self.setup is not None:
            config = with_setup(config, self.setup)

        from toolee_robot.cli.hammering.sources import LabSource, RehearsalSource

        if not self.rehearse:
            return LabSource(config, path)
        factor = self._factor(config.arm.model, "127.0.0.1")
        return RehearsalSource(config, path, self.seed, factor, self.controller_profile or "harsh")

    def _factor(self, model: ArmModel, host: str) -> float:
        factor = WORLD_REAL_TIME_FACTOR[model] if self.real_time_factor is None else self.real_time_factor
        check_real_time_factor(factor, host)
        return factor

    def _check_hand(self, config: StationConfig) -> None:
        if self.hand is None:
            if self.hand_port is not None:
                raise UserError("--hand-port without --hand: the simulated hand itself has no port", code="user.option")
            return
        if self.arm != "sim":
            raise UserError(
                "--hand with --arm ur-rtde: the two drivers cannot be tried together yet", code="user.option"
            )
        if config.hand.model != HANDS[self.hand]:
            raise UserError(
                f"--hand {self.hand} needs a station with that hand (hand.model: {HANDS[self.hand]}), such as --config "
                f"examples/{self.hand}.yaml: only the lab knows what it measures of it",
                code="user.hand",
            )

    def _address(self, model: ArmModel) -> tuple[str, float] | None:
        """Host and real-time factor of the controller stand-in; None for the simulated arm itself."""
        if self.arm == "sim":
            if self.real_time_factor is not None:
                raise UserError(
                    "--real-time-factor without --arm ur-rtde: the simulated arm itself needs none, its time waits "
                    "for it",
                    code="user.option",
                )
            if self.robot_host is not None:
                raise UserError(
                    "--robot-host without --arm ur-rtde: the simulated arm has no address", code="user.option"
                )
            if self.controller_profile is not None:
                raise UserError(
                    "--controller-profile without --arm ur-rtde: the simulated arm itself has no controller",
                    code="user.option",
                )
            return None
        if self.world is None:
            raise UserError(
                "--arm ur-rtde without --world: add --world pybullet for the simulated station behind the real driver; "
                "a real robot's job is `toolee hammer --station lab.yaml`",
                code="user.no_world",
            )
        if self.robot_host is None:
            raise UserError(
                "--arm ur-rtde needs --robot-host: a loopback address such as 127.0.0.2", code="user.no_robot_host"
            )
        if not is_loopback(self.robot_host):
            raise UserError(
                f"{self.robot_host!r} is not a loopback address: a stand-in serves this machine only",
                code="user.not_loopback",
            )
        return self.robot_host, self._factor(model, self.robot_host)


COMMANDS = {"": Hammer}

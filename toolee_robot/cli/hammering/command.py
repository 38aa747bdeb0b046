"""`toolee hammer`: the whole job on a simulated station."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.config import StationConfig, load_station
from toolee_robot.errors import UserError
from toolee_robot.runtime.clock import check_real_time_factor, is_loopback
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.types import ArmModel

WORLD_REAL_TIME_FACTOR = {ArmModel.UR10: 0.25, ArmModel.UR10E: 0.1}
"""Default real-time factors. A cycle then takes 32 and 20 ms, at least twice what the world needs for it in a strike,
so that two busy cores keep the servo's schedule within a real robot's bounds."""

HANDS = {"inspire": "inspire_rh56", "ability": "ability_hand"}
"""What --hand names -> what a station file calls it."""


@dataclass(frozen=True)
class Hammer:
    """Take a hammer from a person, look at it, and drive the nail (simulated station).

    Example: toolee hammer --seed 100 --json

    Example: toolee hammer --arm ur-rtde --robot-host 127.0.0.2 --world pybullet

    After a stop with the hammer in the hand a person at the terminal may resume the job, or have the hand opened.

    Exit code 0: the nail is flush; 1: it is not, for the reason given; 2: invalid input; 130: interrupted, the arm was
    stopped.
    """

    seed: int = 0
    """Seed of the hammer (none was used in training), the grasp and the noise."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""
    no_correction: Flag = False
    """Strike with the nominal pose of the tool in the hand: the baseline."""
    arm: Literal["sim", "ur-rtde"] = "sim"
    """The simulated arm itself, or a UR arm through the driver of real ones."""
    robot_host: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="")] = None
    """Address of the UR controller, with --arm ur-rtde; with --world a loopback address for the stand-in."""
    world: Annotated[Literal["pybullet"] | None, tyro.conf.arg(metavar="pybullet", help_behavior_hint="")] = None
    """Start a stand-in of the UR controller, with the simulated station as its world."""
    real_time_factor: Annotated[
        float | None, tyro.conf.arg(metavar="0.05..1", help_behavior_hint="(default: UR10 0.25, UR10e 0.1)")
    ] = None
    """With --world: rate of the station's time relative to wall-clock time. 1 is real time, which a busy machine does
    not sustain."""
    controller_profile: Annotated[
        ProfileName, tyro.conf.arg(name="controller-profile", aliases=["--profile"], metavar="ideal|harsh")
    ] = "ideal"
    """With --world: how the controller follows, measures and stops: exactly, or as one of the arm's generation."""
    robot: Annotated[Literal["UR10", "UR10e"] | None, tyro.conf.arg(metavar="UR10|UR10e", help_behavior_hint="")] = None
    """Model of the arm, instead of the configured one."""
    hand: Annotated[
        Literal["inspire", "ability"] | None, tyro.conf.arg(metavar="inspire|ability", help_behavior_hint="")
    ] = None
    """The hand of the station file by its own driver, over a pseudo-terminal; an emulated hand, which feels what the
    simulated one touches, is at its other end. Needs a --config with that hand."""
    hand_port: Annotated[str | None, tyro.conf.arg(metavar="PORT", help_behavior_hint="")] = None
    """With --hand: the port of a hand that `toolee hand-emulator` emulates, which feels its own --handle instead."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """A station: any subset of the fields in docs/reference/station_file.md."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs")
    """Parent of the run's folder, which holds summary.json, recording.mcap and picture.png."""
    gui: Flag = False
    """Show pybullet's window (needs a screen)."""
    perfect_perception: Flag = False
    """For tests and ablations only: poses from the simulation's ground truth instead of the camera."""

    def run(self) -> int:
        if not 0 <= self.seed < 2**31:
            raise UserError(f"--seed {self.seed}: give a whole number from 0 to {2**31 - 1}", code="user.seed")
        if self.gui and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
            raise UserError(
                "--gui needs a screen and DISPLAY is not set: leave it out, headless does the same job",
                code="user.no_display",
            )
        if self.perfect_perception and self.no_correction:
            raise UserError(
                "--perfect-perception with --no-correction changes nothing: leave one out", code="user.option"
            )
        config = StationConfig() if self.config is None else load_station(self.config)
        if self.robot is not None:
            config = replace(config, arm=replace(config.arm, model=ArmModel(self.robot)))
        address = self._address(config.arm.model)
        self._check_hand(config)
        console = Console(stderr=self.json, highlight=False)

        from toolee_robot.cli.run_folder import run_folder

        with run_folder(self.out, f"seed{self.seed}") as folder:
            console.print("[dim]loading the networks and building the station[/dim]")
            from toolee_robot.cli.hammering.job import (
                HammerJob,  # takes seconds to import: after the checks of the options
            )
            from toolee_robot.stations.simulated import HandDriver, StandIn

            stand_in = None if address is None else StandIn(*address, self.controller_profile)
            correction, perfect = not self.no_correction, self.perfect_perception
            # Only somebody at a terminal can have looked at the robot.
            interactive = not self.json and console.is_terminal and sys.stdin.isatty()
            ask = (lambda question: console.input(question, markup=False)) if interactive else None
            job = HammerJob(
                config, self.seed, correction=correction, perfect_perception=perfect, gui=self.gui, stand_in=stand_in,
                hand_driver=None if self.hand is None else HandDriver(self.hand_port), ask=ask,
            )  # fmt: skip
            report = job.run(folder.path, console)
            folder.keep()
        console.print(report.panel(folder.path))
        if self.json:
            print(json_line({**report.figures, "run_folder": str(folder.path)}), flush=True)
        return report.exit_code

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
                f"examples/{self.hand}.yaml: nobody but the lab knows how it sits on the flange",
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
            if self.controller_profile != "ideal":
                raise UserError(
                    "--controller-profile without --arm ur-rtde: the simulated arm itself has no controller",
                    code="user.option",
                )
            return None
        if self.world is None:
            raise UserError(
                "--arm ur-rtde on a real robot: this command opens no real station yet, so "
                "no job can be done there. Add --world pybullet for the simulated station behind the real driver; "
                "`toolee doctor --arm ur-rtde --robot-host ...` checks a real arm",
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
        real_time_factor = WORLD_REAL_TIME_FACTOR[model] if self.real_time_factor is None else self.real_time_factor
        check_real_time_factor(real_time_factor, self.robot_host)
        return self.robot_host, real_time_factor

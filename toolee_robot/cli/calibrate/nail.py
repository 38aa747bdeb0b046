"""`toolee calibrate nail`: where a nail is, by the camera, by touches of its head and of the wood, or by both."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from toolee_robot.cli.calibrate.nail_checks import touched_station
from toolee_robot.cli.options import Flag
from toolee_robot.errors import UserError
from toolee_robot.runtime.clock import check_real_time_factor
from toolee_robot.station import check_upright, load_lab_station, load_station, sim_station


@dataclass(frozen=True, kw_only=True)
class Nail:
    """Locate a nail and the wood: by the camera, which sees a printed board on the wood, or by touches of both.

    Example: toolee calibrate nail --camera

    Example: toolee calibrate nail --camera --station lab.yaml --bars-mm 361.3 258.1 --thickness-mm 0.2 --write

    Example: toolee calibrate nail --wood wood.yaml --touches nail.yaml --tip-mm 0.3 -0.2 151.4 --config lab.yaml

    The board, from `toolee calibrate board`, lies flat on the wood, glued or on a stiff plate, and the nail goes
    through its white cross. Only the camera looks; nothing moves. With --touches, too, both are combined, weighted by
    their uncertainties. Touch the middle of the head three times or more, from different sides; the file lists the
    joint positions, as for `toolee calibrate mount`, which also locates the tip. Three touches of the wood around the
    nail, 30 mm apart or more, tell its height and how it rises; a fourth shows that none was wrong. `toolee arm touch
    --touches` makes such a file. With --camera alone a simulated lab is looked at.

    Exit code 0: the nail is located; 1: a device failed; 2: images or touches are refused, for the reason given.
    """

    camera: Flag = False
    """Locate it by the camera."""
    station: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """With --camera: your own station. Its camera takes the images, and its calibration must hold."""
    rehearse: Flag = False
    """With --station: emulate every device, in front of a simulated cell."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """The station file without --station: the arm's kinematics, and where it has the nail."""
    nail: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """Which of several nails (work.nails)."""
    sheet: Literal["a4", "a3"] = "a3"
    """The board, as `toolee calibrate board` drew it. An A4 is too small for a camera of 512 pixels at 0.95 m."""
    bars_mm: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y", help_behavior_hint="")] = None
    """Lengths of the two scale bars, measured on the print. A simulated lab measures its own."""
    thickness_mm: Annotated[float | None, tyro.conf.arg(metavar="MM", help_behavior_hint="")] = None
    """Height of the printed side over the wood: paper and plate."""
    at_mm: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y", help_behavior_hint="")] = None
    """Place of the nail on the board, from the outer corner of the first square, along the bars x and y; the white
    cross if left out."""
    placing_mm: Annotated[float, tyro.conf.arg(metavar="MM")] = 0.5
    """Standard deviation of that place about each axis: how well the nail goes through the cross."""
    touches: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """The joint positions of touches."""
    tip_mm: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z", help_behavior_hint="")] = None
    """With --touches and --wood: the tip in the flange."""
    touch_mm: Annotated[float, tyro.conf.arg(metavar="MM")] = 0.5
    """With --touches and --wood: standard deviation of their mean about each axis: tip, kinematics and eye."""
    wood: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """The joint positions of touches of the wood around the nail."""
    repeat_mm: Annotated[float, tyro.conf.arg(metavar="MM")] = 0.2
    """With --wood: standard deviation of one touch from the next: force, kinematics over the block, grain."""
    seed: int = 0
    """Simulated: seed of the cell, the print, how it lies, the room and the noise."""
    real_time_factor: Annotated[float, tyro.conf.arg(metavar="0.05..1")] = 0.5
    """With --rehearse: rate of the station's time relative to wall-clock time."""
    write: Flag = False
    """Enter the place in `measured.yaml` beside the station file. Not of a simulated nail."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        self._check()
        path = self.station or self.config
        if self.station is not None:
            config = load_lab_station(self.station)
        elif self.config is None:
            config = sim_station()
        elif self.camera:  # a simulated one
            config = load_station(self.config)
        else:
            config = touched_station(self.config, wood_alone=self.touches is None)
        from dataclasses import replace

        from toolee_robot.cli.calibrate.nail_job import NailJob, Print

        check_upright(config.arm, "the place of a nail")
        names = config.work.names
        name = names[0] if self.nail is None else self.nail
        if name not in names:
            raise UserError(f"--nail {name}: the station's nails are {', '.join(names)} (work.nails)", code="user.nail")
        config = replace(config, work=config.work.only(name))
        console = Console(stderr=self.json, highlight=False)
        at = None if self.at_mm is None else (self.at_mm[0] / 1e3, self.at_mm[1] / 1e3)
        job = NailJob(config, name, console, Print(self.sheet, at, self.placing_mm / 1e3))
        if self.touches is not None:
            assert self.tip_mm is not None
            job.touch(self.touches, self.tip_mm, self.touch_mm / 1e3)
        if self.wood is not None:
            assert self.tip_mm is not None
            job.touch_wood(self.wood, self.tip_mm, self.repeat_mm / 1e3, self.touch_mm / 1e3)
        if self.camera and self.station is None:
            job.simulate(self.seed)
        elif self.camera and self.rehearse:
            assert self.station is not None
            job.rehearse(self.station, self.seed, self.real_time_factor)
        elif self.camera:
            assert self.station is not None
            assert self.bars_mm is not None
            assert self.thickness_mm is not None
            bars = self.bars_mm[0] / 1e3, self.bars_mm[1] / 1e3
            job.live(self.station, bars, self.thickness_mm / 1e3)
        job.conclude(path, write=self.write, as_json=self.json)
        return 0

    def _check(self) -> None:
        touches = [name for name in ("touches", "wood") if getattr(self, name) is not None]
        if not self.camera and not touches:
            raise UserError(
                "nothing tells where the nail is: give --camera, --touches or --wood", code="user.nail_no_source"
            )
        if touches and (self.tip_mm is None or (self.station or self.config) is None):
            raise UserError(
                f"--{touches[0]} needs --tip-mm, from `toolee calibrate mount`, and the station file (--config or "
                "--station)",
                code="user.option",
            )
        if self.wood is not None and self.camera:
            raise UserError(
                "--wood with --camera: the board tells how the wood lies, too; leave one of them out",
                code="user.option",
            )
        if self.touches is not None and self.camera and (self.station is None or self.rehearse):
            raise UserError(
                "--touches with a simulated camera: the touches are not of its nail; give your --station alone",
                code="user.option",
            )
        if self.station is not None and (self.config is not None or not self.camera):
            raise UserError(
                "--station is for --camera; without it give the file as --config, and never both", code="user.option"
            )
        if self.rehearse and self.station is None:
            raise UserError(
                "--rehearse without --station: give the station file that is rehearsed", code="user.no_station"
            )
        real = self.station is not None and not self.rehearse
        given = self.bars_mm is not None, self.thickness_mm is not None
        if real and not all(given):
            raise UserError(
                "--bars-mm and --thickness-mm are missing: measure the two scale bars on your print, and how high the "
                "printed side is over the wood",
                code="user.board_scale_unknown",
            )
        if not real and any(given):
            raise UserError(
                "--bars-mm and --thickness-mm are of your own print: a simulated lab measures its own",
                code="user.option",
            )
        if self.write and (self.station or self.config) is None:
            raise UserError("--write needs --station or --config: the file to write to", code="user.option")
        if self.write and self.camera and not real:
            raise UserError(
                "--write with a simulated camera: a simulated nail would take the place of yours; leave --write out",
                code="user.option",
            )
        if self.thickness_mm is not None and not 0.0 <= self.thickness_mm <= 50.0:
            raise UserError(f"--thickness-mm {self.thickness_mm}: give 0 to 50", code="user.option")
        deviations = self.placing_mm, self.touch_mm, self.repeat_mm
        if not all(0.01 <= value <= 10.0 for value in deviations) or self.seed < 0:
            raise UserError(
                "give --placing-mm, --touch-mm and --repeat-mm 0.01 to 10, and --seed 0 or more", code="user.option"
            )
        check_real_time_factor(self.real_time_factor, "127.0.0.1")

"""One location of a nail: touches, images, their combination, and what is entered in the station file."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.panel import Panel

from toolee_robot.calibration.board import SHEETS, Board
from toolee_robot.calibration.board_sight import KnownCamera
from toolee_robot.calibration.nail import (
    LocatedNail,
    OnWood,
    SeenNail,
    check_height,
    combine,
    foot_of,
    locate_nail,
    see_nail,
)
from toolee_robot.calibration.record import read_record
from toolee_robot.calibration.tip import read_touches
from toolee_robot.calibration.wood import WoodPlane, fit_wood
from toolee_robot.cli.calibrate.nail_checks import check_near, mistake
from toolee_robot.cli.calibrate.nail_fields import nail_fields
from toolee_robot.control import RobotModel
from toolee_robot.errors import ConfigError, NotReadyError, UserError
from toolee_robot.frames import Array, angle_between, transform_points
from toolee_robot.hal import Station
from toolee_robot.runtime.json_line import json_line
from toolee_robot.station import StationConfig, measured_path, write_measured
from toolee_robot.station.work import LARGEST_TILT
from toolee_robot.stations.lab import LabStation, Purpose
from toolee_robot.stations.rehearsal import EmulatedLab, job_cell
from toolee_robot.stations.rehearsal.job import camera_covariance
from toolee_robot.stations.simulated_nail import print_on_wood, simulated_nail_board
from toolee_robot.tasks.calibration.still_frame import mean_frame

PIXEL_NOISE = 0.3
"""Standard deviation of a board's corner where the camera was calibrated by another program [px]."""


@dataclass(frozen=True)
class Print:
    """What is known of the board on the wood.

    Attributes:
        sheet: Name of its sheet.
        at: Place of the nail on it [m]; None for its cross.
        placing: Standard deviation of that place [m].
    """

    sheet: str
    at: tuple[float, float] | None
    placing: float

    def on_wood(self, board: Board, thickness: float) -> OnWood:
        """How the board lies.

        Args:
            board: The board with its measured square.
            thickness: Height of the printed side over the wood [m].

        Returns:
            The same, with where the nail goes through it.
        """
        x, y = (float(board.mark[0]), float(board.mark[1])) if self.at is None else self.at
        return OnWood((x, y), thickness, self.placing)


@dataclass
class NailJob:
    """A location of a nail.

    Attributes:
        config: The station; its work is about the nail.
        name: The nail's name.
        console: The console.
        printed: The board on the wood.
        figures: What --json prints, by name.
    """

    config: StationConfig
    name: str
    console: Console
    printed: Print
    figures: dict[str, Any] = field(default_factory=dict)
    _touched: LocatedNail | None = None
    _wood: WoodPlane | None = None
    _seen: SeenNail | None = None

    def touch(self, touches: Path, tip_mm: tuple[float, float, float], error: float) -> None:
        """Locate the nail's head by touches.

        Args:
            touches: File of the joint positions.
            tip_mm: The tip in the flange [mm].
            error: Standard deviation of the touches' mean about each axis [m].

        Raises:
            TooleeError: The touches are refused.
        """
        arm = RobotModel.of_station(self.config).arm
        flange = [arm.fk(np.array(q)) for q in read_touches(touches).touches]
        self._touched = locate_nail(flange, np.array(tip_mm) / 1e3, error)
        x, y, z = self._touched.head * 1e3
        self.console.print(
            f"middle of the nail's head by touches: ({x:.2f}, {y:.2f}, {z:.2f}) mm in base_link, the touches "
            f"{self._touched.spread * 1e3:.2f} mm apart",
            soft_wrap=True,
        )

    def touch_wood(self, touches: Path, tip_mm: tuple[float, float, float], repeat: float, common: float) -> None:
        """Locate the wood by touches of it; those of the nail's head come before.

        Args:
            touches: File of the joint positions.
            tip_mm: The tip in the flange [mm].
            repeat: Standard deviation of one touch from the next about each axis [m].
            common: Standard deviation of what is the same in all of them [m].

        Raises:
            UserError: The touches are refused (`user.wood_...`), or do not fit those of the head
                (`user.nail_disagrees`).
            ConfigError: The file is no list of touches.
        """
        arm, work = RobotModel.of_station(self.config).arm, self.config.work
        flange = np.asarray([arm.fk(np.array(q)) for q in read_touches(touches).touches]).reshape(-1, 4, 4)
        p = transform_points(flange, np.array([tip_mm]) / 1e3)[:, 0]
        at = np.array(work.nail_xy) if self._touched is None else self._touched.head[:2]
        wood = fit_wood(p, at, repeat=repeat, common=common)
        check_near(p[:, :2], at)
        if wood.tilt > LARGEST_TILT:
            raise UserError(
                f"by the touches the wood is {np.rad2deg(wood.tilt):.1f}° off the level, "
                f"{np.rad2deg(LARGEST_TILT):.0f} are allowed: lay it flatter, or touch again what was not the wood",
                code="user.wood_tilted",
            )
        if self._touched is not None:
            foot = foot_of(self._touched.head, wood.normal, work.nail_protrusion, work.nail_lean)
            wood = fit_wood(p, foot[:2], repeat=repeat, common=common)
            touched, height = self._touched.covariance[2, 2], wood.covariance[0, 0]
            # What is off in all touches is off in head and wood alike.
            sigma = float(np.sqrt(max(touched + height - 2.0 * common**2, 0.0)))
            check_height(self._touched.head, foot, float(wood.point[2]), work.nail_protrusion, sigma)
        self._wood = wood

    def simulate(self, seed: int) -> None:
        """Look at a simulated lab's nail.

        Args:
            seed: Seed of what is drawn.

        Raises:
            TooleeError: The image is refused.
        """
        lab = simulated_nail_board(self.config, SHEETS[self.printed.sheet], seed)
        self.console.print(
            f"[bold]Simulated lab[/bold]  [dim]seed {seed}: a calibrated camera, a print of which the scale is drawn, "
            "on wood that is not where the station file has it[/dim]"
        )
        with lab.build() as simulation:
            images = mean_frame(simulation.station.camera)
        self._see(lab.camera, lab.board, replace(lab.on_wood, placing_error=self.printed.placing), *images)
        self._true_error(lab.entry, lab.up)

    def rehearse(self, station_file: Path, seed: int, factor: float) -> None:
        """Look at a nail with a lab's own camera driver, every device emulated.

        Args:
            station_file: The station file.
            seed: Seed of the cell and of what a person measured there.
            factor: Rate of the station's time relative to wall-clock time.

        Raises:
            TooleeError: The image or the calibration is refused.
        """
        cell = job_cell(self.config, station_file, seed)
        laid = print_on_wood(cell.true, SHEETS[self.printed.sheet], np.random.default_rng([seed, 33]))
        cell = replace(cell, options=replace(cell.options, hands_over=False, boards=(laid.placed,)))
        self.console.print(f"[bold]Rehearsal, every device emulated[/bold]  [dim]seed {seed}[/dim]")
        with (
            EmulatedLab(cell, self._tell, factor, "harsh", Purpose.CALIBRATION, self._doing) as lab,
            lab.blaming_the_machine(),
        ):
            self._look(lab.station, station_file, laid.board, laid.on_wood)
        self._true_error(laid.entry, laid.up)

    def live(self, station_file: Path, bars: tuple[float, float], thickness: float) -> None:
        """Look at a nail with a lab's camera; nothing moves.

        Args:
            station_file: The station file.
            bars: Measured lengths of the print's scale bars [m].
            thickness: Height of the printed side over the wood [m].

        Raises:
            TooleeError: A device is not there or not ready, or the image or the calibration is refused.
        """
        board = SHEETS[self.printed.sheet].board.measured(*bars)
        with LabStation(self.config, self._tell, purpose=Purpose.CALIBRATION, doing=self._doing) as lab:
            self._look(lab.station, station_file, board, self.printed.on_wood(board, thickness))

    def _look(self, station: Station, station_file: Path, board: Board, on_wood: OnWood) -> None:
        camera = known_camera(self.config, station_file, station)
        self._see(camera, board, on_wood, *mean_frame(station.camera))

    def _see(self, camera: KnownCamera, board: Board, on_wood: OnWood, rgb: Any, depth: Any) -> None:
        seen = see_nail(camera, board, on_wood, rgb, depth)
        if self._touched is not None:
            work = self.config.work
            seen = combine(seen, self._touched, work.nail_protrusion, lean=work.nail_lean)
        self._seen = seen

    def _true_error(self, entry: Array, up: Array) -> None:
        assert self._seen is not None
        off = self._seen.entry - entry
        self.figures |= {
            "true_lateral_mm": round(float(np.hypot(off[0], off[1])) * 1e3, 3),
            "true_height_mm": round(float(abs(off[2])) * 1e3, 3),
            "true_tilt_deg": round(float(np.rad2deg(angle_between(self._seen.up, up))), 3),
        }

    def conclude(self, path: Path | None, *, write: bool, as_json: bool) -> None:
        """Tell the result, and enter it in `measured.yaml` beside the station file.

        Args:
            path: The station file; None for none.
            write: Whether to enter it.
            as_json: Whether to print the figures as a line of JSON, too.

        Raises:
            ConfigError: The station would be refused with the result; nothing was written.
        """
        work, seen, touched, wood = self.config.work, self._seen, self._touched, self._wood
        rise: Array | None = None
        rows: list[tuple[str, str]] = []
        if seen is not None:
            entry, sigma = seen.entry, np.sqrt(np.diag(seen.covariance))
            rise = -seen.up[:2] / seen.up[2]
            rows += [
                ("nail at the wood", f"({_mm(entry)}) ± ({_mm(2 * sigma)}) mm in base_link (95 %)"),
                ("wood off the level", f"{np.rad2deg(seen.tilt):.2f} ± {np.rad2deg(2 * seen.tilt_sigma):.2f}°"),
                ("board", f"{seen.corners} corners, {seen.reprojection:.2f} px"),
            ]
            self.figures |= {
                "entry": entry.tolist(), "covariance": seen.covariance.tolist(), "up": seen.up.tolist(),
                "tilt_deg": round(float(np.rad2deg(seen.tilt)), 3), "corners": seen.corners,
            }  # fmt: skip
        elif wood is not None:
            entry, rise = wood.point, wood.rise
            sigma = np.sqrt(np.diag(wood.covariance))
            apart = np.max(np.abs(wood.residuals)) * 1e3
            rows += [
                ("wood at the nail", f"{entry[2] * 1e3:.2f} ± {2e3 * sigma[0]:.2f} mm over the base (95 %)"),
                ("wood off the level", f"{np.rad2deg(wood.tilt):.2f} ± {np.rad2deg(2 * wood.tilt_sigma):.2f}°"),
                ("touches of the wood", f"{len(wood.residuals)}, up to {apart:.2f} mm off the plane" if
                 len(wood.residuals) > 3 else "3: a fourth would tell whether one is wrong"),
            ]  # fmt: skip
            self.figures |= {
                "entry": entry.tolist(), "rise": wood.rise.tolist(), "wood_covariance": wood.covariance.tolist(),
                "up": wood.normal.tolist(), "tilt_deg": round(float(np.rad2deg(wood.tilt)), 3),
                "residuals": wood.residuals.tolist(),
            }  # fmt: skip
        else:
            assert touched is not None
            entry = foot_of(touched.head, work.wood_normal, work.nail_protrusion, work.nail_lean)
        if touched is not None:
            self.figures |= {"head": touched.head.tolist(), "spread": touched.spread}
        off = entry - work.p_base_entry
        self.figures["height_off"] = float(off[2])
        rows.append(("from the station file", f"({_mm(off, sign=True)}) mm"))
        if why := mistake(entry, work.p_base_entry):
            rows.append(("", f"[red]{why}[/red]"))
        if "true_lateral_mm" in self.figures:
            f = self.figures
            rows.append(
                ("true errors *", f"beside {f['true_lateral_mm']} mm, height {f['true_height_mm']} mm, "
                 f"tilt {f['true_tilt_deg']}°")
            )  # fmt: skip
        lines = [f"{name:<24}{value}" for name, value in rows]
        located = seen is not None or touched is not None  # and not the wood alone
        places = nail_fields(work, self.name, entry, rise, None if write else path, with_nail=located)
        told = [f"  {name}: {value}" for item, values in places if not item for name, value in values.items()]
        told += [f"  nails, {item[1]}: xy: {values['xy']}" for item, values in places if item]
        where = f"Entered in {measured_path(path).name}, in base_link:" if write and path else "In the station file:"
        lines += ["", where, "work:", *told]
        if write:
            assert path is not None
            nails = [{"name": item[1], **values} for item, values in places if item]
            write_measured(path, work=places[0][1] | ({"nails": nails} if nails else {}))
        if "true_lateral_mm" in self.figures:
            lines += ["", "[dim]* measured by the simulation; whoever looks cannot see it[/dim]"]
        title = f"[bold]the {'nail' if located else 'wood'} is located[/bold]"
        self.console.print(Panel("\n".join(lines), title=title, border_style="green", expand=False, padding=(1, 2)))
        if as_json:
            print(json_line(self.figures), flush=True)

    def _tell(self, text: str) -> None:
        self.console.print(f"  [bold yellow]> {escape(text)}[/bold yellow]", soft_wrap=True)

    def _doing(self, text: str) -> None:
        self.console.print(f"[dim]{escape(text)}[/dim]", soft_wrap=True)


def known_camera(config: StationConfig, station_file: Path, station: Station) -> KnownCamera:
    """What the calibration that a station file names tells of its camera.

    Args:
        config: What the file says.
        station_file: The file.
        station: The devices, which tell their serial numbers.

    Returns:
        The camera.

    Raises:
        ConfigError: There is no calibration (`config.uncalibrated`), or its record cannot be read or was altered.
        NotReadyError: It is too old, too bad, or of other devices (`not_ready.calibration`).
    """
    calibration = config.calibration
    if calibration is None:
        raise ConfigError(
            "the station file names no calibration: `toolee calibrate camera` first", code="config.uncalibrated"
        )
    if problems := calibration.problems(station.robot_serial, station.camera_serial, date.today()):
        raise NotReadyError(
            f"the camera's calibration does not hold: {'; '.join(problems)}", code="not_ready.calibration"
        )
    if calibration.record is not None:
        return KnownCamera.of_record(read_record(station_file.parent / calibration.record))
    covariance = camera_covariance(config, station_file)
    return KnownCamera(config.camera.X_base_camera, covariance, config.camera.intrinsics, PIXEL_NOISE)


def _mm(values: Array, *, sign: bool = False) -> str:
    return ", ".join(f"{1e3 * v:+.2f}" if sign else f"{1e3 * v:.2f}" for v in values)

"""One calibration of a camera: images, solution, record and report."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.panel import Panel

import toolee_robot
from toolee_robot.calibration.board import SHEETS, Board
from toolee_robot.calibration.build_record import build_record
from toolee_robot.calibration.hand_eye.solve import CameraCalibration, calibrate
from toolee_robot.calibration.observation import camera_board
from toolee_robot.calibration.record import CalibrationRecord, write_record
from toolee_robot.calibration.session import Seen, Session, SessionPose, observe, read_session, write_session
from toolee_robot.cli.calibrate.recorded_images import check_undistorted
from toolee_robot.control import RobotModel
from toolee_robot.frames import Array
from toolee_robot.hal import Station
from toolee_robot.recording.calibration_report import calibration_report
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.json_line import json_line
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.station import draw_handover
from toolee_robot.station import StationConfig
from toolee_robot.stations.lab import LabStation, Purpose
from toolee_robot.stations.rehearsal import Cell, EmulatedLab
from toolee_robot.stations.simulated_board import SimulatedBoard, simulated_board
from toolee_robot.tasks.calibration.collect import Collector, save, session_of
from toolee_robot.tasks.calibration.plate import Plate
from toolee_robot.tasks.calibration.views import missing, plan_views

RECORD, REPORT = "camera.json", "report.html"
"""Files of a calibration's folder."""


@dataclass
class CameraJob:
    """A calibration.

    Attributes:
        config: The station.
        sheet: Name of the board's sheet.
        console: The console.
        figures: What --json prints, by name; filled by the calibration.
    """

    config: StationConfig
    sheet: str
    console: Console
    figures: dict[str, Any] = field(default_factory=dict)

    def simulate(self, folder: Path, poses: int, distance: float, mass: float, seed: int) -> None:
        """Calibrate a simulated lab.

        Args:
            folder: Where everything is written.
            poses: Number of poses.
            distance: Distance of the print from the flange [m].
            mass: Mass of plate and holder [kg].
            seed: Seed of what is drawn.

        Raises:
            TooleeError: The calibration failed, or was refused.
        """
        lab = self._printed(distance, mass, seed, "Simulated lab")
        with lab.build(seed) as simulation:
            calibration = self._collect(folder, simulation.station, lab.measured, lab.plate, lab.bars, poses, seed)
        self._true_error(calibration)

    def rehearse(self, folder: Path, poses: int, distance: float, mass: float, seed: int, factor: float) -> None:
        """Calibrate a lab whose devices are emulated, with its own drivers.

        Args:
            folder: Where everything is written.
            poses: Number of poses.
            distance: Distance of the print from the flange [m].
            mass: Mass of plate and holder [kg].
            seed: Seed of what is drawn.
            factor: Rate of the station's time relative to wall-clock time.

        Raises:
            TooleeError: The calibration failed, or was refused.
        """
        board = self._printed(distance, mass, seed, "Rehearsal, every device emulated")
        options = SimOptions(hands_over=False, boards=(board.placed,))
        # Without the calibration of the real robot, whose serial number the record would have.
        measured = replace(board.measured, calibration=None)
        cell = Cell(board.true, measured, draw_handover(seed, options)[0], options, seed)
        with (
            EmulatedLab(cell, self._prompt, factor, "harsh", Purpose.CALIBRATION, self._doing) as lab,
            lab.blaming_the_machine(),
        ):
            calibration = self._collect(folder, lab.station, measured, board.plate, board.bars, poses, seed)
        self._true_error(calibration)

    def live(
        self, folder: Path, poses: int, distance: float, mass: float, seed: int, bars: tuple[float, float]
    ) -> None:
        """Calibrate a lab's camera with its own arm.

        Args:
            folder: Where everything is written.
            poses: Number of poses.
            distance: Distance of the print from the flange [m].
            mass: Mass of plate and holder [kg].
            seed: Seed of the planned views.
            bars: Measured lengths of the print's scale bars [m].

        Raises:
            TooleeError: A device is not there or not ready, or the calibration was refused.
        """
        plate = Plate(SHEETS[self.sheet].board.measured(*bars), distance, mass)
        config = plate.station(replace(self.config, camera=self.config.camera.uncalibrated))
        with LabStation(config, self._prompt, purpose=Purpose.CALIBRATION, doing=self._doing) as lab:
            self._collect(folder, lab.station, config, plate, bars, poses, seed)

    def _printed(self, distance: float, mass: float, seed: int, what: str) -> SimulatedBoard:
        lab = simulated_board(self.config, SHEETS[self.sheet], distance, mass, seed)
        x, y = lab.bars
        self.console.print(
            f"[bold]{what}[/bold]  [dim]seed {seed}[/dim]\n  the bars of the simulated print, whose scale is drawn, "
            f"measure {x * 1e3:.1f} and {y * 1e3:.1f} mm: squares of {lab.plate.board.square * 1e3:.2f} mm"
        )
        return lab

    def _collect(
        self,
        folder: Path,
        station: Station,
        config: StationConfig,
        plate: Plate,
        bars: tuple[float, float],
        poses: int,
        seed: int,
    ) -> CameraCalibration:
        robot = RobotModel.of_station(config)
        with self.console.status("planning views of the board"):
            views = plan_views(robot, config, plate, poses, seed)
        self.console.print(f"[bold]Views[/bold]  [dim]{len(views)} planned[/dim]")
        taken: list[SessionPose] = []
        try:
            for view in Collector(station, config, robot, plate.board, self._note).take_all(views):
                taken.append(save(folder, view))
                seen = "[yellow]the board is not seen[/yellow]"
                if view.X_camera_board is not None:
                    seen = f"{view.corners} corners at {view.X_camera_board[2, 3]:.2f} m"
                self.console.print(f"  {view.number:>3}  {seen}")
        finally:  # what was taken before an error is a session, too
            if taken:
                write_session(folder, session_of(station, taken))
        session = session_of(station, taken)
        return self._solve(folder, session, plate.board, bars, robot, config.camera.X_base_camera[:3, 3])

    def _true_error(self, calibration: CameraCalibration) -> None:
        truth = self.config.camera.uncalibrated.X_base_camera
        off = (calibration.X_base_camera - truth) @ [*calibration.target, 1.0]
        self.figures["true_error_mm"] = round(float(np.linalg.norm(off)) * 1e3, 3)

    def _doing(self, text: str) -> None:
        self.console.print(f"[dim]{escape(text)}[/dim]", soft_wrap=True)

    def _prompt(self, text: str) -> None:
        self.console.print(f"  [bold yellow]> {escape(text)}[/bold yellow]", soft_wrap=True)

    def from_images(self, folder: Path, images: Path, bars: tuple[float, float], *, measured_camera: bool) -> None:
        """Calibrate from a folder of images and poses.

        Args:
            folder: Where record and report are written.
            images: The folder.
            bars: Measured lengths of the print's scale bars [m].
            measured_camera: Whether the station tells where the camera was measured by hand.

        Raises:
            TooleeError: The calibration was refused; or the images are of a recording whose lens was not known
                (`user.calibration_distorted`).
        """
        board = SHEETS[self.sheet].board.measured(*bars)
        session = read_session(images)
        for place in {images, *((images / pose.image).parent for pose in session.poses)}:
            check_undistorted(place)
        expected = self.config.camera.uncalibrated.X_base_camera[:3, 3] if measured_camera else None
        if expected is None:
            self._note("without --config nobody tells where the camera is: a half turn of the base is not noticed")
        self._solve(folder, session, board, bars, RobotModel.of_station(self.config), expected, images)

    def tell_kept(self, folder: Path) -> None:
        """Tell where the images are that were taken before an error.

        Args:
            folder: The calibration's folder.
        """
        self._note(f"the images so far are kept: to compute with them, give --images {folder}")

    def conclude(self, folder: Path, written_to: Path | None, as_json: bool) -> None:
        """Tell the result.

        Args:
            folder: The calibration's folder.
            written_to: The file in which the record was entered; None for none.
            as_json: Whether to print the figures as a line of JSON, too.
        """
        f = self.figures
        rows = [
            (f"95 % region at {f['target_m']:g} m", f"± {f['target_radius_mm']:.2f} mm"),
            ("held-out poses", f"{f['residual_mm']:.2f} mm"),
            ("one pose left out", f"{f['largest_shift_mm']:.2f} mm at most"),
            ("noise", f"corners {f['pixel_noise']:.2f} px, arm {f['arm_noise_mm']:.2f} mm {f['arm_noise_deg']:.3f}°"),
            ("poses", f"{f['poses']}" + (f", not fitting: {', '.join(f['wrong'])}" if f["wrong"] else "")),
        ]
        if "true_error_mm" in f:
            rows.append(("true error *", f"{f['true_error_mm']:.2f} mm"))
        rows += [("record", escape(str(folder / RECORD))), ("report", escape(str(folder / REPORT)))]
        lines = [f"{name:<24}{value}" for name, value in rows]
        if written_to is None:
            record = escape(str(folder / RECORD))
            lines += ["", "Look at the report, then enter it in the station file:", "", "calibration:"]
            lines.append(f"  record: {record}")
        else:
            lines += ["", f"Entered in {escape(str(written_to))}. Look at the report before you rely on it."]
        if "true_error_mm" in f:
            lines += ["", "[dim]* measured by the simulation; the calibration cannot see it[/dim]"]
        title = "[bold]the camera is calibrated[/bold]"
        self.console.print(Panel("\n".join(lines), title=title, border_style="green", expand=False, padding=(1, 2)))
        if as_json:
            print(json_line({**f, "record": str(folder / RECORD)}), flush=True)

    def _solve(
        self,
        folder: Path,
        session: Session,
        board: Board,
        bars: tuple[float, float],
        robot: RobotModel,
        expected: Array | None,
        images: Path | None = None,
    ) -> CameraCalibration:
        images = folder if images is None else images
        with self.console.status("looking for the board and solving"):
            seen = observe(images, session, board, robot.arm.fk)
            calibration = calibrate(seen.observations, board, session.intrinsics, expected=expected)
        Xs = [camera_board(o.view, board, session.intrinsics)[0] for o in seen.observations]
        lacking = missing(Xs, board, self.config.camera)
        if seen.unseen:
            self._note(f"the board is not seen in {', '.join(seen.unseen)}")
        if lacking:
            self._note(f"fewer than two views: {', '.join(lacking)}")
        for name in calibration.wrong:
            self._note(f"{name} does not fit the others and hardly counts: look at it, or take it again")
        record = self._record(calibration, session, seen, board, bars)
        signature = write_record(folder / RECORD, record)
        page = calibration_report(record, images, signature, lacking)
        write_atomic(folder / REPORT, page.encode())
        self.figures |= _figures(record, calibration, lacking, signature)
        return calibration

    def _record(
        self, calibration: CameraCalibration, session: Session, seen: Seen, board: Board, bars: tuple[float, float]
    ) -> CalibrationRecord:
        arm = self.config.arm
        return build_record(
            calibration,
            session,
            seen,
            board,
            bars=bars,
            robot_model=str(arm.model),
            kinematics=arm.calibration,
            distortion=self.config.camera.distortion,
            software=toolee_robot.__version__,
            now=datetime.now(UTC),
        )

    def _note(self, text: str) -> None:
        self.console.print(f"  [yellow]{escape(text)}[/yellow]", soft_wrap=True)


def _figures(
    record: CalibrationRecord, calibration: CameraCalibration, lacking: list[str], signature: str
) -> dict[str, Any]:
    return {
        "target_m": record.target[2],
        "target_radius_mm": round(record.target_radius * 1e3, 3),
        "residual_mm": round(record.residual * 1e3, 3),
        "largest_shift_mm": round(record.largest_shift * 1e3, 3),
        "pixel_noise": round(record.pixel_noise, 3),
        "arm_noise_mm": round(record.arm_noise[0] * 1e3, 3),
        "arm_noise_deg": round(float(np.rad2deg(record.arm_noise[1])), 4),
        "poses": len(record.poses),
        "wrong": calibration.wrong,
        "missing_views": lacking,
        "X_base_camera": [list(row) for row in record.X_base_camera],
        "signature": signature,
    }

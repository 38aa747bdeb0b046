"""The calibration of a fixed camera's place: images, solution and record."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import toolee_robot
from toolee_robot.app.sources import Listener
from toolee_robot.calibration.board import SHEETS, Board
from toolee_robot.calibration.hand_eye.solve import CameraCalibration, calibrate
from toolee_robot.calibration.observation import camera_board
from toolee_robot.calibration.record import CalibrationRecord, write_record
from toolee_robot.calibration.session import Session, SessionPose, build_record, observe, read_session, write_session
from toolee_robot.control import RobotModel
from toolee_robot.devices.cameras.recording import recording_of
from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.hal import Station
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.station import draw_handover
from toolee_robot.station import StationConfig, unmeasured
from toolee_robot.stations.lab import LabStation, Purpose
from toolee_robot.stations.rehearsal import Cell, EmulatedLab
from toolee_robot.stations.simulated import simulated_board
from toolee_robot.tasks.calibration.collect import Collector, save, session_of
from toolee_robot.tasks.calibration.views import Plate, missing, plan_views

RECORD = "camera.json"
"""File of the record in a calibration's folder."""
Bars = tuple[float, float]
"""Measured lengths of a print's two scale bars [m]."""


@dataclass(frozen=True)
class PlateViews:
    """Views of the board on the flange that the arm drives to.

    Attributes:
        count: Number of poses.
        distance: Distance of the print from the flange [m].
        mass: Mass of plate and holder [kg].
        seed: Seed of the planned views; simulated: also of the print, its place on the flange, the room and the noise.
    """

    count: int
    distance: float
    mass: float
    seed: int


@dataclass(frozen=True)
class CameraJob:
    """A calibration of a camera's place, and where it is written.

    Attributes:
        config: The station.
        sheet: Name of the board's sheet.
        folder: Where images and record are written.
        listener: Who hears of it.
    """

    config: StationConfig
    sheet: str
    folder: Path
    listener: Listener

    def rehearse(self, views: PlateViews, factor: float) -> dict[str, Any]:
        """Calibrate a lab whose devices are emulated, with its own drivers.

        Args:
            views: The views to take, and the plate in them.
            factor: Rate of the station's time relative to wall-clock time.

        Returns:
            Figures by name.

        Raises:
            TooleeError: The calibration failed, or was refused.
        """
        board = simulated_board(self.config, SHEETS[self.sheet], views.distance, views.mass, views.seed)
        x, y = (f"{length * 1e3:.1f}" for length in board.bars)
        self.listener.say(
            f"[bold]Rehearsal, every device emulated[/bold]  [dim]seed {views.seed}[/dim]\n  the bars of the print, "
            f"whose scale is random, measure {x} and {y} mm"
        )
        options = SimOptions(hands_over=False, boards=(board.placed,))
        # Without the calibration of the real robot, whose serial number the record would have.
        measured = replace(board.measured, calibration=None)
        cell = Cell(board.true, measured, draw_handover(views.seed, options)[0], options, views.seed)
        listener = self.listener
        with (
            EmulatedLab(cell, listener.prompt, factor, "harsh", Purpose.CALIBRATION, listener.doing) as lab,
            lab.blaming_the_machine(),
        ):
            calibration, figures = self.collect(lab.station, measured, board.plate, board.bars, views)
        return figures | self._true_error(calibration)

    def live(self, views: PlateViews, bars: Bars) -> dict[str, Any]:
        """Calibrate a lab's camera with its own arm.

        Args:
            views: The views to take, and the plate in them.
            bars: Measured lengths of the print's scale bars [m].

        Returns:
            Figures by name.

        Raises:
            TooleeError: A device is not there or not ready, or the calibration was refused.
        """
        plate = Plate(SHEETS[self.sheet].board.measured(*bars), views.distance, views.mass)
        config = plate.station(replace(self.config, camera=self.config.camera.uncalibrated))
        listener = self.listener
        with LabStation(config, listener.prompt, purpose=Purpose.CALIBRATION, doing=listener.doing) as lab:
            return self.collect(lab.station, config, plate, bars, views)[1]

    def from_images(self, images: Path, bars: Bars, station: Path) -> dict[str, Any]:
        """Calibrate from a folder of images and poses.

        Args:
            images: The folder.
            bars: Measured lengths of the print's scale bars [m].
            station: The station file, which may say where the camera was measured by hand.

        Returns:
            Figures by name.

        Raises:
            TooleeError: The calibration was refused; or the images are of a recording whose lens was not known.
        """
        board = SHEETS[self.sheet].board.measured(*bars)
        session = read_session(images)
        for place in {images, *((images / pose.image).parent for pose in session.poses)}:
            _check_undistorted(place)
        expected: Array | None = self.config.camera.uncalibrated.X_base_camera[:3, 3]
        if "camera.position" in unmeasured(station):
            expected = None
            self.listener.warn(
                f"{station} does not say where the camera is (camera.position), so half a turn of the base goes "
                "unnoticed"
            )
        return self._solve(session, board, bars, RobotModel.of_station(self.config), expected, images)[1]

    def collect(
        self, station: Station, config: StationConfig, plate: Plate, bars: Bars, views: PlateViews
    ) -> tuple[CameraCalibration, dict[str, Any]]:
        """Take the views with a station's devices, and solve.

        Args:
            station: The devices.
            config: What is known of the station, with the plate on the flange.
            plate: The plate.
            bars: Measured lengths of the print's scale bars [m].
            views: The views to take.

        Returns:
            The calibration, and figures by name.

        Raises:
            TooleeError: A device failed, or the calibration was refused.
        """
        robot = RobotModel.of_station(config)
        with self.listener.waiting("planning views of the board"):
            planned = plan_views(robot, config, plate, views.count, views.seed)
        self.listener.say(f"[bold]Views[/bold]  [dim]{len(planned)} planned[/dim]")
        taken: list[SessionPose] = []
        try:
            for view in Collector(station, config, robot, plate.board, self.listener.warn).take_all(planned):
                taken.append(save(self.folder, view))
                seen = "[yellow]the board is not seen[/yellow]"
                if view.X_camera_board is not None:
                    seen = f"{view.corners} corners at {view.X_camera_board[2, 3]:.2f} m"
                self.listener.say(f"  {view.number:>3}  {seen}")
        finally:  # what was taken before an error is a session, too
            if taken:
                write_session(self.folder, session_of(station, taken))
        session = session_of(station, taken)
        return self._solve(session, plate.board, bars, robot, config.camera.X_base_camera[:3, 3], self.folder)

    def _true_error(self, calibration: CameraCalibration) -> dict[str, Any]:
        truth = self.config.camera.uncalibrated.X_base_camera
        off = (calibration.X_base_camera - truth) @ [*calibration.target, 1.0]
        return {"true_error_mm": round(float(np.linalg.norm(off)) * 1e3, 3)}

    def _solve(
        self, session: Session, board: Board, bars: Bars, robot: RobotModel, expected: Array | None, images: Path
    ) -> tuple[CameraCalibration, dict[str, Any]]:
        with self.listener.waiting("looking for the board and solving"):
            seen = observe(images, session, board, robot.arm.fk)
            calibration = calibrate(seen.observations, board, session.intrinsics, expected=expected)
        Xs = [camera_board(o.view, board, session.intrinsics)[0] for o in seen.observations]
        lacking = missing(Xs, board, self.config.camera)
        if seen.unseen:
            self.listener.warn(f"the board is not seen in {', '.join(seen.unseen)}")
        if lacking:
            self.listener.warn(f"fewer than two views: {', '.join(lacking)}")
        for name in calibration.wrong:
            self.listener.warn(f"{name} does not fit the other poses and hardly counts: check it, or take it again")
        record = build_record(
            calibration,
            session,
            seen,
            board,
            bars=bars,
            robot_model=str(self.config.arm.model),
            kinematics=self.config.arm.calibration,
            distortion=self.config.camera.distortion,
            software=toolee_robot.__version__,
            now=datetime.now(UTC),
        )
        signature = write_record(self.folder / RECORD, record)
        return calibration, _figures(record, calibration, lacking, signature)


def _check_undistorted(images: Path) -> None:
    """Refuse images of a recording that says that the lens's distortion is still in them."""
    recording = recording_of(images)
    if recording is not None and recording.undistorted is False:
        raise UserError(
            f"{recording.folder} says `undistorted: false`, but a calibration needs undistorted images. Give "
            "the lens in camera.distortion, then record again"
        )


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

"""The cell of a rehearsed job: what the station file says, with the errors of what a person measures.

Drawn from the seed, and unknown to the job: where the camera really stands, by the covariance of its calibration; where
the nail really is and how it leans; and the hammer, of which the job gets what a ruler and scales tell
(`sim_backend.cell_errors`).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from toolee_robot.calibration.record import read_record
from toolee_robot.frames import Array
from toolee_robot.sim_backend.cell_errors import NOMINAL, DrawnErrors, draw_errors
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.station import draw_handover
from toolee_robot.station import StationConfig
from toolee_robot.stations.lab import check_purpose
from toolee_robot.stations.rehearsal.emulated_lab import Cell


def job_cell(config: StationConfig, station_file: Path, seed: int) -> Cell:
    """Draw a cell that a station file may describe, and a hammer.

    Args:
        config: What the station file says, from `load_lab_station`.
        station_file: The file.
        seed: Seed of hammer, grasp, and of the errors of what the station file says.

    Returns:
        The cell; the hammer's data are in `measured.tool`, instead of the file's.

    Raises:
        ConfigError: The file lacks what a job needs, or its calibration's record cannot be read or was altered.
    """
    check_purpose(config)
    errors = job_errors(config, station_file, seed)
    options = errors.options(SimOptions())
    tool, _ = draw_handover(seed, options)
    sheet = errors.measured(tool, f"{tool.kind.replace('_', ' ')} of the rehearsal")
    measured = replace(config, tool=sheet.unmeasured_as(config.tool))
    return Cell(errors.made_of(errors.displaced(config)), measured, tool, options, seed)


def job_errors(config: StationConfig, station_file: Path, seed: int) -> DrawnErrors:
    """Draw the errors of what a station file says.

    Args:
        config: What the station file says; it has a calibration.
        station_file: The file.
        seed: Seed of the job.

    Returns:
        The errors.

    Raises:
        ConfigError: The calibration's record cannot be read or was altered.
    """
    # What the hand weighs the file says itself, and the wrench is the controller's.
    sizes = replace(NOMINAL, payload=0.0, wrench=0.0)
    return draw_errors(sizes, seed, camera_covariance(config, station_file))


def camera_covariance(config: StationConfig, station_file: Path) -> Array:
    """Covariance of the camera's pose.

    Args:
        config: What the station file says; it has a calibration.
        station_file: The file.

    Returns:
        That of the calibration's record; of a calibration by another program, which tells a residual alone, one that
        is as large along each axis and turns the camera by as much at 1 m, (6, 6) [m, rad], axes of `base`.

    Raises:
        ConfigError: The record cannot be read or was altered.
    """
    assert config.calibration is not None, "checked before"
    if config.calibration.record is not None:
        return np.array(read_record(station_file.parent / config.calibration.record).covariance)
    return np.eye(6) * config.calibration.residual**2

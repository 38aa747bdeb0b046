"""The cell of a rehearsed job: what the station file says, with the errors of what a person measures.

Drawn from the seed, and unknown to the job: where the camera really stands, by the covariance of its calibration; where
the nail really is; and the hammer, of which the job gets what a ruler and scales tell. The sizes of these errors are
assumed, but the camera's.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.calibration.record import read_record, rows
from toolee_robot.config import StationConfig, ToolData
from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, transform
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.station import draw_handover
from toolee_robot.stations.lab import check_purpose
from toolee_robot.stations.rehearsal.emulated_lab import Cell
from toolee_robot.tools import Tool

NAIL_BESIDE, NAIL_HEIGHT = 1e-3, 3e-4
"""Standard deviations of the nail's place, along each axis and upwards [m]."""
RULER, SCALES = 1e-3, 0.01
"""Standard deviations of a length that is measured on a hammer [m], and of its mass as a share."""
BALANCE = 5e-3
"""Standard deviation of the centre of mass along the handle, found by balancing it [m]."""
ANGLE = float(np.deg2rad(1.0))
"""Standard deviation of the face's direction [rad]."""


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
    options = SimOptions()
    tool, _ = draw_handover(seed, options)
    rng = np.random.default_rng([seed, 31])
    off = rng.multivariate_normal(np.zeros(6), camera_covariance(config, station_file))
    X = config.camera.X_base_camera
    X_true = transform(Rotation.from_rotvec(off[3:]) * Rotation.from_matrix(X[:3, :3]), X[:3, 3] + off[:3])
    x, y = config.work.nail_xy + rng.normal(0.0, NAIL_BESIDE, 2)
    height = max(1e-3, config.work.stand_height + float(rng.normal(0.0, NAIL_HEIGHT)))
    work = replace(config.work, nail_xy=(float(x), float(y)), stand_height=height)
    true = replace(config, camera=replace(config.camera, pose=rows(X_true)), work=work)
    return Cell(true, replace(config, tool=_by_ruler(tool, rng)), tool, options, seed)


def _by_ruler(tool: Tool, rng: np.random.Generator) -> ToolData:
    X = tool.ee(Category.HAMMER_HEAD).X_tool_ee
    face = X[:3, 3] + rng.normal(0.0, RULER, 3)
    normal = Rotation.from_rotvec(rng.normal(0.0, ANGLE, 3)).apply(X[:3, 2])
    center = tool.center_of_mass + np.array([0.0, 0.0, rng.normal(0.0, BALANCE)])
    return ToolData(
        name=f"{tool.kind.replace('_', ' ')} of the rehearsal",
        grip_radius=max(5e-3, tool.handle.grip_radius + float(rng.normal(0.0, 0.5 * RULER))),
        face=_three(face),
        face_normal=_three(normal),
        mass=tool.mass * float(1.0 + rng.normal(0.0, SCALES)),
        center_of_mass=_three(center),
    )


def _three(v: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in v)
    return x, y, z


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

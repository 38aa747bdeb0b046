"""The location of a nail and of the wood by the camera, and its entry in the station file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from toolee_robot.app.sources import Listener
from toolee_robot.calibration.board import SHEETS, Board
from toolee_robot.calibration.nail import OnWood, SeenNail, see_nail
from toolee_robot.calibration.record import axes_swapped, camera_is_elsewhere, half_a_turn_apart, read_record
from toolee_robot.calibration.touches import KnownCamera
from toolee_robot.errors import ConfigError, NotReadyError
from toolee_robot.frames import Array, BaseFrame, angle_between, inverse
from toolee_robot.hal import Station
from toolee_robot.station import StationConfig, WorkConfig, read_station, write_measured
from toolee_robot.stations.lab import LabStation, Purpose
from toolee_robot.stations.rehearsal import EmulatedLab, job_cell
from toolee_robot.stations.rehearsal.emulated_lab import camera_covariance
from toolee_robot.stations.simulated import print_on_wood
from toolee_robot.tasks.calibration.collect import mean_frame

PIXEL_NOISE = 0.3
"""Standard deviation of a board's corner where the camera was calibrated by another program [px]."""


@dataclass(frozen=True)
class Print:
    """The board on the wood.

    Attributes:
        sheet: Name of its sheet.
        at: Place of the nail on it [m]; None for its cross.
        placing: Standard deviation of that place [m].
    """

    sheet: str
    at: tuple[float, float] | None
    placing: float


@dataclass(frozen=True)
class Sight:
    """What the camera has seen.

    Attributes:
        nail: The nail.
        true: What the simulation knows: entry, (3,) [m], and the wood's normal, (3,); None for a real one.
    """

    nail: SeenNail
    true: tuple[Array, Array] | None = None

    def true_errors(self) -> dict[str, float]:
        """Errors that the simulation knows, by name."""
        if self.true is None:
            return {}
        off = self.nail.entry - self.true[0]
        return {
            "true_lateral_mm": round(float(np.hypot(off[0], off[1])) * 1e3, 3),
            "true_height_mm": round(float(abs(off[2])) * 1e3, 3),
            "true_tilt_deg": round(float(np.rad2deg(angle_between(self.nail.up, self.true[1]))), 3),
        }


@dataclass(frozen=True)
class Located:
    """Where a nail and the wood are.

    Attributes:
        config: The station; its work is about the nail.
        name: The nail's name.
        sight: What the camera has seen.
    """

    config: StationConfig
    name: str
    sight: Sight

    @property
    def entry(self) -> Array:
        """Where the nail's axis meets the wood, `base`, (3,) [m]."""
        return self.sight.nail.entry

    @property
    def rise(self) -> Array:
        """How the wood rises along x and y of `base`, (2,)."""
        up = self.sight.nail.up
        return np.asarray(-up[:2] / up[2])

    def figures(self) -> dict[str, Any]:
        """Figures by name, for programs."""
        seen = self.sight.nail
        return {
            "entry": seen.entry.tolist(),
            "covariance": seen.covariance.tolist(),
            "up": seen.up.tolist(),
            "tilt_deg": round(float(np.rad2deg(seen.tilt)), 3),
            "corners": seen.corners,
            **self.sight.true_errors(),
            "height_off": float(self.entry[2] - self.config.work.p_base_entry[2]),
        }

    def entries(self, path: Path | None) -> dict[str, Any]:
        """Fields of `work` that the station file takes of it; None: no file, and so no frame but `base`."""
        return nail_fields(self.config.work, self.name, self.entry, self.rise, path)

    def write(self, path: Path) -> None:
        """Enter it in `measured.yaml` beside a station file.

        Args:
            path: The station file.

        Raises:
            ConfigError: The station would be refused with it; nothing was written.
        """
        try:
            write_measured(path, work=self.entries(None))
        except ConfigError as error:
            if why := mistake(self.entry, self.config.work.p_base_entry):
                raise ConfigError(f"{error} ({why})", code=error.code) from error
            raise


@dataclass(frozen=True)
class NailSight:
    """A look at a nail through a print on the wood.

    Attributes:
        config: The station; its work is about the nail.
        station_file: Its file.
        printed: The board on the wood.
        listener: Who hears of it.
    """

    config: StationConfig
    station_file: Path
    printed: Print
    listener: Listener

    def rehearse(self, seed: int, factor: float) -> Sight:
        """Look at a nail with a lab's own camera driver, every device emulated.

        Args:
            seed: Seed of the cell and of what a person measured there.
            factor: Rate of the station's time relative to wall-clock time.

        Returns:
            What was seen.

        Raises:
            TooleeError: The image or the calibration is refused.
        """
        cell = job_cell(self.config, self.station_file, seed)
        laid = print_on_wood(cell.true, SHEETS[self.printed.sheet], np.random.default_rng([seed, 33]))
        cell = replace(cell, options=replace(cell.options, hands_over=False, boards=(laid.placed,)))
        listener = self.listener
        listener.say(f"[bold]Rehearsal, every device emulated[/bold]  [dim]seed {seed}[/dim]")
        with (
            EmulatedLab(cell, listener.prompt, factor, "harsh", Purpose.CALIBRATION, listener.doing) as lab,
            lab.blaming_the_machine(),
        ):
            seen = self._look(lab.station, laid.board, laid.on_wood)
        return Sight(seen, (laid.entry, laid.up))

    def live(self, bars: tuple[float, float], thickness: float) -> Sight:
        """Look at a nail with a lab's camera; nothing moves.

        Args:
            bars: Measured lengths of the print's scale bars [m].
            thickness: Height of the printed side over the wood [m].

        Returns:
            What was seen.

        Raises:
            TooleeError: A device is not there or not ready, or the image or the calibration is refused.
        """
        board = SHEETS[self.printed.sheet].board.measured(*bars)
        at = self.printed.at or (float(board.mark[0]), float(board.mark[1]))
        on_wood = OnWood(at, thickness, self.printed.placing)
        listener = self.listener
        with LabStation(self.config, listener.prompt, purpose=Purpose.CALIBRATION, doing=listener.doing) as lab:
            return Sight(self._look(lab.station, board, on_wood))

    def _look(self, station: Station, board: Board, on_wood: OnWood) -> SeenNail:
        camera = known_camera(self.config, self.station_file, station)
        return see_nail(camera, board, on_wood, *mean_frame(station.camera))


def known_camera(config: StationConfig, station_file: Path, station: Station) -> KnownCamera:
    """What the calibration that a station file names tells of its camera.

    Args:
        config: What the file says.
        station_file: The file.
        station: The devices, which tell their serial numbers.

    Returns:
        The camera.

    Raises:
        ConfigError: There is no calibration, or its record cannot be read or was altered.
        NotReadyError: It is too old, too bad, or of other devices.
    """
    calibration = config.calibration
    if calibration is None:
        raise ConfigError("the station file names no calibration. Run `toolee calibrate camera` first")
    if problems := calibration.problems(station.robot_serial, station.camera_serial, date.today()):
        raise NotReadyError(f"the camera's calibration is not valid: {'; '.join(problems)}")
    if calibration.record is not None:
        return KnownCamera.of_record(read_record(station_file.parent / calibration.record))
    covariance = camera_covariance(config, station_file)
    return KnownCamera(config.camera.X_base_camera, covariance, config.camera.intrinsics, PIXEL_NOISE)


def mistake(entry: Array, by_file: Array) -> str:
    """Name the mistake that explains why a nail is far from where the station file has it.

    Args:
        entry: Where its axis meets the wood, in `base`, (3,) [m].
        by_file: The same by the station file, (3,) [m].

    Returns:
        The mistake in words; empty where the file is near, or no usual one explains it.
    """
    if not camera_is_elsewhere(entry, by_file):
        return ""
    if half_a_turn_apart(entry, by_file):
        return "half a turn of the base: the file's positions are in the other `frame`"
    return "x and y are swapped there: check the file's other positions, too" if axes_swapped(entry, by_file) else ""


def nail_fields(work: WorkConfig, name: str, entry: Array, rise: Array, path: Path | None) -> dict[str, Any]:
    """Compute the fields of `work` that say where a nail and the wood are.

    Args:
        work: The work as the station file has it.
        name: The nail's name.
        entry: Where its axis meets the wood, (3,) [m], `base`.
        rise: How the wood rises along x and y of `base`, (2,).
        path: The station file, which says in which frame it gives positions; None for `base`.

    Returns:
        Values by field; of several `nails`, name and place of the one that was located. There is always a `block_xy`,
        here or in the file: the plane hangs on the middle of the block, and must not move with the next nail.
    """
    data = {} if path is None else read_station(path)
    R = inverse(BaseFrame(data.get("frame", BaseFrame.BASE_LINK)).X_base_this)[:3, :3]
    xy = _rounded(R @ entry)
    center = _center(work, name, entry)
    height = float(entry[2] + rise @ (center - entry[:2])) - work.block_size[2]
    fields: dict[str, Any] = {"stand_height": round(height, 5)}
    if work.block_xy is None:
        fields["block_xy"] = _rounded(R @ np.array([*center, 0.0]))
    fields["wood_rise"] = _rounded(R @ np.array([*rise, 0.0]))
    return fields | ({"nails": [{"name": name, "xy": xy}]} if work.nails else {"nail_xy": xy})


def _rounded(v: Array) -> list[float]:
    return [round(float(value), 5) + 0.0 for value in v[:2]]


def _center(work: WorkConfig, name: str, entry: Array) -> Array:
    """Middle of the block, (2,) [m], `base`: where the file has it, or between the nails with this one where it is."""
    if work.block_xy is not None:
        return np.array(work.block_xy)
    places = np.array([entry[:2] if nail.name == name else nail.xy for nail in work.all_nails])
    return np.asarray((places.min(axis=0) + places.max(axis=0)) / 2)

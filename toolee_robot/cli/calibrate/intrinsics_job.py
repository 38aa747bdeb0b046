"""One calibration of a camera's intrinsics: views, solution and record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.panel import Panel

import toolee_robot
from toolee_robot.calibration.board import SHEETS, Board
from toolee_robot.calibration.intrinsics import calibrate_intrinsics, read_views
from toolee_robot.calibration.intrinsics_record import IntrinsicsRecord, write_intrinsics
from toolee_robot.calibration.observation import BoardView
from toolee_robot.cli.calibrate.recorded_images import check_raw
from toolee_robot.devices.cameras import StatedLens, StreamedCamera
from toolee_robot.devices.cameras.recording import recording_of
from toolee_robot.errors import StaleDataError, UserError
from toolee_robot.hal import Clock
from toolee_robot.runtime.clock import HostClock
from toolee_robot.runtime.json_line import json_line
from toolee_robot.station import SIMULATED, CameraConfig
from toolee_robot.stations.camera import open_camera
from toolee_robot.stations.rehearsal.camera import emulated_stream
from toolee_robot.stations.rehearsal.held_board import HeldBoard, drawn_camera
from toolee_robot.stations.rehearsal.lens import lens_of
from toolee_robot.tasks.calibration.hand_held import HandHeldViews, Offered

PATIENCE = 120.0
"""Time without a new view after which nobody is taken to hold the board [s]."""
IMAGE_TIME = 2.0
"""Longest wait for an image: an emulated camera renders each new view [s]."""


@dataclass
class IntrinsicsJob:
    """A calibration of a camera's intrinsics.

    Attributes:
        sheet: Name of the board's sheet.
        console: The console.
        figures: What --json prints beside the record.
    """

    sheet: str
    console: Console
    figures: dict[str, Any] = field(default_factory=dict)
    _record: IntrinsicsRecord | None = field(default=None, init=False)
    _true: CameraConfig | None = field(default=None, init=False)

    def from_images(self, images: Path, bars: tuple[float, float], serial: str) -> None:
        """Calibrate from a folder of images.

        Args:
            images: The folder.
            bars: Measured lengths of the print's scale bars [m].
            serial: Serial number of the camera.

        Raises:
            UserError: As `calibrate_intrinsics` and `read_views`; or the images are undistorted, or may be
                (`user.intrinsics_undistorted`).
        """
        if (recording := recording_of(images)) is not None:
            check_raw(str(images), recording.undistorted)
        board = SHEETS[self.sheet].board.measured(*bars)
        views, unseen, size = read_views(images, board)
        if unseen:
            self._note(f"the board is not seen in {', '.join(unseen)}")
        self._solve(views, board, size, serial)

    def live(self, camera: CameraConfig, count: int, bars: tuple[float, float]) -> None:
        """Calibrate a camera with a board that somebody holds before it.

        Args:
            camera: The camera.
            count: Number of views.
            bars: Measured lengths of the print's scale bars [m].

        Raises:
            DeviceError: The camera failed.
            UserError: As `calibrate_intrinsics`; or the camera is a recording whose images are undistorted, or may be
                (`user.intrinsics_undistorted`).
        """
        board, clock = SHEETS[self.sheet].board.measured(*bars), HostClock()
        with open_camera(camera, clock, check_intrinsics=False) as opened:
            check_raw("camera.device", opened.profile.undistorted)
            self._collect(opened, clock, board, count, opened.profile.serial)

    def rehearse(self, camera: CameraConfig, count: int, seed: int, factor: float) -> None:
        """Calibrate an emulated camera, whose lens is drawn.

        Args:
            camera: The camera as it tells itself.
            count: Number of views.
            seed: Seed of what is drawn.
            factor: Rate of the station's time relative to wall-clock time.

        Raises:
            DeviceError: The camera failed.
            UserError: As `calibrate_intrinsics`.
        """
        true = self._true = drawn_camera(camera, np.random.default_rng([seed, 41]))
        clock = HostClock(factor)
        held = HeldBoard(true, SHEETS[self.sheet], seed, clock)
        board = SHEETS[self.sheet].board.measured(*held.bars)
        x, y = held.bars
        self.console.print(
            f"[bold]Rehearsal, camera and person emulated[/bold]  [dim]seed {seed}[/dim]\n  the bars of the simulated "
            f"print, whose scale is drawn, measure {x * 1e3:.1f} and {y * 1e3:.1f} mm"
        )
        with (
            emulated_stream(camera, clock, held.seen_from) as stream,
            open_camera(camera, clock, check_intrinsics=False, stream=stream) as opened,
        ):
            self._collect(opened, clock, board, count, SIMULATED)

    def write(self, path: Path) -> IntrinsicsRecord:
        """Write the record.

        Args:
            path: The file.

        Returns:
            The record.

        Raises:
            UserError: It cannot be written.
        """
        assert self._record is not None
        path.parent.mkdir(parents=True, exist_ok=True)
        write_intrinsics(path, self._record)
        return self._record

    def conclude(self, path: Path, written_to: Path | None, as_json: bool) -> None:
        """Tell the result.

        Args:
            path: The record's file.
            written_to: The station file in which the record was entered; None for none.
            as_json: Whether to print the record as a line of JSON, too.
        """
        record = self._record
        assert record is not None
        K = record.intrinsics
        values = zip(("fx", "fy", "cx", "cy"), (K.fx, K.fy, K.cx, K.cy), record.sigma, strict=True)
        rows = [(name, f"{value:9.3f} ± {2 * sigma:.3f} px") for name, value, sigma in values]
        names = zip(("k1", "k2", "p1", "p2"), record.distortion, record.sigma_distortion, strict=True)
        rows += [(name, f"{value:+9.5f} ± {2 * sigma:.5f}") for name, value, sigma in names]
        rows += [
            ("reprojection", f"{record.reprojection:.3f} px, held out {record.held_out:.3f} px"),
            ("views", f"{record.views}, {100 * record.covered:.0f} % of the image"
             + (f"; {record.left_out} corners left out, which do not fit" if record.left_out else "")),
            ("lens", f"displaces pixels by up to {record.largest_distortion:.2f} px"
             + (": images must be undistorted" if record.distorts else ": negligible")),
        ]  # fmt: skip
        if self._true is not None:
            true, found = lens_of(self._true), StatedLens(K, record.distortion).lens
            off = true.largest_difference(found, but_for_a_turn=True)
            self.figures["true_error_px"] = round(off, 3)
            rows.append(("true error *", f"{off:.2f} px at most, but for a turn of the camera"))
        rows.append(("record", escape(str(path))))
        lines = [f"{name:<16}{value}" for name, value in rows]
        if written_to is None:
            lines += ["", "The station file takes it so:", "", "camera:", f"  intrinsics: {escape(str(path))}"]
        else:
            lines += ["", f"Entered in {escape(str(written_to))}. Next: calibrate the camera's place."]
        if self._true is not None:
            lines += ["", "[dim]* by the simulation; a turn goes into the camera's place[/dim]"]
        title = "[bold]the intrinsics are measured[/bold]"
        self.console.print(Panel("\n".join(lines), title=title, border_style="green", expand=False, padding=(1, 2)))
        if as_json:
            print(json_line({**asdict(record), **self.figures}), flush=True)

    def _collect(self, camera: StreamedCamera, clock: Clock, board: Board, count: int, serial: str) -> None:
        k = camera.profile.color.intrinsics
        size = (k.width, k.height)
        views = HandHeldViews(board, size, count)
        self.console.print(
            f"[bold]Views[/bold]  [dim]{count} wanted, in all corners of the image, tilted by 30 to 45°; hold the "
            "board still until it is counted, then otherwise; Ctrl-C ends[/dim]",
            soft_wrap=True,
        )
        try:
            self._take(camera, clock, views, self._show)
        except KeyboardInterrupt:
            self._note("ended before all views were taken")
        self._solve(views.views, board, size, serial)

    def _take(
        self,
        camera: StreamedCamera,
        clock: Clock,
        views: HandHeldViews,
        show: Callable[[HandHeldViews], None],
    ) -> None:
        stamp, last = 0.0, clock.now()
        with self.console.status("looking") as status:
            while not views.complete:
                try:
                    rgb, stamp = camera.distorted(stamp, IMAGE_TIME)
                except StaleDataError:
                    if clock.now() - last > PATIENCE:
                        raise
                    continue
                offered = views.offer(rgb)
                status.update(str(offered))
                if offered is Offered.TAKEN:
                    last = clock.now()
                    self.console.bell()
                    show(views)
                elif clock.now() - last > PATIENCE:
                    raise UserError(
                        f"no new view within {PATIENCE:.0f} s ({offered}): hold the board before the camera",
                        code="user.board_not_held",
                    )

    def _show(self, views: HandHeldViews) -> None:
        lacking = f"; not yet in the {', '.join(views.lacking)}" if views.lacking else ""
        corners = len(views.views[-1].ids)
        self.console.print(
            f"  {len(views.views):>3}  {corners} corners; {100 * views.covered:.0f} % of the image{lacking}"
        )

    def _solve(self, views: list[BoardView], board: Board, size: tuple[int, int], serial: str) -> None:
        with self.console.status("solving"):
            self._record = calibrate_intrinsics(
                views,
                board,
                size,
                camera_serial=serial,
                software=toolee_robot.__version__,
                measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
            )

    def _note(self, text: str) -> None:
        self.console.print(f"  [yellow]{escape(text)}[/yellow]", soft_wrap=True)

"""Calibrate a station: measure where camera, tool tip and nail are in the robot's frame.

Example: toolee calibrate board --sheet a3 --out board.pdf

Example: toolee calibrate camera --station lab.yaml --rehearse
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tyro
from rich.console import Console
from rich.markup import escape
from rich.panel import Panel

from toolee_robot.cli.output import ConsoleListener, Flag, JsonOption
from toolee_robot.errors import UserError
from toolee_robot.runtime.clock import check_real_time_factor

if TYPE_CHECKING:
    from toolee_robot.app.calibrate_nail import Located
    from toolee_robot.frames import Array
    from toolee_robot.station import StationConfig

_BARS_MISSING = (
    "--bars-mm is missing. Measure the two scale bars on your print and give their lengths in millimetres; "
    "printers change the scale"
)
_PLATE = 0.12, 1.2
"""Distance of a rehearsed print from the flange [m], and mass of its plate [kg]."""

Rule = tuple[bool, str]
"""Whether options do not fit together, and the message."""


@dataclass(frozen=True)
class PrintBoard:
    """Write a ChArUco board as a PDF, to print.

    Example: toolee calibrate board --sheet a3 --out board.pdf

    Glue the print on a flat, stiff plate. Printers change the scale: measure the two scale bars on the print with a
    steel rule, to 0.1 mm. Give both lengths to `toolee calibrate camera --bars-mm`.
    """

    sheet: Literal["a4", "a3"] = "a3"
    """Size of the paper. A camera of 512 pixels in width finds an A4 up to 0.9 m away, an A3 up to 1.2 m."""
    out: Annotated[Path, tyro.conf.arg(metavar="PDF")] = Path("board.pdf")
    """The file."""

    def run(self) -> int:
        from toolee_robot.calibration.board import SHEETS
        from toolee_robot.calibration.sheet import write_board

        sheet = SHEETS[self.sheet]
        write_board(self.out, sheet)
        x, y = sheet.board.size
        Console(highlight=False).print(
            f"{self.out}: {sheet.board.columns} x {sheet.board.rows} squares, bars nominally {x * 1e3:.0f} and "
            f"{y * 1e3:.0f} mm.\nPrint it at 100 %. Glue it on a flat plate. Measure both bars on the print."
        )
        return 0


@dataclass(frozen=True, kw_only=True)
class BoardOptions(JsonOption):
    """Options of what a station's camera sees of a printed board, for real or rehearsed."""

    station: Annotated[Path, tyro.conf.arg(metavar="YAML")]
    """The station file."""
    rehearse: Flag = False
    """Emulate every device and the person."""
    sheet: Literal["a4", "a3"] = "a3"
    """The board, as `toolee calibrate board` drew it. An A4 is too small for a camera of 512 pixels at 0.95 m."""
    bars_mm: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y", help_behavior_hint="")] = None
    """Lengths of the board's two scale bars, measured on the print. Leave it out with --rehearse."""
    seed: int = 0
    """Seed of the planned views. In a rehearsal also of the station's errors, the print and the noise."""
    real_time_factor: Annotated[float, tyro.conf.arg(metavar="0.05..1")] = 0.5
    """With --rehearse: speed of the rehearsal; 1 is real time, 0.5 half of it."""
    write: Flag = False
    """Enter the result in `measured.yaml` beside the station file."""

    def refuse(self, *rules: Rule) -> None:
        """Raise the first rule that the options break, of the command's own and of those of all."""
        _refuse(*rules, (self.seed < 0, f"--seed {self.seed}: give 0 or more"))
        check_real_time_factor(self.real_time_factor, "127.0.0.1")


@dataclass(frozen=True, kw_only=True)
class Camera(BoardOptions):
    """Measure where the fixed camera stands, by a board on the flange.

    Example: toolee calibrate camera --station lab.yaml --rehearse

    Example: toolee calibrate camera --station lab.yaml --bars-mm 361.3 258.1 --plate-distance 0.12 --plate-mass 1.2

    Example: toolee calibrate camera --station lab.yaml --images session --bars-mm 361.3 258.1

    The arm moves the board through poses in front of the camera, slowly, while a person holds the hold-to-run switch.
    With --rehearse every device is emulated. With --images the command uses a folder of poses and images.

    Exit code 0: the record is written; 1: a device failed; 2: poses or images are refused, with the reason. Images
    taken so far are kept for --images.
    """

    images: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder with images and poses.json, see docs/how-to/calibrate.md."""
    poses: Annotated[int, tyro.conf.arg(metavar="N")] = 20
    """Number of poses to drive to."""
    plate_distance: Annotated[float | None, tyro.conf.arg(metavar="M", help_behavior_hint="(rehearsed: 0.12)")] = None
    """Distance of the print from the flange."""
    plate_mass: Annotated[float | None, tyro.conf.arg(metavar="KG", help_behavior_hint="(rehearsed: 1.2)")] = None
    """Mass of plate and holder."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("calibrations")
    """Parent of the calibration's folder, which holds camera.json, the record, and the images."""

    def run(self) -> int:
        self._check()
        from toolee_robot.station import load_lab_station

        config = load_lab_station(self.station, complete=self.images is None)
        self._check_entry(config)
        from toolee_robot.app.calibrate_camera import RECORD
        from toolee_robot.calibration.session import FILE
        from toolee_robot.runtime.files import run_folder
        from toolee_robot.station import write_measured

        listener = ConsoleListener(self.console)
        with run_folder(self.out, "camera") as folder:
            try:
                figures = self._calibrate(config, folder.path, listener)
            except BaseException:
                if (folder.path / FILE).is_file():  # images were taken, which cost a person's time
                    kept = folder.keep()
                    listener.warn(f"the images so far are kept in {kept}. To compute with them, give --images {kept}")
                raise
            place = folder.keep()
        if self.write:
            record = os.path.relpath(place / RECORD, self.station.parent)
            write_measured(self.station, calibration={"record": record})
        self._show(figures, place)
        self.tell({**figures, "record": str(place / RECORD)})
        return 0

    def _calibrate(self, config: StationConfig, folder: Path, listener: ConsoleListener) -> dict[str, Any]:
        from toolee_robot.app.calibrate_camera import CameraJob, PlateViews

        job = CameraJob(config, self.sheet, folder, listener)
        views = PlateViews(self.poses, self.plate_distance or _PLATE[0], self.plate_mass or _PLATE[1], self.seed)
        if self.images is not None:
            return job.from_images(self.images, _metres(self.bars_mm), self.station)
        if self.rehearse:
            return job.rehearse(views, self.real_time_factor)
        return job.live(views, _metres(self.bars_mm))

    def _show(self, f: dict[str, Any], folder: Path) -> None:
        from toolee_robot.app.calibrate_camera import RECORD

        record = escape(str(folder / RECORD))
        rows = [
            (f"95 % region at {f['target_m']:g} m", f"± {f['target_radius_mm']:.2f} mm"),
            ("held-out poses", f"{f['residual_mm']:.2f} mm"),
            ("one pose left out", f"{f['largest_shift_mm']:.2f} mm at most"),
            ("noise", f"corners {f['pixel_noise']:.2f} px, arm {f['arm_noise_mm']:.2f} mm {f['arm_noise_deg']:.3f}°"),
            ("poses", f"{f['poses']}" + (f", not fitting: {', '.join(f['wrong'])}" if f["wrong"] else "")),
        ]
        rehearsed = "true_error_mm" in f
        if rehearsed:
            rows.append(("true error *", f"{f['true_error_mm']:.2f} mm"))
        rows.append(("record", record))
        if self.write:
            lines = [f"Entered in {_measured(self.station)}. First do the touch test: toolee calibrate check."]
        else:
            entry = ["calibration:", f"  record: {record}"]
            lines = ["Enter this in the station file:", "", *entry]
        if rehearsed:
            lines += ["", "[dim]* known to the simulation only[/dim]"]
        _panel(self.console, "the camera is calibrated", rows, lines)

    def _check_entry(self, config: StationConfig) -> None:
        """Refuse before anything moves what --write could not enter, or must not."""
        from toolee_robot.station import REHEARSED, SIMULATED

        known = config.calibration
        if not self.write or known is None:
            return
        _refuse(
            (
                known.record is None,
                f"{self.station} already gives a calibration by hand (measured_on and others). Delete that section, "
                "then use --write",
            ),
            (
                self.rehearse and known.robot_serial not in (SIMULATED, REHEARSED),
                f"{self.station} names the calibration of the real robot {known.robot_serial}, and a rehearsal must "
                "not replace it. Rehearse with a copy of the file, or without --write",
            ),
        )

    def _check(self) -> None:
        moves = not self.rehearse and self.images is None
        self.refuse(
            (self.images is not None and self.rehearse, "give --images or --rehearse, not both"),
            (
                self.rehearse and self.bars_mm is not None,
                "leave --bars-mm out: with --rehearse the emulated person measures the print",
            ),
            (not self.rehearse and self.bars_mm is None, _BARS_MISSING),
            (
                moves and None in (self.plate_distance, self.plate_mass),
                "--plate-distance and --plate-mass are missing. Measure the distance from the flange to the print, "
                "and weigh plate and holder. The arm's motions depend on both",
            ),
            (not 8 <= self.poses <= 100, "give --poses 8 to 100"),
        )


@dataclass(frozen=True, kw_only=True)
class Check(JsonOption):
    """Compare a corner as the camera sees it and as the arm touches it.

    Example: toolee calibrate check --record camera.json --image board.png --bars-mm 251.2 179.4 --corner 0 --touched-mm
    602.1 -148.7 262.3 --frame pendant_base

    Lay a board in the camera's view, within the arm's reach, and take an image. Touch a corner with a pointed tip as
    the TCP, and read X Y Z on the pendant. The command adds the result to the record and signs it again. Small
    residuals do not prove accuracy, but this check does.

    Exit code 0: the two agree; 1: they do not; 2: invalid input.
    """

    record: Annotated[Path, tyro.conf.arg(metavar="JSON")]
    """The calibration's record."""
    image: Annotated[Path, tyro.conf.arg(metavar="PNG")]
    """Image of the board by the calibrated camera."""
    bars_mm: Annotated[tuple[float, float], tyro.conf.arg(metavar="X Y")]
    """Lengths of the board's two scale bars, measured on the print."""
    corner: Annotated[int, tyro.conf.arg(metavar="N")]
    """Number of the inner corner: 0 is the first, beside the board's origin, counted along x first."""
    touched_mm: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")]
    """Position of the tip on the corner."""
    frame: Literal["pendant_base", "base_link"]
    """Frame of that position: the pendant's Base, or ROS's base_link."""
    touch_error_mm: Annotated[float, tyro.conf.arg(metavar="MM")]
    """Standard deviation of a touch about one axis, such as 0.5: touch a corner five times, from different sides."""
    sheet: Literal["a4", "a3"] = "a4"
    """The board."""

    def run(self) -> int:
        if not 0.01 <= self.touch_error_mm <= 10.0:
            raise UserError(f"--touch-error-mm {self.touch_error_mm}: give 0.01 to 10")
        console = self.console
        from datetime import UTC, datetime

        from toolee_robot.calibration.board import SHEETS
        from toolee_robot.calibration.observation import find_board
        from toolee_robot.calibration.record import read_record, write_record
        from toolee_robot.calibration.session import read_image
        from toolee_robot.calibration.touches import cause, see_corner, touch_check
        from toolee_robot.frames import BaseFrame

        record = read_record(self.record)
        board = SHEETS[self.sheet].board.measured(*_metres(self.bars_mm))
        view = find_board(read_image(self.image, record.intrinsics), board)
        if view is None:
            raise UserError(f"no board in {self.image}: move it nearer, or add light")
        seen = see_corner(record, board, view, self.corner)
        X = BaseFrame(self.frame).X_base_this
        touched = X[:3, :3] @ (np.array(self.touched_mm) / 1e3)
        now = datetime.now(UTC).isoformat(timespec="seconds")
        check = touch_check(
            record, seen, touched, self.touch_error_mm / 1e3, f"corner {self.corner}, {self.image.name}", now
        )
        write_record(self.record, record.checked(check))
        agrees = check.error <= check.allowed
        color = "green" if agrees else "red"
        console.print(
            f"seen at ({_mm(check.seen, '.1f')}) mm, touched at ({_mm(check.touched, '.1f')}) mm, in "
            f"base_link\n[{color}]{check.error * 1e3:.2f} mm apart[/{color}]; calibration, image and touch explain "
            f"{check.allowed * 1e3:.2f} mm (95 %)"
        )
        if not agrees:
            console.print(f"[red]{cause(check)}[/red]", soft_wrap=True)
        self.tell({**asdict(check), "agrees": agrees})
        return int(not agrees)


@dataclass(frozen=True, kw_only=True)
class Mount(JsonOption):
    """Locate a tip on the flange from touches of one fixed point.

    Example: toolee calibrate mount --touches touches.yaml --station lab.yaml

    Fix a pointed pin on the flange or in the mount. Bring its tip to one fixed point in at least five orientations.
    They must differ by 25° or more about two axes. The file lists the joint positions: `touches: [[q1, ..., q6], ...]`.
    The result is the TCP of a touch test. Of a pin in a mount it is the value for `hand.mount.position`, too.

    Exit code 0: the tip is located; 2: the touches are refused, with the reason.
    """

    touches: Annotated[Path, tyro.conf.arg(metavar="YAML")]
    """The joint positions."""
    station: Annotated[Path, tyro.conf.arg(metavar="YAML")]
    """The station file: the arm's model and kinematics."""

    def run(self) -> int:
        from toolee_robot.calibration.touches import locate_tip, read_touches
        from toolee_robot.control import RobotModel
        from toolee_robot.station import load_station

        arm = RobotModel.of_station(load_station(self.station)).arm
        tip = locate_tip([arm.fk(np.array(q)) for q in read_touches(self.touches).touches])
        sigmas = 2.0 * np.sqrt(np.diag(tip.covariance))
        x, y, z = tip.p_flange_tip
        self.console.print(
            f"tip in the flange: ({_mm(tip.p_flange_tip)}) ± ({_mm(sigmas)}) mm\nthe touches scatter by "
            f"{tip.residual * 1e3:.2f} mm around their common point\n\nOf a mount, for `hand.mount`:\n"
            f"    position: [{x:.5f}, {y:.5f}, {z:.5f}]"
        )
        self.tell({name: value.tolist() if hasattr(value, "tolist") else value for name, value in vars(tip).items()})
        return 0


@dataclass(frozen=True, kw_only=True)
class Nail(BoardOptions):
    """Locate a nail and the wood by the camera.

    Example: toolee calibrate nail --station lab.yaml --rehearse

    Example: toolee calibrate nail --station lab.yaml --bars-mm 361.3 258.1 --thickness-mm 3.2 --write

    Nothing moves. Lay a board from `toolee calibrate board` flat on the wood, glued or on a stiff plate, with the nail
    through its white cross.

    Exit code 0: the nail is located; 1: a device failed; 2: the image is refused, with the reason.
    """

    nail: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """Which of several nails (work.nails)."""
    thickness_mm: Annotated[float | None, tyro.conf.arg(metavar="MM", help_behavior_hint="")] = None
    """Height of the printed side above the wood: paper and plate."""
    at_mm: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y", help_behavior_hint="")] = None
    """Position of the nail on the board, from the outer corner of the first square, along the bars x and y
    (default: the white cross).
    """
    placing_mm: Annotated[float, tyro.conf.arg(metavar="MM")] = 0.5
    """Standard deviation of that position along each axis: how well the nail meets the cross."""

    def run(self) -> int:
        self._check()
        from toolee_robot.app.calibrate_nail import Located, NailSight, Print
        from toolee_robot.station import check_upright, load_lab_station

        config = load_lab_station(self.station)
        check_upright(config.arm, "the place of a nail")
        names = config.work.names
        name = names[0] if self.nail is None else self.nail
        if name not in names:
            raise UserError(f"--nail {name}: the station's nails are {', '.join(names)} (work.nails)")
        config = replace(config, work=config.work.only(name))
        printed = Print(self.sheet, None if self.at_mm is None else _metres(self.at_mm), self.placing_mm / 1e3)
        look = NailSight(config, self.station, printed, ConsoleListener(self.console))
        if self.rehearse:
            sight = look.rehearse(self.seed, self.real_time_factor)
        else:
            sight = look.live(_metres(self.bars_mm), (self.thickness_mm or 0.0) / 1e3)
        located = Located(config, name, sight)
        if self.write:
            located.write(self.station)
        self._show(located)
        self.tell(located.figures())
        return 0

    def _show(self, located: Located) -> None:
        from toolee_robot.app.calibrate_nail import mistake

        rows, by_file = _nail_rows(located), located.config.work.p_base_entry
        rows.append(("difference to the station file", f"({_mm(located.entry - by_file, '+.2f')}) mm"))
        if why := mistake(located.entry, by_file):
            rows.append(("", f"[red]{why}[/red]"))
        true = located.sight.true_errors()
        if true:
            beside, height, tilt = true.values()
            rows.append(("true errors *", f"beside {beside} mm, height {height} mm, tilt {tilt}°"))
        entries = located.entries(None if self.write else self.station)  # measured.yaml is in base_link
        where = f"Entered in {_measured(self.station)}, in base_link:" if self.write else "In the station file:"
        lines = [where, "work:"]
        lines += [f"  {name}: {value}" for name, value in entries.items() if name != "nails"]
        lines += [f"  nails, {nail['name']}: xy: {nail['xy']}" for nail in entries.get("nails", ())]
        if true:
            lines += ["", "[dim]* known to the simulation only[/dim]"]
        _panel(self.console, "the nail is located", rows, lines)

    def _check(self) -> None:
        of_print = self.bars_mm, self.thickness_mm
        self.refuse(
            (
                not self.rehearse and None in of_print,
                "--bars-mm and --thickness-mm are missing. Measure the two scale bars on your print, and the "
                "height of its printed side over the wood",
            ),
            (
                self.rehearse and of_print != (None, None),
                "leave --bars-mm and --thickness-mm out: with --rehearse the emulated person measures the print",
            ),
            (not 0.0 <= (self.thickness_mm or 0.0) <= 50.0, f"--thickness-mm {self.thickness_mm}: give 0 to 50"),
            (self.write and self.rehearse, "leave --write out: a rehearsed nail would replace your real one"),
            (not 0.01 <= self.placing_mm <= 10.0, "give --placing-mm 0.01 to 10"),
        )


COMMANDS = {
    "calibrate": {
        "board": PrintBoard,
        "camera": Camera,
        "check": Check,
        "mount": Mount,
        "nail": Nail,
    }
}


def _refuse(*rules: Rule) -> None:
    """Raise the first rule that options break."""
    for broken, message in rules:
        if broken:
            raise UserError(message)


def _measured(station: Path | None) -> str:
    from toolee_robot.station import measured_path

    assert station is not None, "checked before"
    return escape(str(measured_path(station)))


def _metres(mm: tuple[float, float] | None) -> tuple[float, float]:
    assert mm is not None
    return mm[0] / 1e3, mm[1] / 1e3


def _mm(values: Array | tuple[float, ...], spec: str = ".2f") -> str:
    return ", ".join(f"{1e3 * value:{spec}}" for value in values)


def _panel(console: Console, title: str, rows: list[tuple[str, str]], lines: list[str], width: int = 24) -> None:
    text = "\n".join([*(f"{name:<{width}}{value}" for name, value in rows), "", *lines])
    console.print(Panel(text, title=f"[bold]{title}[/bold]", border_style="green", expand=False, padding=(1, 2)))


def _nail_rows(located: Located) -> list[tuple[str, str]]:
    """What was seen of the nail and the wood."""
    seen = located.sight.nail
    sigmas = 2 * np.sqrt(np.diag(seen.covariance))
    return [
        ("nail at the wood", f"({_mm(seen.entry)}) ± ({_mm(sigmas)}) mm in base_link (95 %)"),
        ("tilt of the wood", f"{np.rad2deg(seen.tilt):.2f} ± {np.rad2deg(2 * seen.tilt_sigma):.2f}°"),
        ("board", f"{seen.corners} corners, {seen.reprojection:.2f} px"),
    ]

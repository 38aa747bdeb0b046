"""`toolee estimate` and `toolee annotate`: poses in the files of any RGB-D camera, and tests made of them by clicks."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from toolee_robot.cli.output import Flag, JsonOption, serve, text_table
from toolee_robot.end_effectors import CATEGORIES
from toolee_robot.errors import UserError
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.pose_text import pose_text, sigma_text
from toolee_robot.station import sim_station
from toolee_robot.types import HoldingHand, RgbdFrame, ToolEstimate

if TYPE_CHECKING:
    from toolee_robot.perception import ToolPerception

_File = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]


@dataclass(frozen=True)
class Estimate(JsonOption):
    """Find the tools' end effectors in your own RGB-D files and estimate their 6D poses.

    Example: toolee estimate --rgb 7.png --depth 7d.png --depth-scale 0.001 --intrinsics 365.5,365.5,254.9,205.4

    Example: toolee estimate --bop examples/frame --json

    Poses are in the camera's OpenCV frame (x right, y down, z forward), in metres; docs/concepts/frames.md defines the
    four end-effector frames. Exit code 0: at least one usable pose; 1: none, with the reason; 2: invalid input.
    """

    rgb: _File = None
    """Colour image, 8 bit (PNG, JPEG)."""
    depth: _File = None
    """Depth registered to it: 16-bit PNG or .npy; 0 or NaN where unknown."""
    depth_scale: Annotated[float | None, tyro.conf.arg(metavar="S", help_behavior_hint="")] = None
    """Metres per unit of the depth file: 0.001 for millimetres, 1 for metres."""
    intrinsics: Annotated[str | None, tyro.conf.arg(metavar="FX,FY,CX,CY", help_behavior_hint="")] = None
    """Pinhole intrinsics [px] of the colour image, undistorted."""
    hand_pose: _File = None
    """X_camera_hand, 16 numbers row by row [m] (text, .json, .npy). It selects the rotation about the axis of a
    symmetric tool.
    """
    hand: Annotated[str, tyro.conf.arg(metavar="NAME")] = sim_station().hand.model
    """Model of the hand of --hand-pose."""
    bop: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Instead of one frame: a BOP scene folder with rgb/, depth/ and scene_camera.json."""
    picture: Annotated[Path | None, tyro.conf.arg(metavar="OUT.png", help_behavior_hint="")] = None
    """Also draw the result (not with --bop)."""
    json: Flag = False
    """Print JSON only: a list of estimates, or with --bop one line a frame."""

    def run(self) -> int:
        console = self.console
        if self.bop is not None:
            given = [
                n for n in ("rgb", "depth", "depth_scale", "intrinsics", "hand_pose", "picture") if getattr(self, n)
            ]
            if given:
                raise UserError(f"leave --{given[0].replace('_', '-')} out: --bop reads everything from its folder")
            return self._run_bop(console, self.bop)
        return self._run_frame(console)

    def _run_frame(self, console: Console) -> int:
        missing = [n for n in ("rgb", "depth", "depth_scale", "intrinsics") if getattr(self, n) is None]
        if self.rgb is None or self.depth is None or self.depth_scale is None or self.intrinsics is None:
            raise UserError(f"also give {', '.join('--' + n.replace('_', '-') for n in missing)} (or --bop DIR)")
        from toolee_robot.perception import ToolPerception
        from toolee_robot.perception.io import as_record, read_frame, read_pose

        frame = read_frame(self.rgb, self.depth, self.intrinsics, self.depth_scale)
        hand = None
        if self.hand_pose is not None:
            from toolee_robot.robots import hand_model

            hand = HoldingHand(read_pose(self.hand_pose), hand_model(self.hand).grasp.R_hand_tool)
        estimates, elapsed_ms = _timed(ToolPerception.load(), frame, hand)
        self.tell([as_record(e) for e in estimates])
        if not self.json:
            console.print(_table(estimates, f"{self.rgb.name}: {elapsed_ms:.0f} ms"))
        if self.picture is not None:  # after the estimates: a place that cannot be written does not cost them
            from toolee_robot.recording.picture import draw

            write_atomic(self.picture, draw(frame, estimates, title=self.rgb.name))
            console.print(f"picture: {escape(str(self.picture))}", soft_wrap=True)
        return _verdict(console, estimates)

    def _run_bop(self, console: Console, folder: Path) -> int:
        from toolee_robot.perception import ToolPerception
        from toolee_robot.perception.io import as_record, bop_images

        images = bop_images(folder)
        perception = ToolPerception.load()
        usable = unreadable = 0
        for image in images:
            line: dict[str, Any] = {"im_id": image.im_id, "time_ms": None, "estimates": []}
            try:
                frame = image.read()
            except UserError as error:  # one bad file does not cost the rest of the scene
                unreadable += 1
                console.print(f"[bold red]image {image.im_id}:[/bold red] {escape(str(error))}", soft_wrap=True)
                line["error"] = str(error)
            else:
                estimates, elapsed_ms = _timed(perception, frame, None)
                usable += any(e.usable for e in estimates)
                line |= {"time_ms": round(elapsed_ms, 1), "estimates": [as_record(e) for e in estimates]}
                if not self.json:
                    console.print(_table(estimates, f"image {image.im_id}: {elapsed_ms:.0f} ms"))
            self.tell(line)
        console.print(f"{usable} of {len(images)} frames have a usable pose")
        if unreadable:
            raise UserError(f"{unreadable} of {len(images)} frames could not be read. The messages above say why")
        return 0 if usable else 1


def _timed(perception: ToolPerception, frame: RgbdFrame, hand: HoldingHand | None) -> tuple[list[ToolEstimate], float]:
    """The estimates of a frame, and their wall-clock time [ms]."""
    start = time.perf_counter()
    estimates = perception.estimate(frame, hand)
    return estimates, (time.perf_counter() - start) * 1e3


def _verdict(console: Console, estimates: list[ToolEstimate]) -> int:
    if any(e.usable for e in estimates):
        return 0
    said = Console(stderr=True, highlight=False) if not console.stderr else console
    if not estimates:
        said.print(
            f"[bold red]no tool found:[/bold red] no {', '.join(c.label for c in CATEGORIES)} is in view. "
            "Bring the end effector to 0.4 to 1.1 m before the camera"
        )
    else:
        reasons = "; ".join(f"{e.category.label}: {e.reason}" for e in estimates)
        said.print(f"[bold red]no usable pose:[/bold red] {escape(reasons)}", soft_wrap=True)
    return 1


def _table(estimates: list[ToolEstimate], title: str) -> Table:
    """What a person acts on; the detector's score and the pose's confidence, which the trust weighs, are in --json."""
    table = Table(title=title, title_justify="left", show_edge=False)
    table.add_column("end effector", min_width=len("screwdriver"))
    table.add_column("X_camera_ee: position\nrotation vector", no_wrap=True)
    table.add_column("uncertainty", no_wrap=True)
    table.add_column("trust")
    table.add_column("usable")
    for e in estimates:
        table.add_row(
            e.category.label,
            pose_text(e.X_camera_ee).replace("  ", "\n"),  # position over rotation: it fits 80 columns
            sigma_text(e.covariance, e.X_camera_ee).replace("  ", "\n"),
            f"{e.trust:.2f}",
            "[green]yes[/green]" if e.usable else f"[red]no: {escape(e.reason)}[/red]",
        )
    return table


@dataclass(frozen=True)
class Annotate(JsonOption):
    """Make a test of your own RGB-D frames: click the tools' end effectors, get their poses with their uncertainty.

    Example: toolee annotate my_frames

    Example: toolee annotate my_frames --clicks my_frames/clicks.yaml

    The command opens a page on this computer. Ctrl-C ends it and writes frames.json, which
    `toolee evaluate photographs my_frames` scores. Clicks are saved in clicks.yaml at once, and a later call continues
    with them. docs/how-to/own_test.md says how to take the frames and what to click. Exit code 0: every clicked end
    effector has a pose; 1: some have none.
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """A recording by `toolee camera record`, or another folder in the BOP layout."""
    clicks: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Fit the clicks of this file, without the page."""
    port: Annotated[int, tyro.conf.arg(metavar="N")] = 8080
    """Port of the page."""

    def run(self) -> int:
        from toolee_robot.perception.offline.annotation.frame_set import FrameSet, Session, end_record

        console = self.console
        frames = FrameSet(self.folder, self.clicks)
        if self.clicks is None:
            from toolee_robot.viewer.annotation_page import AnnotationPage

            page = AnnotationPage(Session(frames), self.port)
            serve(page, console, "Ctrl-C ends it and writes the test.")
        with console.status("fitting the clicks"):
            written = frames.write()
        rows = [end_record(f.name, end) for f in written for end in f.ends]
        columns = ("frame", "end", "position [mm]", "rotation [deg]", "residuals", "checks")
        if rows:
            console.print(text_table("Standard deviations of the clicked poses", columns, [r["cells"] for r in rows]))
        refused = [r for r in rows if r["problem"] is not None]
        for row in refused:
            console.print(f"[bold]{row['frame']}[/bold]: {escape(row['problem'])}", soft_wrap=True)
        complete = [f for f in written if f.complete]
        console.print(
            f"{len(complete)} of {len(frames.names)} frames in {escape(str(self.folder / 'frames.json'))}: "
            f"{sum(bool(f.ends) for f in complete)} with a tool, {sum(not f.ends for f in complete)} without",
            soft_wrap=True,
        )
        record = [{k: v for k, v in row.items() if k != "cells"} for row in rows]
        self.tell({"frames": len(complete), "ends": record})
        return 1 if any(r["problem"] is not None or not r["known"] for r in rows) else 0


COMMANDS = {"estimate": Estimate, "annotate": Annotate}

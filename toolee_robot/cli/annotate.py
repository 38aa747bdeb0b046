"""`toolee annotate`: makes a test of one's own RGB-D frames by clicks on them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import text_table
from toolee_robot.cli.serving import serve
from toolee_robot.runtime.json_line import json_line


@dataclass(frozen=True)
class Annotate:
    """Make a test of your own RGB-D frames: click the tools' end effectors, get their poses with their uncertainty.

    Example: toolee annotate my_frames

    Example: toolee annotate my_frames --clicks my_frames/clicks.yaml

    Opens a page on this computer; Ctrl-C ends it and writes frames.json, which `toolee evaluate photographs my_frames`
    scores. Clicks are saved in clicks.yaml at once, and a later call goes on with them. docs/how-to/own_test.md says
    how to take the frames and what to click. Exit code 0: every end that was clicked has a pose; 1: not every one.
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """A recording by `toolee camera record`, or another folder in the BOP layout."""
    clicks: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Fit the clicks of this file, without the page."""
    port: Annotated[int, tyro.conf.arg(metavar="N")] = 8080
    """Port of the page."""
    json: Flag = False
    """Print one line of JSON; everything for people goes to standard error."""

    def run(self) -> int:
        from toolee_robot.perception.offline.annotation.frame_set import FrameSet, Session

        console = Console(stderr=self.json, highlight=False)
        frames = FrameSet(self.folder, self.clicks)
        if self.clicks is None:
            from toolee_robot.viewer.annotation_page import AnnotationPage

            page = AnnotationPage(Session(frames), self.port)
            serve(page, console, "Ctrl-C ends it and writes the test.")
        with console.status("fitting the clicks"):
            written = frames.write()
        rows = [_row(f.name, end) for f in written for end in f.ends]
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
        if self.json:
            record = [{k: v for k, v in row.items() if k != "cells"} for row in rows]
            print(json_line({"frames": len(complete), "ends": record}))
        return 1 if any(r["problem"] is not None or not r["known"] for r in rows) else 0


def _row(name: str, end: Any) -> dict[str, Any]:
    """One end effector, for the table and for JSON."""
    from toolee_robot.perception.offline.annotation.poses import AnnotatedEnd

    if not isinstance(end, AnnotatedEnd):
        cells = [name, "no pose", "-", "-", "-", "-"]
        return {"frame": name, "problem": str(end), "code": end.code, "known": False, "cells": cells}
    checks = ", ".join(
        f"{c.measured_mm:.1f}: {c.fitted_mm:.1f} mm{'' if c.agrees else ' DISAGREES'}" for c in end.checks
    )
    label, scale = end.category.spec.label, f"{end.fit.scale:.1f}x"
    cells = [name, label, f"{end.sigma_mm:.1f}", f"{end.sigma_deg:.1f}", scale, checks or "-"]
    return {
        "frame": name,
        "problem": None,
        "known": end.known,
        "category": str(end.category),
        "X_camera_ee": end.fit.X_camera_ee.tolist(),
        "sigma_mm": end.sigma_mm,
        "sigma_deg": end.sigma_deg,
        "scale": end.fit.scale,
        "wrong": end.fit.wrong,
        "checks": [asdict(c) | {"agrees": c.agrees} for c in end.checks],
        "cells": cells,
    }


COMMANDS = {"": Annotate}

"""`toolee camera doctor`: checks a camera alone."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from rich.console import Console

from toolee_robot.cli.camera.options import CameraOptions
from toolee_robot.cli.doctor import findings_table
from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.errors import UserError
from toolee_robot.findings import Finding, Level, warn, worst
from toolee_robot.station import load_station

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from toolee_robot.types import RgbdFrame


@dataclass(frozen=True)
class CheckCamera(CameraOptions):
    """Check a camera: rate and clock, exposure, lens, holes on a tool that is held before it, least range for views.

    Example: toolee camera doctor --config lab.yaml

    Exit code 0: as it should be, or warnings only; 1: a fault must be repaired first; 2: invalid input.
    """

    seconds: float = 3.0
    """How long to listen to it."""
    no_tool: Flag = False
    """Do not look for a tool, which takes the networks."""

    def run(self) -> int:
        from toolee_robot.doctor.camera import (
            check_exposure,
            check_holes,
            check_lens,
            check_range,
            check_stream,
            sample_stream,
        )
        from toolee_robot.runtime.clock import HostClock

        if self.seconds <= 0:
            raise UserError(f"--seconds {self.seconds:g}: give a time above 0", code="user.option")
        console = Console(stderr=self.json, highlight=False)
        config, clock = self.camera(), HostClock()
        with console.status("listening to the camera"), self.open(clock) as camera:
            sample = sample_stream(camera, clock, self.seconds)
            findings = [
                *check_stream(sample, camera),
                *check_exposure(sample.frames[-5:], camera.profile.auto_exposure),
                check_lens(camera),
            ]
            if self.config is not None and not camera.intrinsics.agrees(config.intrinsics):
                findings.append(
                    Finding(Level.FAIL, "intrinsics", "not the station file's", "`toolee camera show` prints them")
                )
        if not self.no_tool:
            with console.status("looking for a tool"):
                findings.append(check_holes(sample.frames[-1], _tool(sample.frames[-1])))
        if self.config is not None:
            findings.append(check_range(load_station(self.config)))
        else:
            findings.append(warn("range", "not compared with the views", "give --config, with camera.device"))
        console.print(findings_table(findings))
        level = worst(findings)
        if self.json:
            print(json_line({"worst": level, "findings": [asdict(f) for f in findings]}), flush=True)
        return int(level is Level.FAIL)


def _tool(frame: RgbdFrame) -> NDArray[np.bool_] | None:
    """Pixels of the tool that is seen best; None without one."""
    from toolee_robot.perception.pipeline import ToolPerception

    estimates = ToolPerception.load().estimate(frame)
    best = max(estimates, key=lambda e: e.detection.score, default=None)
    if best is None:
        return None
    return best.detection.mask if best.detection.tool_mask is None else best.detection.tool_mask

"""`toolee camera record`: records a camera's frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from toolee_robot.cli.camera.options import CameraOptions
from toolee_robot.cli.output import json_line
from toolee_robot.errors import UserError


@dataclass(frozen=True)
class Record(CameraOptions):
    """Record the frames of a camera, as a job would get them: undistorted, registered, with their stamps.

    Example: toolee camera record --config lab.yaml --out frames --seconds 5

    The folder can be played (`--recording frames`, or the driver `recorded` in a station file), and `toolee estimate
    --bop frames` finds the tools in it. Ctrl-C ends the recording, which is kept.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """A new folder."""
    seconds: float = 5.0
    """How long."""
    every: Annotated[float, tyro.conf.arg(metavar="S")] = 0.0
    """Record one frame every so many seconds, of which the terminal rings; 0: every frame."""

    def run(self) -> int:
        from toolee_robot.devices.cameras.recording import RecordingWriter
        from toolee_robot.runtime.clock import HostClock

        if self.seconds <= 0:
            raise UserError(f"--seconds {self.seconds:g}: give a time above 0", code="user.option")
        if self.every < 0:
            raise UserError(f"--every {self.every:g}: give a time above 0, or leave it out", code="user.option")
        console = Console(stderr=self.json, highlight=False)
        clock, count, stamp, due = HostClock(), 0, 0.0, 0.0
        with self.open(clock) as camera:
            profile = camera.profile
            # What is played and does not say whether it is undistorted does not say so afterwards, either.
            undistorted = camera.lens.lens.known or profile.undistorted
            writer = RecordingWriter(
                self.out, profile.model, profile.serial, profile.fps, camera.intrinsics, undistorted=undistorted
            )
            end = clock.now() + self.seconds
            with writer, console.status("recording"):
                while clock.now() < end:
                    frame = camera.newer(stamp)
                    stamp = frame.stamp
                    if stamp < due:
                        continue
                    due = stamp + self.every
                    writer.add(frame)
                    count += 1
                    if self.every:
                        console.bell()
        rate = count / self.seconds
        console.print(f"{count} frames in {self.out}, {rate:.1f} of {profile.fps:g} a second", soft_wrap=True)
        if self.json:
            print(json_line({"folder": str(self.out), "frames": count, "rate": rate}), flush=True)
        return 0

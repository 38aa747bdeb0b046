"""Train the detector, its masks' refiner or the pose network, or fit how far they are to be trusted.

Example: toolee train segmentation --data data/hard/train --out runs/segmentation
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from toolee_robot.cli.options import Flag
from toolee_robot.cli.progress import progress_bars
from toolee_robot.cli.train.images import Refinement, Segmentation
from toolee_robot.cli.train.options import File
from toolee_robot.cli.train.pose import Clouds, Pose
from toolee_robot.runtime.json_line import json_line


@dataclass(frozen=True)
class Trust:
    """Fit how far a pose under the detector's mask is to be trusted, once both networks are trained.

    Example: toolee train trust --data data/hard-trust/train --weights runs/both --workers 2

    Take data that neither network was trained on, and that nothing is reported on.
    """

    data: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """A data set, or one split of it."""
    weights: File = None
    """Folder with the weights of both networks, where trust.json goes, too (default: those that ship)."""
    frames: Annotated[int, tyro.conf.arg(metavar="N")] = 1000
    """Without a tool, to render beside."""
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Of these frames."""
    workers: Annotated[int, tyro.conf.arg(metavar="W")] = 1
    """Processes at a time."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        console = Console(stderr=self.json, highlight=False)
        from toolee_robot.perception.offline.fit_trust import fit_trust

        with progress_bars(console) as report_progress:
            report = fit_trust(
                self.data,
                self.weights,
                self.frames,
                self.seed,
                self.workers,
                partial(report_progress, "scene folders, then frames without a tool"),
            )
        console.print(
            f"fitted on {report['poses']} poses in {report['images']} images and {report['frames_without_a_tool']} "
            f"frames without a tool\n{report['usable_right']:.3f} of the usable poses are right, "
            f"{report['right_usable']:.3f} of the right ones usable; {report['quiet']:.3f} of the frames without a "
            "tool give none"
        )
        if self.json:
            print(json_line(report), flush=True)
        return 0


COMMANDS = {
    "segmentation": Segmentation,
    "refinement": Refinement,
    "clouds": Clouds,
    "pose": Pose,
    "trust": Trust,
}

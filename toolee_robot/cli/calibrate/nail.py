"""`toolee calibrate nail`: where the nail is, from touches of its head."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.config import load_station


@dataclass(frozen=True, kw_only=True)
class Nail:
    """Locate the nail from touches of its head's middle with a known tip.

    Example: toolee calibrate nail --touches nail.yaml --tip-mm 0.3 -0.2 151.4 --config lab.yaml

    Touch the middle of the head three times or more, from different sides. The file lists the joint positions, as for
    `toolee calibrate mount`, which also locates the tip.

    Exit code 0: the nail is located; 2: the touches are refused, for the reason given.
    """

    touches: Annotated[Path, tyro.conf.arg(metavar="YAML")]
    """The joint positions."""
    tip_mm: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")]
    """The tip in the flange."""
    config: Annotated[Path, tyro.conf.arg(metavar="YAML")]
    """The station file: the arm's model and kinematics, and the height that it has for the nail."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        console = Console(stderr=self.json, highlight=False)
        config = load_station(self.config)
        import numpy as np

        from toolee_robot.calibration.nail import locate_nail
        from toolee_robot.calibration.tip import read_touches
        from toolee_robot.control import RobotModel

        arm = RobotModel.of_station(config).arm
        flange = [arm.fk(np.array(q)) for q in read_touches(self.touches).touches]
        nail = locate_nail(flange, np.array(self.tip_mm) / 1e3)
        x, y, z = nail.head
        expected = config.work.X_base_nail()[2, 3]
        console.print(
            f"middle of the nail's head: ({x * 1e3:.2f}, {y * 1e3:.2f}, {z * 1e3:.2f}) mm in base_link, the touches "
            f"{nail.spread * 1e3:.2f} mm apart\n"
            f"by the station file the head's top is at {expected * 1e3:.2f} mm: {1e3 * (z - expected):+.2f} mm\n\n"
            f"frame: base_link        # in a file with frame: pendant_base give [{-x:.5f}, {-y:.5f}]\n"
            f"work:\n  nail_xy: [{x:.5f}, {y:.5f}]",
            soft_wrap=True,
        )
        if self.json:
            print(
                json_line({"head": list(nail.head), "spread": nail.spread, "height_off": z - float(expected)}),
                flush=True,
            )
        return 0

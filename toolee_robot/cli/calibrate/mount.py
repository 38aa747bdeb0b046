"""`toolee calibrate mount`: where a tip on the flange is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from toolee_robot.cli.options import Flag
from toolee_robot.runtime.json_line import json_line
from toolee_robot.station import load_station, sim_station


@dataclass(frozen=True, kw_only=True)
class Mount:
    """Locate a tip on the flange from touches of one fixed point.

    Example: toolee calibrate mount --touches touches.yaml --config lab.yaml

    Clamp a pointed pin in the mount, and bring its tip to one fixed point in five orientations or more that turn the
    flange by 25° and more about two axes. The file lists the joint positions: `touches: [[q1, ..., q6], ...]`. The
    result is what `hand.mount.position` needs, and the TCP of a touch test.

    Exit code 0: the tip is located; 2: the touches are refused, for the reason given.
    """

    touches: Annotated[Path, tyro.conf.arg(metavar="YAML")]
    """The joint positions."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """The station file: the arm's model and kinematics."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        console = Console(stderr=self.json, highlight=False)
        config = sim_station() if self.config is None else load_station(self.config)
        import numpy as np

        from toolee_robot.calibration.tip import locate_tip, read_touches
        from toolee_robot.control import RobotModel

        arm = RobotModel.of_station(config).arm
        tip = locate_tip([arm.fk(np.array(q)) for q in read_touches(self.touches).touches])
        sigma = 2e3 * np.sqrt(np.diag(tip.covariance))
        x, y, z = tip.p_flange_tip
        console.print(
            f"tip in the flange: ({x * 1e3:.2f}, {y * 1e3:.2f}, {z * 1e3:.2f}) ± "
            f"({sigma[0]:.2f}, {sigma[1]:.2f}, {sigma[2]:.2f}) mm\n"
            f"the touches are {tip.residual * 1e3:.2f} mm from their common point\n\n"
            f"hand:\n  mount:\n    position: [{x:.5f}, {y:.5f}, {z:.5f}]"
        )
        if self.json:
            record = {
                "p_flange_tip": tip.p_flange_tip.tolist(),
                "p_base_point": tip.p_base_point.tolist(),
                "covariance": tip.covariance.tolist(),
                "residual": tip.residual,
                "residuals": tip.residuals.tolist(),
            }
            print(json_line(record), flush=True)
        return 0

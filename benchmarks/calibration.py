"""Accuracy and coverage of the camera's calibration on synthetic poses; each run draws poses, noise and board anew.

python -m benchmarks.calibration --runs 200
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from toolee_robot.calibration.board import SHEETS
from toolee_robot.calibration.hand_eye.benchmark import PROTOCOLS, measure
from toolee_robot.station import CameraConfig


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure each protocol and print it; 1 where a figure is not met."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.calibration", description="Calibrate synthetic cameras."
    )
    parser.add_argument("--runs", type=int, default=200, help="of each protocol")
    parser.add_argument("--sheet", choices=list(SHEETS), default="a4")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    camera, met = CameraConfig(), True
    for name in PROTOCOLS:
        board = SHEETS[asked.sheet].board
        f = measure(name, board, camera.intrinsics, camera.X_base_camera, asked.runs, asked.seed)
        method = min(f.closed_forms, key=lambda m: f.closed_forms[m])
        covered = f.covered if f.covered_accepted is None else f.covered_accepted
        asked_for = "-" if f.largest_error is None else f"{f.largest_error * 1e3:.1f} mm"
        print(f"{name}: median {f.error * 1e3:.2f} mm, 90 % {f.error_90 * 1e3:.2f} mm, asked {asked_for}")
        print(f"  95 % region has the truth in {covered:.0%}; refused {f.refused}")
        print(f"  best closed form {method}, {f.closed_forms[method] * 1e3:.1f} mm")
        met = met and f.met
    return int(not met)


if __name__ == "__main__":
    sys.exit(main())

"""Poses of the tools in one RGB-D frame: `python -m examples.estimate_poses RGB DEPTH FX,FY,CX,CY`."""

import sys
from pathlib import Path

from toolee_robot import RgbdFrame, ToolPerception
from toolee_robot.perception.io import read_frame


def print_poses(frame: RgbdFrame, perception: ToolPerception) -> int:
    """Print what is found, the most trustworthy first; the number of poses that may be acted on."""
    estimates = perception.estimate(frame)
    if not estimates:
        print("no tool found")
    for estimate in estimates:
        if not estimate.usable:
            print(f"{estimate.category}: not usable, {estimate.reason}")
            continue
        x, y, z = estimate.X_camera_ee[:3, 3]
        sigma = estimate.covariance[:3, :3].trace() ** 0.5
        print(f"{estimate.category}: at {x:.3f} {y:.3f} {z:.3f} m +- {1e3 * sigma:.1f} mm, trust {estimate.trust:.2f}")
    return sum(estimate.usable for estimate in estimates)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    rgb, depth, intrinsics = sys.argv[1:]
    frame = read_frame(Path(rgb), Path(depth), intrinsics, depth_scale=0.001)  # a depth image in millimetres
    sys.exit(0 if print_poses(frame, ToolPerception.load()) else 1)

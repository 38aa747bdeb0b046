"""`toolee` on a computer to which the RealSense of `examples/lab.yaml` is plugged in, as software, before the example's
cell, in which somebody holds a hammer before it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.rigs.camera_rig import plug_in
from toolee_robot.cli import main
from toolee_robot.devices.cameras.realsense import sdk
from toolee_robot.end_effectors import Category
from toolee_robot.frames import frame_from_axes, inverse, transform
from toolee_robot.runtime.clock import HostClock
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.devices.software_realsense import BASELINE, SoftwareRealSense
from toolee_robot.sim_backend.visuals import SceneVisuals, scene_state
from toolee_robot.station import load_lab_station
from toolee_robot.stations.rehearsal.camera import ColorAndDepth

ROOT = Path(__file__).parents[2]
LAB = ROOT / "examples" / "lab.yaml"
TOOLEE = f"import sys; sys.path.insert(0, {str(ROOT)!r}); from tests.stations.lab_camera import toolee; toolee()"
"""What Python runs for it."""
HELD = frame_from_axes(z=np.array([0.0, 0.64, -0.77]), x=np.array([1.0, 0.0, 0.0]), p=[-0.05, 0.0, 0.5])
"""Pose of the hammer's face in the camera: half a metre before it, the handle to the right."""
SEED = 3


def toolee() -> None:
    """The command line, with the camera."""
    with plugged_in():
        main()


@contextmanager
def plugged_in() -> Iterator[None]:
    """Context in which the driver finds the camera; what it sees is built once the camera is looked for."""
    with ExitStack() as stack, pytest.MonkeyPatch.context() as patch:
        found: list[SoftwareRealSense] = []

        def devices() -> list[Any]:
            if not found:
                found.append(stack.enter_context(_realsense()))
            return found[0].devices()

        plug_in(patch, devices)
        yield


def _realsense() -> SoftwareRealSense:
    config, clock, rs = load_lab_station(LAB), HostClock(), sdk()
    device, k = config.camera.device, config.camera.intrinsics
    assert device is not None
    with SimStation.build(config, SEED, SimOptions(hands_over=False)) as sim:
        tool, state = sim.tool, replace(scene_state(sim.world, sim.person), person_arm=None)
    X_base_tool = config.camera.X_base_camera @ HELD @ inverse(tool.ee(Category.HAMMER_HEAD).X_tool_ee)
    state = replace(state, X_base_tool=X_base_tool)
    visuals, aside = SceneVisuals(config, tool, SEED, lambda: state), transform(p=[BASELINE, 0.0, 0.0])
    cameras = ColorAndDepth(visuals, config.camera, None, aside, clock, SEED, np.random.default_rng(SEED))
    cameras.look()
    return SoftwareRealSense(
        rs,
        rs.distortion.none,
        k,
        k,
        serial=device.serial,
        fps=device.fps,
        clock=clock,
        pictures=lambda: cameras.take(device.least_range),
    )

"""toolee_robot: a robot-control stack for real hammering, after the paper ToolEENet.

The public API. Every name is loaded on its first use, so that a program that only estimates poses loads neither a
physics engine nor a robot driver:

    from toolee_robot import CameraIntrinsics, RgbdFrame, ToolPerception

    perception = ToolPerception.load()
    for estimate in perception.estimate(frame):
        if estimate.usable:
            print(estimate.category, estimate.X_camera_ee)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from toolee_robot.end_effectors import Category
    from toolee_robot.errors import TooleeError
    from toolee_robot.perception.pipeline import ToolPerception
    from toolee_robot.recording.recorder import RunRecorder
    from toolee_robot.station import StationConfig, load_station, sim_station
    from toolee_robot.stations.simulated import open_station
    from toolee_robot.tasks.hammering.grasp import nominal_grasp
    from toolee_robot.tasks.hammering.task import HammeringTask
    from toolee_robot.types import CameraIntrinsics, RgbdFrame

__version__ = "0.2.0"

__all__ = [
    "CameraIntrinsics",
    "Category",
    "HammeringTask",
    "RgbdFrame",
    "RunRecorder",
    "StationConfig",
    "ToolPerception",
    "TooleeError",
    "load_station",
    "nominal_grasp",
    "open_station",
    "sim_station",
]

_MODULES = {
    "CameraIntrinsics": "toolee_robot.types",
    "Category": "toolee_robot.end_effectors",
    "HammeringTask": "toolee_robot.tasks.hammering.task",
    "RgbdFrame": "toolee_robot.types",
    "RunRecorder": "toolee_robot.recording.recorder",
    "StationConfig": "toolee_robot.station",
    "ToolPerception": "toolee_robot.perception.pipeline",
    "TooleeError": "toolee_robot.errors",
    "load_station": "toolee_robot.station",
    "open_station": "toolee_robot.stations.simulated",
    "sim_station": "toolee_robot.station",
    "nominal_grasp": "toolee_robot.tasks.hammering.grasp",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

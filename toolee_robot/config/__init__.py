"""The station and the job as frozen dataclasses; YAML only here, validated.

    from toolee_robot.config import StationConfig, load_station
    config = StationConfig()                 # the simulated station of this repository
    config = load_station(Path("lab.yaml"))  # a lab's own: any subset of the fields

Everything a lab measures once stands here: where the camera, the base, the stand and the nail are, what the limits
are, and how the hand holds a tool nominally. Lengths [m], angles [rad].
"""

from toolee_robot.config.calibration import SIMULATED, SIMULATED_CALIBRATION, CalibrationConfig
from toolee_robot.config.cell import CameraConfig, SceneConfig, WorkConfig
from toolee_robot.config.job import StrikeConfig, SupervisorConfig, TaskConfig
from toolee_robot.config.robot import ArmLimits, HandConfig
from toolee_robot.config.station import StationConfig, load_station

__all__ = [
    "SIMULATED",
    "SIMULATED_CALIBRATION",
    "ArmLimits",
    "CalibrationConfig",
    "CameraConfig",
    "HandConfig",
    "SceneConfig",
    "StationConfig",
    "StrikeConfig",
    "SupervisorConfig",
    "TaskConfig",
    "WorkConfig",
    "load_station",
]

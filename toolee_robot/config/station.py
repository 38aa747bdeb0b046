"""A whole station, and its YAML file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from toolee_robot.config.calibration import SIMULATED_CALIBRATION, CalibrationConfig
from toolee_robot.config.cell import CameraConfig, SceneConfig, WorkConfig
from toolee_robot.config.job import StrikeConfig, SupervisorConfig, TaskConfig
from toolee_robot.config.robot import ArmLimits, HandConfig
from toolee_robot.config.values import STRICT
from toolee_robot.runtime.yaml_files import read_record


@dataclass(frozen=True)
class StationConfig:
    """A whole station; the defaults are the simulated one."""

    __pydantic_config__ = STRICT
    calibration: CalibrationConfig | None = SIMULATED_CALIBRATION
    """Of camera and robot to each other; null where nobody has calibrated them, which no job accepts."""
    camera: CameraConfig = field(default_factory=CameraConfig)
    """The camera."""
    work: WorkConfig = field(default_factory=WorkConfig)
    """The block and the nail."""
    scene: SceneConfig = field(default_factory=SceneConfig)
    """What else stands in the station."""
    arm: ArmLimits = field(default_factory=ArmLimits)
    """The arm and its limits."""
    hand: HandConfig = field(default_factory=HandConfig)
    """The hand."""
    strike: StrikeConfig = field(default_factory=StrikeConfig)
    """How to hit."""
    task: TaskConfig = field(default_factory=TaskConfig)
    """When to go on, to look again and to end."""
    supervisor: SupervisorConfig = field(default_factory=SupervisorConfig)
    """What the supervisor lets pass."""

    def __post_init__(self) -> None:
        if self.strike.speed > self.supervisor.unattended_speed:
            raise ValueError(
                f"strike.speed {self.strike.speed} is more than supervisor.unattended_speed "
                f"{self.supervisor.unattended_speed}: every strike would be refused"
            )


def load_station(path: Path) -> StationConfig:
    """Read a station from YAML. Raises ConfigError naming every wrong field."""
    return read_record(path, StationConfig, "station")

"""The record of a whole station, its loader, and what is set up for one job instead."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

from toolee_robot.errors import ConfigError
from toolee_robot.runtime.yaml_files import YamlLines, read_yaml, to_record
from toolee_robot.station.calibration import CalibrationConfig, check_place, check_record, take_record
from toolee_robot.station.cell import CameraConfig, SceneConfig, ToolEnvelope, take_camera_pose
from toolee_robot.station.head import FRAME, VERSION_FIELD, is_current, take_frame, to_base
from toolee_robot.station.job import StrikeConfig, SupervisorConfig, TaskConfig, ToolData, check_enclosed
from toolee_robot.station.measured_file import read_measured, with_measured
from toolee_robot.station.robot import ArmLimits, HandConfig, PersonConfig, ServoConfig
from toolee_robot.station.schema import STRICT, Gravity, Hole, NailHead, Protrusion, Shank, ShankLength, without_blanks
from toolee_robot.station.work import WorkConfig

SIM = Path(__file__).with_name("sim.yaml")
"""The simulated station's file."""
IN_TABLE = 0.02
"""Depth under the table's top at which no block stands, whatever the errors of both heights [m]."""


@dataclass(frozen=True)
class StationConfig:
    """Configuration of a whole station. What describes one station and no other has no default."""

    __pydantic_config__ = STRICT
    arm: ArmLimits
    """The arm's model and the limits of the planner."""
    hand: HandConfig
    """The hand on the flange."""
    camera: CameraConfig
    """Pose and intrinsics of the fixed camera."""
    scene: SceneConfig
    """Obstacles, home posture, handover pose and workspace."""
    work: WorkConfig
    """The block, its stand and the nails."""
    tool_envelope: ToolEnvelope
    """Cylinders that enclose the tool in collision checks."""
    strike: StrikeConfig
    """Parameters of a strike and of a touch."""
    calibration: CalibrationConfig | None = None
    """Record of the camera's calibration; null: not calibrated, and every job refuses the station."""
    servo: ServoConfig = field(default_factory=ServoConfig)
    """Parameters of the arm's servo, its measured lag, and the driver's timeouts."""
    tool: ToolData | None = None
    """The hammer that a person hands over; null for the simulated station, which chooses its own. A null field is
    unknown to the job.
    """
    task: TaskConfig = field(default_factory=TaskConfig)
    """Decision thresholds of the hammering job."""
    supervisor: SupervisorConfig = field(default_factory=SupervisorConfig)
    """Bounds that the supervisor enforces on every motion."""
    person: PersonConfig | None = None
    """Digital inputs of the guarded door and the hold-to-run switch; null: none, and a real arm then makes no fast
    motion. The simulated person needs none.
    """

    def __post_init__(self) -> None:
        if self.strike.speed > self.supervisor.unattended_speed:
            raise ValueError(
                f"strike.speed {self.strike.speed} is above supervisor.unattended_speed "
                f"{self.supervisor.unattended_speed}, so every strike would be refused"
            )
        below = self.scene.table_height - self.work.stand_height
        if below > IN_TABLE:
            raise ValueError(
                f"work.stand_height {self.work.stand_height} is {below * 1e3:.0f} mm below the table's top, "
                f"scene.table_height {self.scene.table_height}. Both are heights above the base plane"
            )
        self._check_spacing()

    def _check_spacing(self) -> None:
        """Refuse nails so near to each other that the hammer's head meets the next one."""
        for a, b in combinations(self.work.all_nails, 2):
            assert a.head_diameter is not None
            assert b.head_diameter is not None
            distance = math.dist(a.xy, b.xy)
            least = self.tool_envelope.head_radius + max(a.head_diameter, b.head_diameter) / 2
            if distance < least:
                raise ValueError(
                    f"the nails {a.name} and {b.name} are {distance * 1e3:.1f} mm apart, so the hammer would meet "
                    f"both. Place them {least * 1e3:.1f} mm apart or more (tool_envelope.head_radius plus half a "
                    "nail's head)"
                )


def read_station(path: Path) -> Any:
    """Read what a station file holds, with what programs measured.

    Args:
        path: The YAML file; `measured.yaml` beside it has the measured values.

    Returns:
        Its mapping, empty for an empty file.

    Raises:
        ConfigError: A file is missing, or cannot be read, or a place was measured far from where the file has it.
    """
    data = read_typed(path)
    measured = read_measured(path)
    return with_measured(data, measured, path) if measured and isinstance(data, dict) else data


def read_typed(path: Path) -> Any:
    """Read what a person wrote into a station file, as it is.

    Args:
        path: The YAML file.

    Returns:
        Its mapping, empty for an empty file.

    Raises:
        ConfigError: The file is missing, or cannot be read.
    """
    if not path.exists():
        raise ConfigError(f"there is no station file {path}. `toolee station new {path} --ask` makes one")
    return read_yaml(path, "station's file") or {}


@cache
def sim_station() -> StationConfig:
    """The simulated station, of `sim.yaml`.

    Returns:
        Its configuration. For one that differs in some fields use `dataclasses.replace`.
    """
    return to_record(_sim_data(), SIM, StationConfig, "station")


@cache
def _sim_data() -> dict[str, Any]:
    """What the simulated station's file holds; its positions are in `base`."""
    data = read_yaml(SIM, "simulated station's file")
    return {name: value for name, value in data.items() if name not in (VERSION_FIELD, FRAME)}


def _over_sim(data: dict[str, Any]) -> dict[str, Any]:
    """What a file holds, and the simulated station's values of the fields that it leaves out."""
    whole = {name: value for name, value in _sim_data().items() if name not in data}
    for name, value in data.items():
        below = _sim_data().get(name) or {}
        # A calibration is one record, never put together from two.
        whole[name] = {**below, **value} if isinstance(value, dict) and name != "calibration" else value
    return whole


def load_station(path: Path) -> StationConfig:
    """Load a station file.

    Args:
        path: YAML file with any subset of the fields of `StationConfig`, and `frame`, the `BaseFrame` of its positions,
            which a file that gives any must name; omitted fields are the simulated station's. It needs no `version`;
            one that it gives must be this program's.

    Returns:
        The validated configuration, its positions in `base`.

    Raises:
        ConfigError: The file cannot be read, or is of an unknown version, or a field is invalid (the message lists
            every one), or positions are given and no frame is named, or the camera's pose is given twice or cannot be
            one, or a size is in another unit, or the calibration is of another place.
    """
    return to_station(read_station(path), path)


def to_station(data: Any, path: Path) -> StationConfig:
    """Convert what a station file holds.

    Args:
        data: Its mapping, from `read_station`.
        path: The file, for the errors.

    Returns:
        The validated configuration, its positions in `base`.

    Raises:
        ConfigError: As `load_station`.
    """
    what = "station"
    if not isinstance(data, dict):
        return to_record(data, path, StationConfig, what)
    is_current(data, path)  # refuses an unknown one
    data = without_blanks({name: value for name, value in data.items() if name != VERSION_FIELD}, StationConfig)
    frame = take_frame(data)
    data, record = take_record(for_each_joint(_first_nail(data)), path)
    data = take_camera_pose(data, frame, path)
    config = to_record(_over_sim(data), path, StationConfig, what)
    if (converted := to_base(data, frame)) is not data:
        config = to_record(_over_sim(converted), path, StationConfig, what)
    check_lens(config.camera, path)
    if record is None:
        return config
    check_record(record, config.camera.intrinsics, config.camera.distortion, config.arm.calibration, path)
    measured = config.camera.measured_pose is not None
    if measured or "position" in (data.get("camera") or {}):
        told_by = "camera.X_base_camera" if measured else "camera.position"
        check_place(record, config.camera.center, told_by, frame, path)
    return replace(config, camera=replace(config.camera, pose=record.X_base_camera))


def check_lens(camera: CameraConfig, path: Path) -> None:
    """Refuse focal lengths and a principal point that no camera has.

    Args:
        camera: The camera as a file describes it.
        path: The file, for the message.

    Raises:
        ConfigError: They belong to another size of the image, or are mistyped; the message names field and line.
    """
    lines, wrong = YamlLines(path), camera.intrinsics.problems()
    if wrong:
        told = [f"camera.{n}: {text}" + (f" ({w})" if (w := lines.told(("camera", n))) else "") for n, text in wrong]
        raise ConfigError(f"{path} is not a valid station: {'; '.join(told)}")


def for_each_joint(data: dict[str, Any]) -> dict[str, Any]:
    """Give every joint the acceleration that a file gives once, for all."""
    arm = data.get("arm")
    if not isinstance(arm, dict) or not isinstance(value := arm.get("acceleration"), int | float):
        return data
    return data | {"arm": arm | {"acceleration": [value] * 6}}


def _first_nail(data: dict[str, Any]) -> dict[str, Any]:
    """Name the place of the first of several nails, which a file with a list of them leaves out."""
    work = data.get("work")
    if not isinstance(work, dict) or "nail_xy" in work:
        return data
    nails = work.get("nails")
    first = nails[0] if isinstance(nails, list) and nails else None
    if not isinstance(first, dict) or "xy" not in first:
        return data
    return data | {"work": {"nail_xy": first["xy"], **work}}


@dataclass(frozen=True)
class WorkSetup:
    """Fields of `work` that are of one job's nail and wood; null for the station file's."""

    __pydantic_config__ = STRICT
    nail_diameter: Shank | None = None
    """Diameter of the nail's shank."""
    nail_length: ShankLength | None = None
    """Length of the nail's shank."""
    nail_head_diameter: NailHead | None = None
    """Diameter of the nail's head."""
    nail_protrusion: Protrusion | None = None
    """Height of the nail's head above the wood before the first strike."""
    pilot_hole_diameter: Hole | None = None
    """Diameter of the predrilled hole, 0 for none."""
    wood_specific_gravity: Gravity | None = None
    """Specific gravity of the wood."""


@dataclass(frozen=True)
class JobSetup:
    """What is set up for one job."""

    __pydantic_config__ = STRICT
    tool: ToolData | None = None
    """The tool that is handed over; null for the station file's."""
    tool_envelope: ToolEnvelope | None = None
    """Cylinders that enclose that tool in collision checks; null: the station file's."""
    work: WorkSetup = field(default_factory=WorkSetup)
    """Nail and wood."""


def with_setup(config: StationConfig, path: Path) -> StationConfig:
    """Take what is set up for one job instead of what a station file says.

    Args:
        config: What the station file says.
        path: YAML file with the fields of `JobSetup`.

    Returns:
        The configuration of the job.

    Raises:
        ConfigError: The file cannot be read, a field is wrong or in another unit, or the station lists several nails
            and the file gives the sizes of one, or the tool does not fit into the station's `tool_envelope` and the
            file gives none.
    """
    data = read_yaml(path, "job's setup's file") or {}
    if isinstance(data, dict) and isinstance(envelope := data.get("tool_envelope"), dict):
        data = {**data, "tool_envelope": {**asdict(config.tool_envelope), **envelope}}
    setup = to_record(data, path, JobSetup, "job's setup")
    work = {name: value for name, value in asdict(setup.work).items() if value is not None}
    if config.work.nails and set(work) - {"wood_specific_gravity"}:
        raise ConfigError(
            f"{path} gives a nail's sizes, but the station lists several nails (work.nails): give the sizes there"
        )
    try:
        made = replace(
            config,
            tool=setup.tool or config.tool,
            tool_envelope=setup.tool_envelope or config.tool_envelope,
            work=replace(config.work, **work),
        )
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error
    check_enclosed(made, path)
    return made

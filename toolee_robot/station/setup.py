"""What is set up for one job instead of what the station file says: the tool, the nail, the wood."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from toolee_robot.errors import ConfigError
from toolee_robot.runtime.yaml_files import read_yaml, to_record
from toolee_robot.station.cell import ToolEnvelope
from toolee_robot.station.station import StationConfig
from toolee_robot.station.tool import ToolData, check_enclosed
from toolee_robot.station.values import STRICT, Gravity, Hole, NailHead, Protrusion, Shank, ShankLength


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
    """Height of the top of the nail's head over the wood before the first strike."""
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
    """What encloses that tool in collision checks, where it differs from the station file's; null for that."""
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
            f"{path} gives the sizes of a nail, and the station lists several (work.nails): give sizes there",
            code="config.invalid",
        )
    try:
        made = replace(
            config,
            tool=setup.tool or config.tool,
            tool_envelope=setup.tool_envelope or config.tool_envelope,
            work=replace(config.work, **work),
        )
    except ValueError as error:
        raise ConfigError(f"{path}: {error}", code="config.invalid") from error
    check_enclosed(made, path)
    return made

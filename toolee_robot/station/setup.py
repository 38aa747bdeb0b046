"""What is set up for one job instead of what the station file says: the tool, the nail, the wood."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated

from pydantic import Field

from toolee_robot.errors import ConfigError
from toolee_robot.runtime.yaml_files import read_record
from toolee_robot.station.cell import ToolEnvelope
from toolee_robot.station.station import StationConfig
from toolee_robot.station.tool import ToolData
from toolee_robot.station.tool_enclosure import check_enclosed
from toolee_robot.station.units import check_units
from toolee_robot.station.values import STRICT, NotNegative, Positive


@dataclass(frozen=True)
class WorkSetup:
    """Fields of `work` that are of one job's nail and wood; null for the station file's."""

    __pydantic_config__ = STRICT
    nail_diameter: Positive | None = None
    """Diameter of the nail's shank [m]."""
    nail_length: Positive | None = None
    """Length of the nail's shank [m]."""
    nail_head_diameter: Positive | None = None
    """Diameter of the nail's head [m]."""
    nail_protrusion: Positive | None = None
    """Height of the top of the nail's head over the wood before the first strike [m]."""
    pilot_hole_diameter: NotNegative | None = None
    """Diameter of the predrilled hole, 0 for none [m]."""
    wood_specific_gravity: Annotated[float, Field(gt=0, lt=1.5)] | None = None
    """Specific gravity of the wood."""


@dataclass(frozen=True)
class JobSetup:
    """What is set up for one job."""

    __pydantic_config__ = STRICT
    tool: ToolData | None = None
    """The tool that is handed over; null for the station file's."""
    tool_envelope: ToolEnvelope | None = None
    """What encloses that tool in collision checks; null for the station file's, where the tool fits into it."""
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
    setup = read_record(path, JobSetup, "job's setup")
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
    check_units(made, path)
    check_enclosed(made, path)
    return made

"""Clicks on the frames of a folder: which ones each category needs, and their file, from which poses are derived."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

import yaml
from pydantic import TypeAdapter

from toolee_robot.end_effectors import Category
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.yaml_files import read_record, to_record
from toolee_robot.station.schema import STRICT

CLICKS = "clicks.yaml"
"""Name of the file in the folder of the frames."""


@dataclass(frozen=True)
class Click:
    """A clicked point.

    Attributes:
        role: What it shows.
        u: Column [px]; pixel centres are at integer coordinates.
        v: Row [px].
    """

    __pydantic_config__ = STRICT

    role: Role
    u: float
    v: float


@dataclass(frozen=True)
class ClickedEnd:
    """The clicks on one end effector.

    Attributes:
        shape: What is fitted.
        clicks: Its clicks in the order in which they were made.
        caliper_mm: What the caliper measured, see `Protocol.caliper` [mm]; None: not measured.
        tape_mm: Tape-measured distance from where the tape begins to the end's origin [mm]; None: not measured.
    """

    __pydantic_config__ = STRICT

    shape: Shape
    clicks: tuple[Click, ...] = ()
    caliper_mm: float | None = None
    tape_mm: float | None = None

    def of(self, role: Role) -> list[Click]:
        """The clicks of a role."""
        return [c for c in self.clicks if c.role is role]

    def with_click(self, click: Click) -> ClickedEnd:
        """These clicks and one more."""
        return replace(self, clicks=(*self.clicks, click))


@dataclass(frozen=True)
class ClickedFrame:
    """What a person said of one frame.

    Attributes:
        no_tool: Whether there is no end effector in it.
        ends: The end effectors.
    """

    __pydantic_config__ = STRICT

    no_tool: bool = False
    ends: tuple[ClickedEnd, ...] = ()


@dataclass(frozen=True)
class ClicksFile:
    """The clicks on the frames of a folder.

    Attributes:
        place: Where the frames were taken, as the tables name it.
        half: A: to choose by; B: to report.
        tape_offset_mm: Distance of the depth's origin behind the point where the tape begins [mm], from the camera's
            data sheet; needed where there is a tape-measured distance.
        frames: By name; a frame that is not here has not been looked at.
    """

    __pydantic_config__ = STRICT

    place: str
    half: str = "B"
    tape_offset_mm: float | None = None
    frames: dict[str, ClickedFrame] = field(default_factory=dict)

    def with_frame(self, name: str, frame: ClickedFrame) -> ClicksFile:
        """Replace the clicks on one frame.

        Args:
            name: The frame.
            frame: What a person said of it.

        Returns:
            These clicks with that change.
        """
        return replace(self, frames={**self.frames, name: frame})


def read_clicks(path: Path) -> ClicksFile:
    """Read a file of clicks.

    Args:
        path: The file, YAML or JSON.

    Returns:
        The clicks.

    Raises:
        ConfigError: It is missing or wrong; the message names every wrong field.
    """
    return read_record(path, ClicksFile, "file of clicks")


def write_clicks(path: Path, clicks: ClicksFile) -> None:
    """Write a file of clicks, atomically.

    Args:
        path: The file; its folder exists.
        clicks: The clicks.

    Raises:
        UserError: It cannot be written, or could not be read again.
    """
    data = TypeAdapter(ClicksFile).dump_python(clicks, mode="json", exclude_defaults=True)
    data["half"] = clicks.half
    to_record(data, path, ClicksFile, "file of clicks")
    write_atomic(path, yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120).encode())


class Role(StrEnum):
    """What a click shows."""

    RIM = "rim"
    SURFACE = "surface"
    THROAT = "throat"
    END_A = "end_a"
    END_B = "end_b"
    TIP = "tip"
    SHAFT = "shaft"
    HANDLE = "handle"
    BOX = "box"


class Shape(StrEnum):
    """What is fitted to the clicks."""

    FACE = "face"
    CLAW = "claw"
    OPEN_JAW = "open_jaw"
    RING = "ring"
    TIP = "tip"

    @property
    def category(self) -> Category:
        """The category of end effectors that have this shape."""
        return PROTOCOL[self].category


@dataclass(frozen=True)
class Asked:
    """Clicks of one role.

    Attributes:
        least: Fewest clicks with which there is a pose.
        advised: Number with which a wrong one shows.
        where: Where to click.
        depth: Whether the depth at these clicks is measured too; at the edge of a surface it is not to be trusted.
    """

    least: int
    advised: int
    where: str
    depth: bool = True


@dataclass(frozen=True)
class Protocol:
    """What the pose of a shape needs.

    Attributes:
        label: Its name on the page.
        category: The category of end effectors.
        clicks: Clicks by role, in the order in which the page asks for them.
        caliper: What is measured with a caliper [mm].
        caliper_needed: Whether there is no pose without it; otherwise it is a check, and makes the pose more accurate.
    """

    label: str
    category: Category
    clicks: dict[Role, Asked]
    caliper: str
    caliper_needed: bool


PROTOCOL = TypeAdapter(dict[Shape, Protocol]).validate_python(
    yaml.safe_load((Path(__file__).parent / "protocol.yaml").read_text())
)
"""What each shape needs."""

BOX = Asked(
    0, 2, "two opposite corners of the box of what is seen of the end effector; left out: found in the depth image"
)
"""The box that a detection is compared with."""

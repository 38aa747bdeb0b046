"""The hammering job: strikes, decisions, the supervisor's bounds, and the tool that a person hands over."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from toolee_robot.errors import ConfigError
from toolee_robot.frames import Array, frame_from_axes, inverse
from toolee_robot.station.schema import STRICT
from toolee_robot.types.units import (
    Direction,
    Kilograms,
    Metres,
    MetresPerSecond,
    NearPoint,
    Newtons,
    Number,
    Radians,
    Seconds,
    Unit,
)

if TYPE_CHECKING:
    from toolee_robot.station.station import StationConfig


@dataclass(frozen=True)
class StrikeConfig:
    """Parameters of a strike, and of the guarded touch that measures the nail."""

    __pydantic_config__ = STRICT
    speed: Annotated[float, MetresPerSecond(0.05, 3.0, "hammers of a UR10 reach 2")]
    """Wanted speed of the face at the contact. A strike is slower if a limit requires it. Give 0.4 for the first
    strikes on a robot.
    """
    deepest: Annotated[float, Metres(0.001, 0.15)] = 0.020
    """Largest distance of the commanded face beyond the contact, where every strike turns back. A lagging servo reaches
    it, too. Give 0.01 for the first strikes on a robot. A compliant wrist bears up to 0.1, and the strike is faster.
    """
    touch_speed: Annotated[float, MetresPerSecond(0.002, 0.1)] = 0.03
    """Speed of the touch that measures where the face meets the nail."""
    touch_force: Annotated[float, Newtons(0.5, 100.0, "a UR10 stops itself at some 150 N")] = 8.0
    """Force that ends the touch. It must be less than a compliant wrist transmits at the end of a long hammer."""
    contact_force: Annotated[float, Newtons(1.0, 300.0)] = 15.0
    """Force that counts as the contact of a strike."""
    max_load: Annotated[float, Number(0.05, 1.0, "at 1 the robot stops itself")] = 0.6
    """Largest deviation and collision ratio that the controller may report in a strike; at 1 the robot stops
    itself. After a strike with more, the next ones are a quarter slower. After the third such strike the job ends.
    """
    max_torque_share: Annotated[float, Number(0.05, 1.0, "at 1 a joint has no more")] = 1.0
    """Largest computed joint torque in a strike, as a share of the joint's limit. After a strike with more, the next
    ones are slower, as with `max_load`. Strikes and stops are planned within 0.9.
    """
    clearance: Annotated[float, Metres(0.001, 0.1)] = 0.008
    """Least distance between any two bodies during a strike, except face and nail."""


@dataclass(frozen=True)
class TaskConfig:
    """Thresholds with which the hammering job decides to continue, to look at the tool again, or to end."""

    __pydantic_config__ = STRICT
    max_strikes: Annotated[int, Number(1, 1000)] = 150
    """Number of strikes after which the job gives up; sooner if by the forecast they will not do."""
    flush_protrusion: Annotated[float, Metres(0.0001, 0.01)] = 0.001
    """Largest height of the nail's head above the wood that counts as flush."""
    min_progress: Annotated[float, Metres(0.00001, 0.01)] = 0.0002
    """Depth below which a strike counts as not having moved the nail."""
    slip_per_strike: Annotated[float, Metres(0.00001, 0.05)] = 0.0015
    """Standard deviation of the tool's drift in the hand per strike."""
    slip_angle_per_strike: Annotated[float, Radians(0.0001, 0.2)] = np.pi / 450
    """Standard deviation of the tool's rotational drift in the hand per strike."""
    abort_slip: Annotated[float, Metres(0.001, 0.1)] = 0.015
    """Slip between two looks at the tool that ends the job."""
    abort_slip_angle: Annotated[float, Radians(0.01, 1.0)] = np.pi / 12
    """Rotational slip between two looks at the tool that ends the job."""
    views: Annotated[int, Number(1, 50)] = 6
    """Number of views of the first look at the tool."""
    views_again: Annotated[int, Number(1, 50)] = 2
    """Number of views of each later look."""
    strikes_between_looks: Annotated[int, Number(1, 100)] = 4
    """Number of strikes between two looks at the tool; three times as many while the hand holds it steadily, and up to
    half as many more if these finish the nail.
    """
    watch_nail: bool = True
    """Whether the camera also watches the nail. A leaning or bent nail ends the job."""
    handover_timeout: Annotated[float, Seconds(0.5, 3600.0)] = 30.0
    """Time for a person to hand over the tool, and to answer each question."""


@dataclass(frozen=True)
class SupervisorConfig:
    """Bounds that the supervisor enforces in addition to the joint limits."""

    __pydantic_config__ = STRICT
    handover_speed: Annotated[float, MetresPerSecond(0.01, 0.25, "reduced speed of ISO 10218-1")] = 0.25
    """Largest speed of flange and tool in HANDOVER mode, with a person in reach: the reduced speed of
    ISO 10218-1."""
    unattended_speed: Annotated[float, MetresPerSecond(0.05, 3.0, "hammers of a UR10 reach 2")] = 1.5
    """Largest speed of flange and tool in UNATTENDED mode, with nobody in reach: a common safety setting of UR
    arms."""
    momentum: Annotated[float, Unit("kg m/s", 1.0, 150.0, "a UR's least restricted limit is 100")] = 25.0
    """Largest momentum of arm, hand and tool: below the limit of the robot's safety configuration, above
    which it stops itself. PolyScope's usual preset has 25."""
    tracking_error: Annotated[float, Radians(0.001, 0.5)] = 0.05
    """Largest deviation of a measured joint from its command; see `MotionWatch`."""
    data_cycles: Annotated[float, Unit("cycles", 1.0, 50.0)] = 3.0
    """Largest age of the newest reading during a motion, in control cycles: 3 are 24 ms on a CB3 and 6 ms on an
    e-Series. An e-Series without a real-time kernel may need 10.
    """
    overruns: Annotated[int, Number(1, 100)] = 3
    """Largest number of successive late command cycles. A strike with a sharp `servo` bears no more. At `servoj`'s
    default gain and lookahead an e-Series bears 10.
    """
    max_data_age: Annotated[float, Seconds(0.005, 1.0)] = 0.1
    """Largest age of the arm's newest reading before a motion starts."""
    early_contact: Annotated[float, Metres(0.001, 0.1)] = 0.024
    """How far before the expected contact a strike may meet the nail."""
    late_contact: Annotated[float, Metres(0.001, 0.1)] = 0.030
    """How far beyond the expected contact a strike may meet the nail. At 1.2 m/s and 125 Hz the force is detected
    about 15 mm behind the contact.
    """
    max_hand_temperature: Annotated[float, Unit("deg C", 20.0, 100.0, "motors' limits are 60 to 80")] = 65.0
    """Temperature of the hand above which no strike starts."""
    ask_before_swing: bool = True
    """Whether a person must confirm the first swing of a job."""


@dataclass(frozen=True)
class ToolData:
    """A hammer, measured. No field has a default: nobody but the lab knows its hammer.

    Its frame `tool`: origin on the handle's axis where the hand holds it, z along the handle towards the head, x to the
    side that strikes. How the tool really lies in the hand is what the camera finds out. What nobody has measured is
    null: then the arm weighs the tool in the hand, and the camera looks for a face of which nothing is known
    (docs/how-to/unknown_hammer.md).
    """

    __pydantic_config__ = STRICT
    name: str
    """Name of the tool, for messages."""
    grip_radius: Annotated[float, Metres(0.002, 0.1)] | None
    """Radius of the handle where the hand holds it; the mean radius if it is oval. Null: unknown."""
    face: NearPoint | None
    """Middle of the striking face in `tool`. Null, together with `face_normal`: unknown."""
    face_normal: Direction | None
    """Direction in which the face strikes, in `tool`; any length."""
    mass: Annotated[float, Kilograms(0.02, 4.0, "hammers for one hand")] | None
    """Mass of the whole tool. Null, together with `center_of_mass`: the arm weighs it."""
    center_of_mass: NearPoint | None
    """Centre of mass of the whole tool in `tool`."""

    def __post_init__(self) -> None:
        for one, other in (("face", "face_normal"), ("mass", "center_of_mass")):
            if (getattr(self, one) is None) != (getattr(self, other) is None):
                raise ValueError(f"{one} and {other} belong together: give both, or null for both")
        if self.face is None or self.face_normal is None:
            return
        normal = np.asarray(self.face_normal)
        if np.linalg.norm(normal[:2]) < 1e-6:
            raise ValueError(
                "face_normal does not point to the side of the handle: a hammer strikes to the side, such as x"
            )
        x, y, z = self.face
        if z <= np.hypot(x, y):
            raise ValueError(
                f"face {list(self.face)} is not at the end of the handle. z runs along the handle towards the head, "
                "and x to the striking side"
            )

    @property
    def X_tool_face(self) -> Array | None:
        """Pose of the striking face, (4, 4): z is its normal, x points towards the handle's butt; None if unknown."""
        if self.face is None or self.face_normal is None:
            return None
        return frame_from_axes(z=np.asarray(self.face_normal), x=np.array([0.0, 0.0, -1.0]), p=self.face)

    @property
    def weight_in_words(self) -> str:
        """Its mass, for people."""
        return "weighed by the arm" if self.mass is None else f"{self.mass:g} kg"

    def unmeasured_as(self, other: ToolData | None) -> ToolData:
        """Leave out what is not measured of another tool, for a cell that stands in for that tool's.

        Args:
            other: The other tool; None: everything stays.

        Returns:
            This tool's data, null where the other's are.
        """
        if other is None:
            return self
        unknown: dict[str, Any] = {field.name: None for field in fields(self) if getattr(other, field.name) is None}
        return replace(self, **unknown)


def check_enclosed(config: StationConfig, path: Path) -> None:
    """Refuse a tool whose handle, where the hand holds it, is outside of the handle's cylinder of `tool_envelope`.

    Args:
        config: The station, or a job on it.
        path: The file that describes the tool, for the message.

    Raises:
        ConfigError: The cylinders are another tool's. A tool whose face nobody has measured passes: the camera tells
            where it is, and the cylinders are widened until then.
    """
    tool, envelope = config.tool, config.tool_envelope
    if tool is None or (X_tool_face := tool.X_tool_face) is None:
        return
    along, across, behind = inverse(X_tool_face)[:3, 3]  # of the hand's place, in the frame of `ToolEnvelope`
    beside = float(np.hypot(across, behind + envelope.handle_depth)) + (tool.grip_radius or 0.0)
    if beside <= envelope.handle_radius and along <= envelope.handle_length:
        return
    raise ConfigError(
        f"{path}: the handle of the {tool.name} does not fit tool_envelope, so collisions would be checked with "
        f"another shape. In the hand it is {1e3 * along:.0f} mm from the face and {1e3 * beside:.0f} mm beside the "
        f"axis of the handle's cylinder. That cylinder is {1e3 * envelope.handle_length:.0f} mm long with a radius "
        f"of {1e3 * envelope.handle_radius:.0f} mm (handle_length, handle_radius, handle_depth "
        f"{envelope.handle_depth:g}). Give `tool_envelope` as measured, or correct `tool.face`"
    )

"""Types of configuration fields, checked when a station file is loaded."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field

from toolee_robot.types.units import Metres, Number, Radians, RadiansPerSecond

STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Pydantic configuration of every record: an unknown field, NaN or infinity is an error."""

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=1)]
Place = Annotated[float, Metres(-10.0, 10.0, "from the base; a UR10 reaches 1.3 m")]
Point = tuple[Place, Place, Place]
"""A point in the station."""
Extent = Annotated[float, Metres(0.005, 10.0)]
"""Edge length of a box."""
JointAngle = Annotated[float, Radians(-6.2832, 6.2832, "joints turn by a whole turn to each side")]
JointAngles = tuple[JointAngle, JointAngle, JointAngle, JointAngle, JointAngle, JointAngle]
"""Of the six joints, base to wrist 3."""
JointSpeed = Annotated[float, RadiansPerSecond(0.01, 3.5, "data sheet of the UR10: 2.09 and 3.14")]
JointSpeeds = tuple[JointSpeed, JointSpeed, JointSpeed, JointSpeed, JointSpeed, JointSpeed]
"""Of the six joints, base to wrist 3."""
Shank = Annotated[float, Metres(0.0005, 0.02, "nails are 0.8 to 8 mm thick")]
ShankLength = Annotated[float, Metres(0.005, 0.4)]
NailHead = Annotated[float, Metres(0.0005, 0.05)]
Protrusion = Annotated[float, Metres(0.0005, 0.4)]
Hole = Annotated[float, Metres(0.0, 0.02, "0 for none")]
Slope = Annotated[float, Number(-10.0, 10.0, "metres per metre, 0.0175 for 1 degree")]
Gravity = Annotated[float, Number(0.05, 1.4, "balsa 0.1, lignum vitae 1.3")]
"""Specific gravity of a wood."""

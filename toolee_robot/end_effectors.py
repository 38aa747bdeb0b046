"""The end effectors (EE), the parts of tools that touch the work: one `EndEffectorSpec` per `Category`.

To add a category, append a member to `Category` and a record to `END_EFFECTORS`, and list the category in the kinds of
tools that have it (`toolee_robot.tools.catalog.TOOL_SPECS`). Detector and pose network must then be trained again.

At contact an EE's frame coincides with the frame of the object worked on, up to the category's symmetry group.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.symmetry import SymmetryGroup, SymmetryKind


class Category(StrEnum):
    """Names of the end effectors in data sets, reports and weights.

    Their order is that of the class ids, of the networks' embeddings and of the fitted models' features.
    """

    HAMMER_HEAD = "hammer_head"
    HAMMER_GRIP = "hammer_grip"
    SCREWDRIVER_HEAD = "screwdriver_head"
    WRENCH_HEAD = "wrench_head"

    @property
    def spec(self) -> EndEffectorSpec:
        """Specification of the category."""
        return END_EFFECTORS[self]

    @property
    def label(self) -> str:
        """Name in messages, tables and figures."""
        return END_EFFECTORS[self].label

    @property
    def symmetry(self) -> SymmetryGroup:
        """Symmetry group, which decides the metric and the pooling of this category."""
        return END_EFFECTORS[self].symmetry


@dataclass(frozen=True, eq=False)
class EndEffectorSpec:
    """Specification of a category of end effectors."""

    label: str
    """Name in messages, tables and figures."""
    class_id: int
    """Class id in data sets and detections, from 1; 0 is the background."""
    frame: str
    """Definition of its frame, in words."""
    symmetry: SymmetryGroup
    """Rotations in its own frame that leave it unchanged. The pose network supports continuous spins about z and half
    turns about x."""
    R_tool_ee: Array
    """Nominal axes of the EE in the tool frame, (3, 3), as columns; an individual tool may be bent or tilted."""
    radius: float
    """Radius of the sphere about the frame's origin within which the tool's surface belongs to the EE [m]."""
    spin_cues: tuple[str, ...]
    """Labels of the tool's parts that make the spin about a free axis observable when they are visible."""
    training_share: float
    """Share of the pose network's training examples; the shares of all categories add up to 1."""
    color: str
    """Colour in pictures, #rrggbb."""


def _axes(*columns: tuple[float, float, float]) -> Array:
    R = np.column_stack(columns)
    R.setflags(write=False)
    return R


_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_MINUS_X, _MINUS_Y, _MINUS_Z = (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)

END_EFFECTORS: dict[Category, EndEffectorSpec] = {
    Category.HAMMER_HEAD: EndEffectorSpec(
        label="hammer head",
        class_id=1,
        frame="origin at the centre of the striking face; z the face's outward normal; x towards the handle's butt",
        symmetry=SymmetryGroup(SymmetryKind.CINF, _Z),
        R_tool_ee=_axes(_MINUS_Z, _Y, _X),
        radius=0.050,
        spin_cues=("handle", "shaft", "grip", "claw"),
        training_share=0.25,
        color="#ff9f1c",
    ),
    Category.HAMMER_GRIP: EndEffectorSpec(
        label="claw",
        class_id=2,
        frame="origin in the middle of the claw's slot, at half of its length and of the tines' thickness; z away from "
        "the handle (into the wood when pulling a nail); x along the slot towards the open tips",
        symmetry=SymmetryGroup(SymmetryKind.NONE),
        R_tool_ee=_axes(_MINUS_X, _MINUS_Y, _Z),
        radius=0.040,
        spin_cues=(),
        training_share=0.28,
        color="#c77dff",
    ),
    Category.SCREWDRIVER_HEAD: EndEffectorSpec(
        label="screwdriver tip",
        class_id=3,
        frame="origin at the tip; z along the shaft, out of the tip",
        symmetry=SymmetryGroup(SymmetryKind.CINF, _Z),
        R_tool_ee=_axes(_X, _Y, _Z),
        radius=0.050,
        spin_cues=(),
        training_share=0.15,
        color="#2ec4b6",
    ),
    Category.WRENCH_HEAD: EndEffectorSpec(
        label="wrench jaw",
        class_id=4,
        frame="origin on the centre line of the jaw flats, half-way between the throat and the end of the shorter "
        "flat, at half the thickness; z the nut's axis; x towards the handle's far end. In a ring or socket: the nut's "
        "centre",
        symmetry=SymmetryGroup(SymmetryKind.C2, _X),
        R_tool_ee=_axes(_MINUS_Z, _MINUS_X, _Y),
        radius=0.060,
        spin_cues=(),
        training_share=0.32,
        color="#f15bb5",
    ),
}
"""All categories, in the order of their class ids."""

CATEGORIES: tuple[Category, ...] = tuple(END_EFFECTORS)
"""The category of class id k is CATEGORIES[k - 1]."""


def label_of(name: str) -> str:
    """Label of a table's heading: the category's label, or else the name with spaces for underscores."""
    return Category(name).label if name in END_EFFECTORS else name.replace("_", " ")

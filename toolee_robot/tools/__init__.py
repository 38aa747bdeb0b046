"""Parametric hand tools: metric, watertight, with parts, materials, masses and the frames of their working ends.

    from toolee_robot.tools import ToolKind, make_tool, test_seeds
    hammer = make_tool(ToolKind.CLAW_HAMMER, test_seeds(1)[0])
    hammer.ee(Category.HAMMER_HEAD).X_tool_ee

EE frames coincide with the frame of the object worked on, at contact, up to the category's symmetry group:

- hammer_head: origin at the centre of the striking face; z the face's outward normal; x towards the handle's butt.
- hammer_grip (the claw): origin in the middle of the slot, at half of its length and of the tines' thickness; z away
  from the handle (into the wood when pulling a nail); x along the slot towards the open tips.
- screwdriver_head: origin at the tip; z along the shaft, out of the tip.
- wrench_head: origin on the centre line of the jaw flats, half-way between the throat and the end of the shorter
  flat, at half the thickness; z the nut's axis; x towards the handle's far end. In a ring or socket: the nut's centre.
"""

from toolee_robot.tools.catalog import (
    NAIL_DRIVERS,
    SWUNG_MASS,
    TOOL_SPECS,
    ToolSpec,
    kinds_of,
    make_tool,
    split,
    test_seeds,
    train_seeds,
)
from toolee_robot.tools.materials import Material
from toolee_robot.tools.model import (
    EndEffector,
    Family,
    Handle,
    Part,
    SolidPart,
    Tool,
    ToolKind,
    ToolShape,
    ee_radius,
    tool_name,
)

__all__ = [
    "NAIL_DRIVERS",
    "SWUNG_MASS",
    "TOOL_SPECS",
    "EndEffector",
    "Family",
    "Handle",
    "Material",
    "Part",
    "SolidPart",
    "Tool",
    "ToolKind",
    "ToolShape",
    "ToolSpec",
    "ee_radius",
    "kinds_of",
    "make_tool",
    "split",
    "test_seeds",
    "tool_name",
    "train_seeds",
]

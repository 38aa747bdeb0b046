"""Parametric hand tools: metric, watertight, with parts, materials, masses and the frames of their working ends.

    from toolee_robot.tools import ToolKind, make_tool, test_seeds
    hammer = make_tool(ToolKind.CLAW_HAMMER, test_seeds(1)[0])
    hammer.ee(Category.HAMMER_HEAD).X_tool_ee

Each kind of tool is a record in `catalog`; `toolee_robot.end_effectors` defines the end-effector frames.
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
    tool_name,
)

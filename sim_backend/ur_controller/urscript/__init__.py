"""URScript: tokeniser, parser, compiler to Python generators, and the scheduler of a program's threads."""

from toolee_robot.sim_backend.ur_controller.urscript.compiling import Compiling
from toolee_robot.sim_backend.ur_controller.urscript.errors import ScriptError
from toolee_robot.sim_backend.ur_controller.urscript.runtime import ScriptRuntime

__all__ = ["Compiling", "ScriptError", "ScriptRuntime"]

"""Background compilation of programs in a child process, since a long one takes half a second.

The child has the controller's priority, so that other load on the machine does not delay it; it needs a second
processor.
"""

from __future__ import annotations

import marshal
import os
import signal
from contextlib import suppress
from functools import lru_cache

from toolee_robot.sim_backend.ur_controller.urscript.compiler import Compiled, compile_script
from toolee_robot.sim_backend.ur_controller.urscript.expressions import Builtin
from toolee_robot.sim_backend.ur_controller.urscript.functions.library import LIBRARY
from toolee_robot.sim_backend.ur_controller.urscript.functions.robot import RobotFunctions, function_names
from toolee_robot.sim_backend.ur_controller.urscript.tokens import ScriptError

SHORT = 512
"""[characters] Length up to which compiling takes no longer than starting a child."""
KEPT = 16
"""Size of the cache of compiled programs; clients upload the same one repeatedly."""
_MAX_FILES = 1 << 16

_kept: dict[tuple[str, bool], Compiled] = {}


def compiled(source: str, e_series: bool) -> Compiled:
    """Compile a program in this process, unless it is in the cache.

    Args:
        source: Text of the program.
        e_series: Whether it is for an e-Series controller.

    Returns:
        The compiled program.

    Raises:
        ScriptError: It does not parse, or calls a function that does not exist.
    """
    if (found := _kept.get((source, e_series))) is None:
        found = compile_script(source, _builtins(e_series))
        _keep(source, e_series, found)
    return found


def _keep(source: str, e_series: bool, found: Compiled) -> None:
    _kept[source, e_series] = found
    if len(_kept) > KEPT:
        del _kept[next(iter(_kept))]


@lru_cache(maxsize=2)
def _builtins(e_series: bool) -> dict[str, Builtin]:
    library = {name: Builtin.of(f) for name, f in LIBRARY.items()}
    robot = {name: Builtin.of(getattr(RobotFunctions, name), method=True) for name in function_names(e_series)}
    return {**library, **robot}


class Compiling:
    """The compilation of one program. Once it is `done`, `compiled` returns or raises at once.

    Use it only in the thread of the ticks; `cancel` one that is not done.

    Args:
        source: Text of the program.
        e_series: Whether it is for an e-Series controller.

    Attributes:
        source: Text of the program.
        error: The program's error, or None.
    """

    def __init__(self, source: str, e_series: bool) -> None:
        self.source, self._e_series = source, e_series
        self.error: ScriptError | None = None
        self._child, self._file = 0, -1

    def done(self) -> bool:
        """Whether the compilation has finished; the first call starts it. Never waits."""
        if self.error is not None or len(self.source) <= SHORT or (self.source, self._e_series) in _kept:
            return True
        if not self._child:
            self._file = os.memfd_create("urscript")
            self._child = os.fork()
            if self._child == 0:
                _compile_into(self._file, self.source, self._e_series)
        if os.waitpid(self._child, os.WNOHANG)[0] == 0:
            return False
        self._child = 0
        answer = os.pread(self._file, os.fstat(self._file).st_size, 0)
        os.close(self._file)
        if not answer:
            self.error = ScriptError("the compiler ran out of memory")
            return True
        good, *rest = marshal.loads(answer)
        if good:
            _keep(self.source, self._e_series, Compiled(*rest))
        else:
            self.error = ScriptError(rest[0])
            self.error.line = rest[1]
        return True

    def cancel(self) -> None:
        """End the child process, if there is one."""
        if self._child:
            with suppress(ProcessLookupError):
                os.kill(self._child, signal.SIGKILL)
            os.waitpid(self._child, 0)
            os.close(self._file)
            self._child = 0


def _compile_into(file: int, source: str, e_series: bool) -> None:
    """Compile in the child process and exit.

    Inherited descriptors are closed, since they would keep the controller's connections open.
    """
    try:
        os.closerange(3, file)
        os.closerange(file + 1, _MAX_FILES)
        try:
            found = compile_script(source, _builtins(e_series))
            os.write(file, marshal.dumps((True, found.code, found.name, found.secondary)))
        except ScriptError as error:
            os.write(file, marshal.dumps((False, str(error), error.line)))
    finally:
        os._exit(0)

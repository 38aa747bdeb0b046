"""Early detection of the death of the task's process, by a robust mutex in the shared memory.

The kernel closes a dead process's end of a pipe only after it has released its memory: 3 to 6 ms after a SIGKILL, more
with more memory. A robust mutex held by one of its threads is marked before that, after about 0.3 ms (robust futexes:
`man 3 pthread_mutexattr_setrobust`). No process ever blocks on the mutex.
"""

from __future__ import annotations

import ctypes
import errno
import mmap
from typing import Final

SIZE: Final = 64
"""[bytes] of shared memory; a pthread_mutex_t takes 40 or 48 of them."""

_PROCESS_SHARED = _ROBUST = 1
_libc = ctypes.CDLL(None)


class OwnerWatch:
    """Watch over the process that owns the servo process.

    Args:
        memory: Memory mapped by both processes, of which the first SIZE bytes are used.
    """

    def __init__(self, memory: mmap.mmap) -> None:
        self._mutex = (ctypes.c_char * SIZE).from_buffer(memory)
        self._died = False

    def prepare(self) -> None:
        """Initialize the mutex: once, in the task's process, before the servo process starts."""
        attributes = (ctypes.c_char * SIZE)()
        _call("pthread_mutexattr_init", attributes)
        _call("pthread_mutexattr_setpshared", attributes, _PROCESS_SHARED)
        _call("pthread_mutexattr_setrobust", attributes, _ROBUST)
        _call("pthread_mutex_init", self._mutex, attributes)

    def hold(self) -> None:
        """Lock the mutex, in the task's process.

        It is released when the calling thread ends, however it ends; until then the memory must stay mapped.
        """
        _call("pthread_mutex_lock", self._mutex)

    @property
    def owner_alive(self) -> bool:
        """Whether the thread that called `hold` is alive, for the servo process; takes about a microsecond.

        Once False it stays False.
        """
        if not self._died and _libc.pthread_mutex_trylock(self._mutex) == errno.EOWNERDEAD:
            # This thread took it over. Unlocked without being made consistent it is never taken again, and leaves the
            # thread's list of robust mutexes, which would otherwise point into the memory after it is unmapped.
            _call("pthread_mutex_unlock", self._mutex)
            self._died = True
        return not self._died


def _call(name: str, *arguments: object) -> None:
    if code := getattr(_libc, name)(*arguments):
        raise OSError(code, name)

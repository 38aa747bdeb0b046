"""How the servo process learns that the task's process has died, in the kernel's first step of its end.

The other end of a pipe is closed only after the dead process's memory has been given back: 3 to 6 ms after a SIGKILL
have been measured, more with more memory. A robust mutex that one of its threads holds is marked before that, after
0.3 ms (robust futexes: `man 3 pthread_mutexattr_setrobust`). Nobody ever waits for it.
"""

from __future__ import annotations

import ctypes
import errno
import mmap
from typing import Final

SIZE: Final = 64
"""[bytes] of shared memory; a pthread_mutex_t takes 40 or 48 of them, a multiple of 16 from its start."""

_PROCESS_SHARED = _ROBUST = 1
_libc = ctypes.CDLL(None)


class OwnerWatch:
    """On the first SIZE bytes of memory that both processes map."""

    def __init__(self, memory: mmap.mmap) -> None:
        self._mutex = (ctypes.c_char * SIZE).from_buffer(memory)
        self._died = False

    def prepare(self) -> None:
        """The task's process, once, before the other one looks."""
        attributes = (ctypes.c_char * SIZE)()
        _call("pthread_mutexattr_init", attributes)
        _call("pthread_mutexattr_setpshared", attributes, _PROCESS_SHARED)
        _call("pthread_mutexattr_setrobust", attributes, _ROBUST)
        _call("pthread_mutex_init", self._mutex, attributes)

    def hold(self) -> None:
        """The task's process: released when the calling thread ends, however it ends. Until then its memory stays
        mapped."""
        _call("pthread_mutex_lock", self._mutex)

    @property
    def owner_alive(self) -> bool:
        """The servo process: whether the thread that holds it lives. False once, it stays so, and the mutex is
        this thread's: its memory stays mapped. A microsecond."""
        self._died = self._died or _libc.pthread_mutex_trylock(self._mutex) == errno.EOWNERDEAD
        return not self._died


def _call(name: str, *arguments: object) -> None:
    if code := getattr(_libc, name)(*arguments):
        raise OSError(code, name)

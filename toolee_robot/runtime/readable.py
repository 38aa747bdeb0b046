"""Wait until file descriptors of any number can be read."""

from __future__ import annotations

import errno
import os
import select
from collections.abc import Sequence
from math import ceil

SELECT_LIMIT = 1024
"""Descriptors from this number on `select.select` refuses: FD_SETSIZE, select(2)."""


def readable(descriptors: Sequence[int], timeout: float) -> list[int]:
    """Wait until something can be read; the end of a connection and an error count, too.

    Args:
        descriptors: What to wait for.
        timeout: Longest wait [s]; at most 0 for none. With a descriptor over SELECT_LIMIT it is rounded up to 1 ms.

    Returns:
        Those that are ready.

    Raises:
        OSError: One is closed.
        ValueError: One is negative, as that of a closed socket.
    """
    if max(descriptors, default=0) < SELECT_LIMIT:  # exact to microseconds, unlike poll
        return select.select(descriptors, [], [], max(timeout, 0.0))[0]
    poll = select.poll()
    for fd in descriptors:
        poll.register(fd, select.POLLIN)
    ready = poll.poll(ceil(1e3 * max(timeout, 0.0)))
    if any(events & select.POLLNVAL for _, events in ready):
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))
    return [fd for fd, _ in ready]

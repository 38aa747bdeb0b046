"""What waits for a descriptor of any number."""

from __future__ import annotations

import os
import resource
import socket
import time
from collections.abc import Iterator

import pytest

from toolee_robot.devices.ur.protocols import tcp
from toolee_robot.errors import NoAnswerError
from toolee_robot.runtime.readable import readable

MANY = 1100
"""More descriptors than `select.select` can watch, 1024."""


@pytest.fixture(params=[MANY, 0])
def others(request: pytest.FixtureRequest) -> Iterator[int]:
    """So many open descriptors: with MANY, the next one has a number over 1024."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MANY + 100
    if soft != resource.RLIM_INFINITY and soft < wanted:
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        except (ValueError, OSError):
            pytest.skip(f"this system allows no {wanted} open files")
    null = os.open(os.devnull, os.O_RDONLY)
    opened = [null, *(os.dup(null) for _ in range(request.param))]
    yield request.param
    for fd in opened:
        os.close(fd)
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_data_come_and_deadlines_hold_with_any_number_of_open_files(others: int) -> None:
    near, far = socket.socketpair()
    with near, far:
        assert near.fileno() > others
        far.sendall(b"abc")
        assert tcp.receive(near, time.monotonic() + 5.0) == b"abc"
        with pytest.raises(NoAnswerError, match="no answer in time"):
            tcp.receive(near, time.monotonic() + 0.02)
        far.shutdown(socket.SHUT_WR)
        with pytest.raises(NoAnswerError, match="the peer closed the connection"):
            tcp.receive(near, time.monotonic() + 5.0)
        near.close()
        with pytest.raises(NoAnswerError, match="the connection broke"):
            tcp.receive(near, time.monotonic() + 5.0)


@pytest.mark.usefixtures("others")
def test_only_what_is_ready_is_named_and_a_closed_descriptor_is_an_error() -> None:
    (quiet, quiet_end), (ready, ready_end), (ended, ended_end) = (os.pipe() for _ in range(3))
    os.write(ready_end, b"x")
    os.close(ended_end)
    assert readable([quiet, ready, ended], -1.0) == [ready, ended]
    assert readable([], 0.0) == []
    for fd in (quiet, ready, ended, quiet_end, ready_end):
        os.close(fd)
    with pytest.raises(OSError, match="Bad file descriptor"):
        readable([quiet], 0.0)

"""Memory that the task's process and the servo process share: the command path, the robot's state, what was sent.

An anonymous file, mapped by both: it is gone with the last of them, however that one ends. Nobody ever waits for a
lock here: a task that is stopped or killed while it writes must not hold up the servo loop.
"""

from __future__ import annotations

import mmap
import os
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import DeviceError, LimitError
from toolee_robot.frames import Array
from toolee_robot.hardware.ur.servo.owner_watch import SIZE as OWNER_WATCH_SIZE
from toolee_robot.hardware.ur.servo.owner_watch import OwnerWatch
from toolee_robot.types import Trajectory

FASTEST: Final = 500.0  # [Hz]
AFTERWARDS: Final = 5.0  # [s] of braking and settling after the longest path
KNOT_RATE: Final = 1000.0  # [Hz] samples of a trajectory that fit, on average


class Word(IntEnum):
    """Integers. HEARTBEAT and STOP are the task's, the rest is the servo process's. CONNECTING: when the servo process
    began to connect [ns of `time.monotonic_ns()`]. CYCLES goes on as long as its loop does."""

    HEARTBEAT = 0
    STOP = 1
    CYCLES = 2
    ROWS = 3
    OVERRUNS = 4
    CAUSE = 5
    STATE_SEQUENCE = 6
    CONTACT_ROW = 7
    CONNECTING = 8


class Column:
    """Of a row of the log, one for each command cycle. Times in seconds on the station's clock."""

    SENT = 0
    LATENESS = 1
    SEEN = 2
    """When the reading was first seen here."""
    TIMESTAMP = 3
    """The controller's own, of that reading."""
    PATH_TIME = 4
    COMMANDED = slice(5, 11)
    Q = slice(11, 17)
    QD = slice(17, 23)
    WRENCH = slice(23, 29)
    """With the greatest force of those that came since the row before."""
    COUNT = 29


class StateColumn:
    """Of the newest reading."""

    SEEN = 0
    TIMESTAMP = 1
    SAFETY_BITS = 2
    ROBOT_MODE = 3
    RUNTIME_STATE = 4
    Q = slice(5, 11)
    QD = slice(11, 17)
    WRENCH = slice(17, 23)
    COMMANDED = slice(23, 29)
    COUNT = 29


class ServoMemory:
    """fd: of the anonymous file, to hand to the other process. longest: the longest motion that fits [s]. life: the
    task's, of which the servo process sees the end."""

    def __init__(self, fd: int, longest: float) -> None:
        self.fd, self.longest = fd, longest
        samples, knots = int(longest * FASTEST) + 2, int(longest * KNOT_RATE) + 2
        shapes = {
            "state": (StateColumn.COUNT,),
            "reference": (samples, 6),
            "knots": (knots, 19),
            "rows": (samples + int(AFTERWARDS * FASTEST), Column.COUNT),
        }
        words = OWNER_WATCH_SIZE + 8 * len(Word)
        size = words + sum(8 * int(np.prod(shape)) for shape in shapes.values())
        os.ftruncate(fd, size)
        self._map = mmap.mmap(fd, size)
        self.owner = OwnerWatch(self._map)
        self.words: NDArray[np.int64] = np.frombuffer(self._map, np.int64, len(Word), OWNER_WATCH_SIZE)
        offset, views = words, {}
        for name, shape in shapes.items():
            count = int(np.prod(shape))
            views[name] = np.frombuffer(self._map, np.float64, count, offset).reshape(shape)
            offset += 8 * count
        self._state: Array = views["state"]
        self.reference: Array = views["reference"]
        self.knots: Array = views["knots"]
        self.rows: Array = views["rows"]

    @classmethod
    def create(cls, longest: float) -> ServoMemory:
        """The task's, before it starts the servo process."""
        memory = cls(os.memfd_create("toolee-servo", os.MFD_CLOEXEC), longest)
        memory.owner.prepare()
        return memory

    def close(self) -> None:
        """Give up the file; the mapping goes with its last array."""
        os.close(self.fd)

    def write_state(self, state: Array) -> None:
        """state: (StateColumn.COUNT,). The sequence is odd while it is being written."""
        sequence = int(self.words[Word.STATE_SEQUENCE])
        self.words[Word.STATE_SEQUENCE] = sequence + 1
        self._state[:] = state
        self.words[Word.STATE_SEQUENCE] = sequence + 2

    def read_state(self) -> Array:
        """A copy of one whole state. Raises DeviceError when its writer died, or hangs, in mid-write."""
        for _ in range(1000):
            before = int(self.words[Word.STATE_SEQUENCE])
            state = self._state.copy()
            if before % 2 == 0 and before == int(self.words[Word.STATE_SEQUENCE]):
                return state
        raise DeviceError("the servo process stopped while it wrote the arm's state: reset the arm")

    def write_path(self, trajectory: Trajectory, rate: float) -> tuple[int, int]:
        """Put a trajectory in, on the grid of `rate` [Hz] and as it is. Returns the numbers of samples of both."""
        grid = presample(trajectory, rate)
        if trajectory.duration > self.longest or len(trajectory.times) > len(self.knots):
            raise LimitError(
                f"the trajectory takes {trajectory.duration:.1f} s with {len(trajectory.times)} samples; the arm takes "
                f"{self.longest:.0f} s and {len(self.knots)} samples at once: send it in parts"
            )
        n = len(trajectory.times)
        self.reference[: len(grid)] = grid
        self.knots[:n, 0] = trajectory.times
        self.knots[:n, 1:7], self.knots[:n, 7:13], self.knots[:n, 13:19] = trajectory.q, trajectory.qd, trajectory.qdd
        return len(grid), n

    def path(self, knots: int) -> Trajectory:
        """The trajectory that `write_path` put in."""
        table = self.knots[:knots].copy()
        return Trajectory(table[:, 0], table[:, 1:7], table[:, 7:13], table[:, 13:19])


def presample(trajectory: Trajectory, rate: float) -> Array:
    """q (n, 6) at k / rate [s] for k = 1, 2, ... and at the end: `Trajectory.sample`, for all times at once."""
    count = max(int(np.ceil(trajectory.duration * rate - 1e-9)), 1)
    t = np.minimum(np.arange(1, count + 1) / rate, trajectory.duration)
    times, q, qd = trajectory.times, trajectory.q, trajectory.qd
    i = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    h = (times[i + 1] - times[i])[:, None]
    s = (t - times[i])[:, None] / h
    return (
        (2 * s**3 - 3 * s**2 + 1) * q[i]
        + (s**3 - 2 * s**2 + s) * h * qd[i]
        + (3 * s**2 - 2 * s**3) * q[i + 1]
        + (s**3 - s**2) * h * qd[i + 1]
    )

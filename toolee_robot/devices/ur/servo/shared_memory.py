"""Memory shared by the task's process and the servo process: command path, robot state, log of the motion.

An anonymous file mapped by both, which disappears with the last of them, however it ends. Access never waits for a
lock: a task that is stopped or killed while it writes must not delay the servo loop.
"""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from toolee_robot.errors import DeviceError, LimitError
from toolee_robot.frames import Array
from toolee_robot.types import Trajectory

OWNER_WATCH_SIZE: Final = 64
"""[bytes] of shared memory; a pthread_mutex_t takes 40 or 48 of them."""

_PROCESS_SHARED = _ROBUST = 1
_libc = ctypes.CDLL(None)


class OwnerWatch:
    """Early detection of the death of the task's process, by a robust mutex in the shared memory.

    The kernel closes a dead process's end of a pipe only after it has released its memory: 3 to 6 ms after a SIGKILL,
    more with more memory. A robust mutex held by one of its threads is marked before that, after about 0.3 ms (robust
    futexes: `man 3 pthread_mutexattr_setrobust`). No process ever blocks on the mutex.

    Args:
        memory: Memory mapped by both processes, of which the first OWNER_WATCH_SIZE bytes are used.
    """

    def __init__(self, memory: mmap.mmap) -> None:
        self._mutex = (ctypes.c_char * OWNER_WATCH_SIZE).from_buffer(memory)
        self._died = False

    def prepare(self) -> None:
        """Initialize the mutex: once, in the task's process, before the servo process starts."""
        attributes = (ctypes.c_char * OWNER_WATCH_SIZE)()
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


MAX_RATE: Final = 500.0  # [Hz] highest controller rate
SETTLE_ALLOWANCE: Final = 5.0  # [s] of braking and settling after the longest path that the log can hold
KNOT_RATE: Final = 1000.0  # [Hz] highest average sample rate of a trajectory


class Word(IntEnum):
    """Index of the shared 64-bit integers. The task writes HEARTBEAT and STOP, the servo process the others.

    Attributes:
        HEARTBEAT: Counter that advances while the task's process runs.
        STOP: Counter of stop requests.
        CYCLES: Counter of the servo loop's cycles.
        ROWS: Rows of the log that are valid.
        OVERRUNS: Late or missed cycles of the motion.
        CAUSE: `Cause` of the last end of a motion, or of a fault at rest.
        STATE_SEQUENCE: Sequence counter of the state; odd while it is being written.
        CONTACT_ROW: Row of the log at the contact, or -1.
        COMMANDS: Rows of the log up to the last command that was sent.
        CONNECTING: When the servo process began to connect [ns of `time.monotonic_ns()`]; 0 until then.
    """

    HEARTBEAT = 0
    STOP = 1
    CYCLES = 2
    ROWS = 3
    OVERRUNS = 4
    CAUSE = 5
    STATE_SEQUENCE = 6
    CONTACT_ROW = 7
    COMMANDS = 8
    CONNECTING = 9


class Column:
    """Columns of the log, which has one row per command cycle. Times in seconds on the station's clock.

    Attributes:
        SENT: When the command was sent [s].
        LATENESS: Delay of the cycle behind its slot [s].
        SEEN: When the newest reading was received [s].
        TIMESTAMP: The controller's timestamp of that reading [s].
        PATH_TIME: Time on the trajectory [s].
        COMMANDED: Joint positions sent, (6,) [rad].
        Q: Measured joint positions, (6,) [rad].
        QD: Measured joint velocities, (6,) [rad/s].
        WRENCH: Wrench at the flange, (6,) [N, Nm]: of the readings since the previous row, the one with the largest
            force.
        RATIOS: Position deviation ratio and collision ratio, (2,): of the same readings, each one's largest. NaN from a
            controller that does not report it.
        DRIVES: Torques of the commanded motion [Nm] and measured motor currents [A] of the joints, (12,); NaN likewise.
        SAFETY_BITS: RTDE's safety_status_bits.
        COUNT: Number of columns.
    """

    SENT = 0
    LATENESS = 1
    SEEN = 2
    TIMESTAMP = 3
    PATH_TIME = 4
    COMMANDED = slice(5, 11)
    Q = slice(11, 17)
    QD = slice(17, 23)
    WRENCH = slice(23, 29)
    RATIOS = slice(29, 31)
    DRIVES = slice(31, 43)
    SAFETY_BITS = 43
    COUNT = 44


class StateColumn:
    """Elements of the newest reading.

    Attributes:
        SEEN: When it was received [s] on the station's clock.
        TIMESTAMP: The controller's timestamp [s].
        SAFETY_BITS: RTDE's safety_status_bits.
        ROBOT_MODE: RTDE's robot_mode.
        RUNTIME_STATE: RTDE's runtime_state.
        Q: Measured joint positions, (6,) [rad].
        QD: Measured joint velocities, (6,) [rad/s].
        WRENCH: Wrench at the flange, (6,) [N, Nm], axes of `base`.
        COMMANDED: Joint positions sent last, or held by the controller, (6,) [rad].
        SPEED_SLIDER: Position of the speed slider, 0 to 1.
        SPEED_SCALING: Speed of the motion as a fraction of the commanded one.
        RATIOS: Position deviation ratio and collision ratio, (2,): at 1 the controller stops the arm. NaN from a
            controller that does not report it.
        DIGITAL_INPUTS: RTDE's actual_digital_input_bits.
        TORQUES: Joint torques of the commanded motion, as the controller computes them, (6,) [Nm]; NaN likewise.
        CURRENTS: Measured motor currents, (6,) [A]; NaN likewise.
        DRIVES: Both, (12,).
        COUNT: Number of elements.
    """

    SEEN = 0
    TIMESTAMP = 1
    SAFETY_BITS = 2
    ROBOT_MODE = 3
    RUNTIME_STATE = 4
    Q = slice(5, 11)
    QD = slice(11, 17)
    WRENCH = slice(17, 23)
    COMMANDED = slice(23, 29)
    SPEED_SLIDER = 29
    SPEED_SCALING = 30
    RATIOS = slice(31, 33)
    DIGITAL_INPUTS = 33
    TORQUES = slice(34, 40)
    CURRENTS = slice(40, 46)
    DRIVES = slice(34, 46)
    COUNT = 46


class ServoMemory:
    """The shared memory, mapped into this process.

    Args:
        fd: Descriptor of the anonymous file; both processes need it.
        longest: Duration of the longest motion that fits [s].

    Attributes:
        fd: Descriptor of the anonymous file.
        longest: Duration of the longest motion that fits [s].
        owner: Watch over the task's process.
        words: Integers, indexed by `Word`.
        reference: Command path, (samples, 6) [rad], at the controller's rate.
        knots: Trajectory, (knots, 21): time, q, qd, qdd, permitted braking, infinite where it has none.
        rows: Log of the motion, (rows, Column.COUNT).
    """

    def __init__(self, fd: int, longest: float) -> None:
        self.fd, self.longest = fd, longest
        samples, knots = int(longest * MAX_RATE) + 2, int(longest * KNOT_RATE) + 2
        shapes = {
            "state": (StateColumn.COUNT,),
            "reference": (samples, 6),
            "knots": (knots, 21),
            "rows": (samples + int(SETTLE_ALLOWANCE * MAX_RATE), Column.COUNT),
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
        """Create the memory, in the task's process, for motions of at most `longest` [s]."""
        memory = cls(os.memfd_create("toolee-servo", os.MFD_CLOEXEC), longest)
        memory.owner.prepare()
        return memory

    def close(self) -> None:
        """Close the file; the mapping lives as long as an array uses it."""
        os.close(self.fd)

    def write_state(self, state: Array) -> None:
        """Publish a state (StateColumn.COUNT,). The sequence counter is odd while it is being written (a seqlock)."""
        sequence = int(self.words[Word.STATE_SEQUENCE])
        self.words[Word.STATE_SEQUENCE] = sequence + 1
        self._state[:] = state
        self.words[Word.STATE_SEQUENCE] = sequence + 2

    def read_state(self) -> Array:
        """A consistent copy of the state (StateColumn.COUNT,).

        Raises:
            DeviceError: The writer died or hangs in the middle of a write.
        """
        for _ in range(1000):
            before = int(self.words[Word.STATE_SEQUENCE])
            state = self._state.copy()
            if before % 2 == 0 and before == int(self.words[Word.STATE_SEQUENCE]):
                return state
        message = "the servo process stopped while it wrote the arm's state: reset the arm"
        raise DeviceError(message, code="device.torn_state")

    def write_path(self, trajectory: Trajectory, rate: float) -> tuple[int, int]:
        """Store a trajectory, both sampled at the command rate and unchanged.

        Args:
            trajectory: The trajectory.
            rate: The command rate [Hz].

        Returns:
            Number of command samples and number of trajectory samples.

        Raises:
            LimitError: The trajectory does not fit.
        """
        grid = presample(trajectory, rate)
        if trajectory.duration > self.longest or len(trajectory.times) > len(self.knots):
            raise LimitError(
                f"the trajectory takes {trajectory.duration:.1f} s with {len(trajectory.times)} samples; the arm takes "
                f"{self.longest:.0f} s and {len(self.knots)} samples at once: send it in parts",
                code="limit.trajectory_length",
            )
        n = len(trajectory.times)
        self.reference[: len(grid)] = grid
        self.knots[:n, 0] = trajectory.times
        self.knots[:n, 1:7], self.knots[:n, 7:13], self.knots[:n, 13:19] = trajectory.q, trajectory.qd, trajectory.qdd
        self.knots[:n, 19:] = np.inf if trajectory.braking is None else trajectory.braking
        return len(grid), n

    def path(self, knots: int) -> Trajectory:
        """The trajectory of `knots` samples that `write_path` stored."""
        table = self.knots[:knots].copy()
        braking = table[:, 19:] if np.all(np.isfinite(table[:, 19:])) else None
        return Trajectory(table[:, 0], table[:, 1:7], table[:, 7:13], table[:, 13:19], braking)


def presample(trajectory: Trajectory, rate: float) -> Array:
    """Sample a trajectory at a fixed rate, with the cubic Hermite interpolation of `Trajectory.sample`.

    Args:
        trajectory: The trajectory.
        rate: Sampling rate [Hz].

    Returns:
        Joint positions (n, 6) [rad] at k / rate [s] for k = 1, 2, ..., and at the trajectory's end.
    """
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

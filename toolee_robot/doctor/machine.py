"""Checks of the computer: timing for a servo loop, and disk space for recordings."""

from __future__ import annotations

import os
import platform
import resource
import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from toolee_robot.devices.ur.servo.clock import PRIORITY
from toolee_robot.errors import AssetError
from toolee_robot.findings import Finding, fail, ok, warn
from toolee_robot.perception import ToolPerception

CPUS = 4
"""Recommended number of cores: servo process, task with planner, perception, and the rest of the system."""
DISK_FULL, DISK_LOW = 200 << 20, 5 << 30
"""Free space below which the check fails and warns [bytes]; a job's recording takes some tens of megabytes."""
LATE = 1e-3
"""Tolerated lateness of a command [s]."""
_GOVERNORS = "cpu*/cpufreq/scaling_governor"


def check_processor(cpus: Path = Path("/sys/devices/system/cpu")) -> Iterator[Finding]:
    """Check the number of cores that this process may use, and their frequency governor.

    Args:
        cpus: The system's folder of the cores.
    """
    n = len(os.sched_getaffinity(0))
    if n < 2:
        yield fail("cores", f"{n}", "the servo loop needs one of its own: use a machine with 4")
    elif n < CPUS:
        yield warn("cores", f"{n}", f"with {CPUS}, perception and planning cannot delay the servo loop")
    else:
        yield ok("cores", f"{n}")
    governors = set()
    for path in cpus.glob(_GOVERNORS):
        with suppress(OSError):
            governors.add(path.read_text().strip())
    if not governors:
        yield ok("frequency", "not adjustable on this machine")
    elif governors <= {"performance"}:
        yield ok("frequency", "governor performance")
    else:
        yield warn(
            "frequency",
            f"governor {', '.join(sorted(governors))}",
            "cores that sleep wake late: sudo cpupower frequency-set -g performance",
        )


def check_real_time(rate: float) -> Iterator[Finding]:
    """Check kernel, permissions and timing for a servo loop at `rate` [Hz]; timing is measured for 0.5 s."""
    kernel = "PREEMPT_RT" in platform.version() or _flag("/sys/kernel/realtime")
    if kernel:
        yield ok("kernel", "real-time (PREEMPT_RT)")
    else:
        yield warn("kernel", "not a real-time one", "install one with PREEMPT_RT: see docs/how-to/first_nail.md")
    if _may_schedule():
        yield ok("priority", "SCHED_FIFO is allowed")
    else:
        yield warn(
            "priority",
            "SCHED_FIFO is not allowed",
            "other programs can delay the servo loop: set rtprio in /etc/security/limits.conf",
        )
    if _may_lock():
        yield ok("memory", "may be locked")
    else:
        yield warn(
            "memory",
            "may not be locked",
            "it can be paged out in mid-swing: set memlock to unlimited in /etc/security/limits.conf",
        )
    late = wake_up_lateness(rate, 0.5)
    p99 = float(np.percentile(late, 99))
    message = (
        f"{rate:.0f} Hz: 99 % of the cycles less than {p99 * 1e3:.2f} ms late, the worst {late.max() * 1e3:.2f} ms"
    )
    if p99 > LATE:
        yield warn("schedule", message, "stop other programs; commands later than half a cycle count as overruns")
    else:
        yield ok("schedule", message)


def check_disk(folder: Path) -> Finding:
    """Check the free disk space of a folder, which need not exist yet."""
    there = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    if not there.is_dir() or not os.access(there, os.W_OK):
        return fail("recordings", f"{there} cannot be written", "choose another --out")
    free = shutil.disk_usage(there).free
    message = f"{free / 2**30:.1f} GiB free in {folder}"
    if free < DISK_FULL:
        return fail("recordings", message, "make room, or choose another --out")
    if free < DISK_LOW:
        return warn("recordings", message, "make room before a long series")
    return ok("recordings", message)


def wake_up_lateness(rate: float, duration: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Measure how late this process wakes up on an absolute schedule.

    Args:
        rate: Rate of the schedule [Hz].
        duration: Duration of the measurement [s].

    Returns:
        Lateness of every cycle, (n,) [s].
    """
    n = int(rate * duration)
    due = time.monotonic() + np.arange(1, n + 1) / rate
    late = np.zeros(n)
    for i in range(n):
        time.sleep(max(due[i] - time.monotonic(), 0.0))
        late[i] = max(time.monotonic() - due[i], 0.0)
    return late


def _flag(path: str) -> bool:
    with suppress(OSError):
        return Path(path).read_text().strip() == "1"
    return False


def _may_schedule() -> bool:
    """Whether SCHED_FIFO is permitted; tried and undone at once, since permissions have too many sources to be read."""
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        return False
    os.sched_setscheduler(0, policy, parameter)
    return True


def _may_lock() -> bool:
    """Whether locking memory is permitted; tried and undone at once."""
    before = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    try:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    except (ValueError, OSError):
        return False
    resource.setrlimit(resource.RLIMIT_MEMLOCK, before)
    return True


def check_weights(folder: Path | None = None) -> Finding:
    """Check that the weights can be loaded.

    Args:
        folder: Folder of the weights; None for the shipped ones.
    """
    began = time.perf_counter()
    try:
        ToolPerception.load(folder)
    except AssetError as error:
        return Finding.of_error("networks", error, "reinstall the package")
    return ok("networks", f"loaded in {time.perf_counter() - began:.1f} s")

"""Description of the machine, and latency measurements."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

_PACKAGES = ("toolee_robot", "numpy", "scipy", "torch", "torchvision", "pin", "coal", "ruckig", "pybullet", "embreex")


@dataclass(frozen=True)
class Machine:
    """Description of the machine.

    Attributes:
        cpu: Name of the processor.
        cores: Number of cores that this process may use.
        memory_gb: Memory of the machine [GiB].
        system: Operating system, its version, and the architecture.
        python: Version of Python.
        torch_threads: Number of torch's threads.
        arithmetic: Floating-point format of the networks on the processor.
        versions: Versions of the packages that matter, by name.
    """

    cpu: str
    cores: int
    memory_gb: float
    system: str
    python: str
    torch_threads: int
    arithmetic: str
    versions: dict[str, str]


def describe_machine() -> Machine:
    """Read the description from the operating system; "unknown" where it is not available."""
    import torch

    from toolee_robot.perception.precision import prefers_bfloat16

    cpu = platform.processor() or platform.machine() or "unknown"
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [
            line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if line.startswith("model name")
        ]
        cpu = names[0] if names else cpu
    versions = {}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return Machine(
        cpu=cpu,
        cores=len(os.sched_getaffinity(0)),
        memory_gb=round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        system=f"{platform.system()} {platform.release()} {platform.machine()}",
        python=platform.python_version(),
        torch_threads=torch.get_num_threads(),
        arithmetic="bfloat16" if prefers_bfloat16(torch.device("cpu")) else "float32",
        versions=versions,
    )


@dataclass(frozen=True)
class Latency:
    """Wall-clock times of repeated calls.

    Attributes:
        name: What was measured.
        median_ms: Median [ms].
        p90_ms: 90th percentile [ms].
        repeats: Number of calls.
        target_ms: Largest acceptable median [ms]; None without a target.
    """

    name: str
    median_ms: float
    p90_ms: float
    repeats: int
    target_ms: float | None = None

    @property
    def met(self) -> bool | None:
        """Whether the median is under its target; None without a target."""
        return None if self.target_ms is None else self.median_ms < self.target_ms


def measure(
    name: str, call: Callable[[], object], *, repeats: int, warm_up: int = 2, target_ms: float | None = None
) -> Latency:
    """Measure the latency of a call.

    Args:
        name: What is measured.
        call: The call.
        repeats: Number of measured calls.
        warm_up: Number of preceding calls that are not measured.
        target_ms: Largest acceptable median [ms].

    Returns:
        The latency.
    """
    for _ in range(warm_up):
        call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append((time.perf_counter() - start) * 1e3)
    return Latency(name, float(np.median(times)), float(np.percentile(times, 90)), repeats, target_ms)

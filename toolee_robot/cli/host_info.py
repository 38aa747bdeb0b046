"""Description of the machine."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

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

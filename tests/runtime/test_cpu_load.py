"""What other programs take of the cores: this one's own children are none of them."""

from __future__ import annotations

import os
import subprocess
import sys
import time

from toolee_robot.runtime.latency_monitor import _family, _ticks, load_of_others

BUSY = "import time\nend = time.monotonic() + {seconds}\nwhile time.monotonic() < end: pass"


def test_children_and_grandchildren_are_this_programs() -> None:
    nested = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {BUSY.format(seconds=30)!r}])"
    before = _ticks(os.getpid())
    child = subprocess.Popen([sys.executable, "-c", nested], start_new_session=True)
    try:
        end = time.monotonic() + 20.0
        while sum(map(_ticks, _family(os.getpid()))) < before + 30 and time.monotonic() < end:  # 0.3 s
            time.sleep(0.05)
        family = list(_family(os.getpid()))
        assert child.pid in family
        assert len(family) >= 3
        assert sum(map(_ticks, family)) >= before + 30
    finally:
        os.killpg(child.pid, 9)
        child.wait()


def test_a_program_of_somebody_else_counts() -> None:
    """It is started by a process that ends, so that it is nobody's child here."""
    busy = f"import os\nif os.fork() == 0:\n exec({BUSY.format(seconds=4)!r})"
    subprocess.run([sys.executable, "-c", busy], check=True)
    others = load_of_others()
    assert others is not None
    assert 0.5 / (os.cpu_count() or 1) < others <= 1.0

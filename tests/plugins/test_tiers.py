"""Which tests run, in which order and in which processes: asked of a small suite that logs what it does."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest_plugins = ("pytester",)

_ROOT = Path(__file__).parents[2]
_CONFIG = """
[pytest]
addopts = -q --strict-markers --dist loadfile -p tests.plugins.tiers
markers =
    unit
    sim(seconds=0)
    realtime(light=False)
    nightly
"""
_TEST = """
import os
import time
import pytest
from hypothesis import given, strategies

@pytest.mark.parametrize("i", range(3))
def test_it(i):
    with open("log", "a") as log:
        log.write(f"{__name__} {os.getpid()}\\n")
    time.sleep(0.1)

@pytest.mark.nightly
def test_long():
    with open("log", "a") as log:
        log.write(f"{__name__} long\\n")

@given(strategies.integers())
def test_property(number):
    pass
"""


@pytest.fixture
def suite(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """Files of each tier; their names tell it, and that of the clock's is the first in the alphabet."""
    monkeypatch.setenv("PYTHONPATH", str(_ROOT))
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    pytester.makeini(_CONFIG)
    for name, mark in (("b_unit", ""), ("c_unit", ""), ("a_realtime", "realtime"), ("z_sim", "sim(seconds=9)")):
        head = f"import pytest\npytestmark = pytest.mark.{mark}\n" if mark else ""
        pytester.makepyfile(**{f"test_{name}": head + _TEST})
    return pytester


def _log(suite: pytest.Pytester) -> list[list[str]]:
    return [line.split() for line in (suite.path / "log").read_text().splitlines()]


@pytest.mark.nightly
def test_what_is_bound_to_the_clock_runs_last_in_a_process_of_its_own(suite: pytest.Pytester) -> None:
    suite.runpytest_subprocess("-n", "3").assert_outcomes(passed=16)
    log = _log(suite)
    names = [name for name, _ in log]
    assert names[-3:] == ["test_a_realtime"] * 3
    assert "test_a_realtime" not in names[:-3]
    assert "test_z_sim" in names[:2], "what takes long begins early"
    processes = {name: {pid for other, pid in log if other == name} for name in names}
    alone = processes.pop("test_a_realtime")
    assert len(alone) == 1
    assert alone.isdisjoint(pid for pids in processes.values() for pid in pids)
    assert all(len(pids) == 1 for pids in processes.values()), "a file stays in one process"


@pytest.mark.nightly
def test_nightly_tests_run_when_asked_for(suite: pytest.Pytester) -> None:
    suite.runpytest_subprocess("--nightly").assert_outcomes(passed=8, deselected=12)
    suite.runpytest_subprocess("-m", "nightly").assert_outcomes(passed=4, deselected=16)
    suite.runpytest_subprocess("test_c_unit.py::test_long").assert_outcomes(passed=1)
    assert [note for _, note in _log(suite)] == ["long"] * 9


@pytest.mark.nightly
def test_every_test_has_one_tier(suite: pytest.Pytester) -> None:
    for tier, count in (("unit", 8), ("sim", 4), ("realtime", 4)):
        suite.runpytest_subprocess("-m", tier).assert_outcomes(passed=count, deselected=20 - count)

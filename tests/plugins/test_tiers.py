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
    realtime
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


def test_one_worker_runs_everything_and_what_is_bound_to_the_clock_last(suite: pytest.Pytester) -> None:
    suite.runpytest_subprocess("-n", "1").assert_outcomes(passed=16)
    assert [name for name, _ in _log(suite)][-3:] == ["test_a_realtime"] * 3


def test_a_worker_that_dies_is_replaced_and_only_its_test_fails(suite: pytest.Pytester) -> None:
    """One of the others, and then the one that runs what is bound to the clock."""
    crash = "import os, pathlib\ndef test_dies():\n    if not pathlib.Path('{0}').exists():\n"
    crash += "        pathlib.Path('{0}').touch()\n        os._exit(3)\n"
    suite.makepyfile(
        test_d_dies=crash.format("once"),
        test_d_realtime="import pytest\npytestmark = pytest.mark.realtime\n" + crash.format("twice"),
    )
    result = suite.runpytest_subprocess("-n", "3")
    assert result.ret == 1
    assert result.parseoutcomes()["failed"] == 2
    names = [name for name, _ in _log(suite)]
    assert sorted(names) == sorted(3 * ["test_b_unit", "test_c_unit", "test_a_realtime", "test_z_sim"])
    assert names[-3:] == ["test_a_realtime"] * 3


def test_a_choice_of_files_runs_in_the_process_itself(suite: pytest.Pytester) -> None:
    result = suite.runpytest_subprocess("-n", "auto", "test_b_unit.py")
    result.assert_outcomes(passed=4, deselected=1)
    assert "bringing up nodes" not in result.stdout.str()


def test_nightly_tests_run_when_asked_for(suite: pytest.Pytester) -> None:
    suite.runpytest_subprocess("--nightly").assert_outcomes(passed=8, deselected=12)
    suite.runpytest_subprocess("-m", "nightly").assert_outcomes(passed=4, deselected=16)
    suite.runpytest_subprocess("test_c_unit.py::test_long").assert_outcomes(passed=1)
    assert [note for _, note in _log(suite)] == ["long"] * 9


def test_every_test_has_one_tier(suite: pytest.Pytester) -> None:
    for tier, count in (("unit", 8), ("sim", 4), ("realtime", 4)):
        suite.runpytest_subprocess("-m", tier).assert_outcomes(passed=count, deselected=20 - count)

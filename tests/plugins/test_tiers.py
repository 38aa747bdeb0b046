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

_QUIET = ["test_a_realtime"] * 3 + ["test_c_both"] * 3
_LIGHT = ["test_b_light"] * 3 + ["light_in_test_c_both"]
"""Of `with_light`, what is bound to the clock, in its order."""
_DIES = """
import os, pathlib
def test_dies():
    if not pathlib.Path('{0}').exists():
        pathlib.Path('{0}').touch()
        os._exit(3)
"""
_MEETS = """
import pathlib, time, pytest
pytestmark = pytest.mark.{0}
def test_meets():
    end = time.monotonic() + 60.0
    pathlib.Path("{1}").touch()
    while not pathlib.Path("{2}").exists():
        assert time.monotonic() < end
        time.sleep(0.01)
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


@pytest.fixture
def with_light(suite: pytest.Pytester) -> pytest.Pytester:
    """Two more of the clock's files: a light one, and one of which the last test is light."""
    suite.makepyfile(
        test_b_light="import pytest\npytestmark = pytest.mark.realtime(light=True)\n" + _TEST,
        test_c_both="import pytest\npytestmark = pytest.mark.realtime\n"
        + _TEST
        + """
@pytest.mark.realtime(light=True)
def test_light():
    with open("log", "a") as log:
        log.write(f"light_in_{__name__} {os.getpid()}\\n")
""",
    )
    return suite


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


@pytest.mark.nightly
def test_light_ones_run_one_after_another_beside_the_others_that_are_bound_to_the_clock(
    with_light: pytest.Pytester,
) -> None:
    with_light.makepyfile(
        test_d_quiet=_MEETS.format("realtime", "quiet", "light"),
        test_d_light=_MEETS.format("realtime(light=True)", "light", "quiet"),
    )
    with_light.runpytest_subprocess("-n", "4").assert_outcomes(passed=27)
    log = _log(with_light)
    assert {name for name, _ in log[:-10]} == {"test_b_unit", "test_c_unit", "test_z_sim"}, "they have ended before"
    assert [name for name, _ in log[-10:] if name in _QUIET] == _QUIET
    assert [name for name, _ in log[-10:] if name in _LIGHT] == _LIGHT
    quiet, light = ({pid for name, pid in log if name in part} for part in (_QUIET, _LIGHT))
    others = {pid for _, pid in log[:-10]}
    assert (len(quiet), len(light), len(others)) == (1, 1, 2)
    assert len(quiet | light | others) == 4, "in a process that has run no other test"


@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.nightly), 3])
def test_of_few_workers_one_runs_all_that_is_bound_to_the_clock_last(with_light: pytest.Pytester, workers: int) -> None:
    with_light.runpytest_subprocess("-n", str(workers)).assert_outcomes(passed=25)
    log = _log(with_light)
    assert [name for name, _ in log[-10:]] == _QUIET + _LIGHT
    assert len({pid for _, pid in log[-10:]}) == 1
    assert len({pid for _, pid in log}) == workers


@pytest.mark.nightly
def test_a_worker_that_dies_is_replaced_and_only_its_test_fails(with_light: pytest.Pytester) -> None:
    """One of the others, and then both that run what is bound to the clock."""
    head = "import pytest\npytestmark = pytest.mark.{0}\n"
    with_light.makepyfile(
        test_d_dies=_DIES.format("once"),
        test_d_realtime=head.format("realtime") + _DIES.format("twice"),
        test_d_light=head.format("realtime(light=True)") + _DIES.format("thrice"),
    )
    result = with_light.runpytest_subprocess("-n", "4")
    assert result.ret == 1
    outcomes = result.parseoutcomes()
    assert (outcomes["failed"], outcomes["passed"]) == (3, 28), "they pass in the processes that follow"
    names = [name for name, _ in _log(with_light)]
    assert sorted(names[:-10]) == sorted(3 * ["test_b_unit", "test_c_unit", "test_z_sim"])
    assert sorted(names[-10:]) == sorted(_QUIET + _LIGHT)


def test_a_choice_of_files_runs_in_the_process_itself(suite: pytest.Pytester) -> None:
    result = suite.runpytest_subprocess("-n", "auto", "test_b_unit.py")
    result.assert_outcomes(passed=4, deselected=1)
    assert "bringing up nodes" not in result.stdout.str()


@pytest.mark.nightly
def test_nightly_tests_run_when_asked_for(suite: pytest.Pytester) -> None:
    suite.runpytest_subprocess("--nightly").assert_outcomes(passed=8, deselected=12)
    suite.runpytest_subprocess("-m", "nightly").assert_outcomes(passed=4, deselected=16)
    suite.runpytest_subprocess("test_c_unit.py::test_long").assert_outcomes(passed=1)
    assert [note for _, note in _log(suite)] == ["long"] * 9


def test_every_test_has_one_tier(suite: pytest.Pytester) -> None:
    for tier, count in (("unit", 8), ("sim", 4), ("realtime", 4)):
        suite.runpytest_subprocess("-m", tier).assert_outcomes(passed=count, deselected=20 - count)

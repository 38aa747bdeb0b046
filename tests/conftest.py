"""Options of the whole suite, and what becomes of tests that are bound to the clock on the wall. Tiers and processes:
`plugins/tiers.py`."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator

import pytest

from tests.stalls import STALL_LIMIT
from toolee_robot.runtime.latency_monitor import CpuKeepalive, LatencyMonitor

pytest_plugins = ("tests.plugins.tiers",)
FINE = ("tests/benchmarks/test_scripts.py",)
"""Whose own bounds are a millisecond: a stall that the others tolerate breaks them."""
CYCLE = 0.002
"""[s] At 500 Hz: a machine that stalled for so long has missed one itself."""

if "PYTEST_XDIST_WORKER" in os.environ:  # one of several processes: torch would take all cores in each of them
    os.environ.setdefault("OMP_NUM_THREADS", "1")
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # started in the background of a script; programs inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--hardware", metavar="HOST", help="run the arm's contract suite on this robot too: IT MOVES")
    parser.addoption("--camera", metavar="YAML", help="run the camera's contract suite on this station file's too")
    parser.addoption("--hand", metavar="YAML", help="run the hand's on this station file's too: ITS FINGERS MOVE")
    parser.addoption("--person", metavar="YAML", help="run the person's on this station file's too")
    parser.addoption("--hardware-model", default="UR10", choices=["UR10", "UR10e"], help="what robot that is")


class _Machine:
    """How steady it is while tests that are bound to the clock run; no core of it halts meanwhile."""

    def __init__(self) -> None:
        self._latency, self._keepalive = LatencyMonitor(), CpuKeepalive()
        self._running = ""
        self.stalls: dict[str, float] = {}

    def begin(self, name: str) -> None:
        if not gc.get_freeze_count():  # a job in this process ends with none
            gc.collect()
            gc.freeze()  # what the tests before have left makes a full collection long, and no thread runs in it
        if not self._running:
            self._latency.__enter__()
            self._keepalive.__enter__()
        self._running = name
        self._latency.begin()

    def stood_still(self) -> bool:
        stall = self._latency.longest
        if stall < (CYCLE if self._running.startswith(FINE) else STALL_LIMIT):
            return False
        self.stalls[self._running] = stall
        return True

    def end(self) -> None:
        if self._running:
            self._latency.__exit__(None, None, None)
            self._keepalive.__exit__(None, None, None)


_MACHINE = _Machine()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.get_closest_marker("realtime"):
            item.add_marker(pytest.mark.flaky(reruns=2, condition=_MACHINE.stood_still))


@pytest.hookimpl(tryfirst=True)  # before its fixtures
def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("realtime"):
        _MACHINE.begin(item.nodeid)


def pytest_unconfigure() -> None:
    _MACHINE.end()


@pytest.hookimpl(tryfirst=True)  # before a worker sends it
def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.outcome == "rerun" and report.nodeid in _MACHINE.stalls:  # type: ignore[comparison-overlap]
        report.user_properties.append(("stall", _MACHINE.stalls[report.nodeid]))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """What was run again, and why: none of it goes unseen."""
    again = terminalreporter.stats.get("rerun", [])
    for report in again:
        terminalreporter.section(report.nodeid)
        terminalreporter.line(report.longreprtext)
    for report in again:
        stall = dict(report.user_properties).get("stall", 0.0)
        terminalreporter.line(f"RUN AGAIN: {report.nodeid}, the machine stalled for {1e3 * stall:.0f} ms")


@pytest.hookimpl(trylast=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Warn of what moves; pytest's own header is not shown with -q."""
    reporter = session.config.pluginmanager.getplugin("terminalreporter")
    if reporter is not None:
        for warning in _warnings(session.config):
            reporter.write_line(warning, yellow=True, bold=True)


def _warnings(config: pytest.Config) -> Iterator[str]:
    host, hand, person = (config.getoption(option) for option in ("--hardware", "--hand", "--person"))
    if host is not None:
        yield (
            f"WARNING: the robot at {host} WILL MOVE, by up to 0.03 rad a joint. Clear its surroundings, set its speed "
            "slider to 100 %, and keep a hand on the emergency stop."
        )
    if hand is not None:
        yield (
            f"WARNING: the hand of {hand} WILL OPEN AND CLOSE, each time after a person has pressed Enter. Have a "
            "handle ready, and the power switch within reach."
        )
    if person is not None:
        yield f"The arm of {person} is connected and not moved. Be at its door and hold-to-run switch."

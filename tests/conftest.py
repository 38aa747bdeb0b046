"""Options of the whole suite, and how it is spread over several processes."""

from __future__ import annotations

import os
from typing import Any

import pytest

REALTIME = (
    "cli/test_doctor.py",
    "cli/test_hammer_ur.py",
    "cli/test_ur_controller.py",
    "contract/",
    "faults/test_start_rows.py",
    "hardware/test_pace.py",
    "hardware/test_standstill.py",
    "hardware/test_ur_",
    "sim_backend/test_world_service.py",
    "sim_backend/ur_controller/test_compiling.py",
    "sim_backend/ur_controller/test_faults.py",
    "sim_backend/ur_controller/test_survival.py",
    "sim_backend/ur_controller/test_wheel_",
    "tasks/test_swing_faults.py::test_somebody_steps_in",
    "tasks/test_swing_faults.py::test_the_hand_is_watched_all_the_way",
)
"""Beginnings of the names of tests that are bound to the wall's clock: driver, controller stand-in, threads that watch
a motion. `-m realtime` selects them."""

if "PYTEST_XDIST_WORKER" in os.environ:  # one of several processes: torch would take all cores in each of them
    os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--hardware", metavar="HOST", help="run the arm's contract suite on this robot too: IT MOVES")
    parser.addoption("--hardware-model", default="UR10", choices=["UR10", "UR10e"], help="what robot that is")


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if is_realtime(item.nodeid):
            item.add_marker("realtime")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """`pytest -n 2`: what is bound to the wall's clock runs in one process, one after another, and the other process
    does the rest meanwhile."""
    from xdist.scheduler import LoadScopeScheduling

    class OneRealtimeTestAtATime(
        LoadScopeScheduling
    ):  # what has one scope stays in one process; the largest goes first
        def _split_scope(self, nodeid: str) -> str:
            return "realtime" if is_realtime(nodeid) else nodeid

    return OneRealtimeTestAtATime(config, log)


def is_realtime(nodeid: str) -> bool:
    return nodeid.removeprefix("tests/").startswith(REALTIME)


def pytest_report_header(config: pytest.Config) -> str | None:
    host = config.getoption("--hardware")
    if host is None:
        return None
    return (
        f"WARNING: the robot at {host} WILL MOVE, by up to 0.03 rad a joint. Clear its surroundings, set its speed "
        "slider to 100 %, and keep a hand on the emergency stop."
    )

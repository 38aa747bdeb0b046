"""Options of the whole suite, and how it is spread over several processes."""

from __future__ import annotations

import os
import signal
from typing import Any

import pytest

LANES = {
    "driver": (
        "cli/test_hammer_ur.py",
        "contract/",
        "hardware/test_pace.py",
        "hardware/test_standstill.py",
        "hardware/test_ur_",
        "tasks/test_swing_faults.py::test_somebody_steps_in",
        "tasks/test_swing_faults.py::test_the_hand_is_watched_all_the_way",
    ),
    "stand-in": (
        "cli/test_doctor.py",
        "cli/test_ur_controller.py",
        "faults/test_start_rows.py",
        "sim_backend/test_world_service.py",
        "sim_backend/ur_controller/test_compiling.py",
        "sim_backend/ur_controller/test_faults.py",
        "sim_backend/ur_controller/test_survival.py",
        "sim_backend/ur_controller/test_wheel_",
    ),
}
"""Beginnings of the names of tests that are bound to the wall's clock, and wait for it most of the time. Tests of one
lane run one after another, in one process. `-m realtime` selects all of them."""

if "PYTEST_XDIST_WORKER" in os.environ:  # one of several processes: torch would take all cores in each of them
    os.environ.setdefault("OMP_NUM_THREADS", "1")
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # started in the background of a script; programs inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--hardware", metavar="HOST", help="run the arm's contract suite on this robot too: IT MOVES")
    parser.addoption("--hardware-model", default="UR10", choices=["UR10", "UR10e"], help="what robot that is")


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if lane_of(item.nodeid):
            item.add_marker("realtime")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """`pytest -n 3` on two cores: two processes that mostly wait, and one that computes."""
    from xdist.scheduler import LoadScopeScheduling

    class Lanes(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            """Tests of one scope stay in one process; the scopes with most tests go first."""
            return lane_of(nodeid) or nodeid

    return Lanes(config, log)


def lane_of(nodeid: str) -> str | None:
    name = nodeid.removeprefix("tests/")
    return next((lane for lane, beginnings in LANES.items() if name.startswith(beginnings)), None)


def pytest_report_header(config: pytest.Config) -> str | None:
    host = config.getoption("--hardware")
    if host is None:
        return None
    return (
        f"WARNING: the robot at {host} WILL MOVE, by up to 0.03 rad a joint. Clear its surroundings, set its speed "
        "slider to 100 %, and keep a hand on the emergency stop."
    )

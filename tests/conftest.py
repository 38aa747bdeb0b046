"""Options of the whole suite."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--hardware", metavar="HOST", help="run the arm's contract suite on this robot too: IT MOVES")
    parser.addoption("--hardware-model", default="UR10", choices=["UR10", "UR10e"], help="what robot that is")


def pytest_report_header(config: pytest.Config) -> str | None:
    host = config.getoption("--hardware")
    if host is None:
        return None
    return (
        f"WARNING: the robot at {host} WILL MOVE, by up to 0.03 rad a joint. Clear its surroundings, set its speed "
        "slider to 100 %, and keep a hand on the emergency stop."
    )

"""The tiers of the tests, which of them run, and in how many processes.

`unit`: what no other marker claims. `sim`: simulated stations, renderings, small trainings, whole jobs. `realtime`:
bound to the wall clock; they run one at a time, after all others, and beside each of them at most a light one
(`realtime_last.py`). `nightly`: long ones, of any tier; they run with --nightly, with `-m nightly`, or by their name.
"""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

from tests.examples import NIGHTLY, QUICK

if TYPE_CHECKING:
    from xdist.remote import Producer
    from xdist.workermanage import WorkerController

    from tests.plugins.realtime_last import RealtimeLast

TIERS = ("unit", "sim", "realtime")
_MOST_CORES = 8
"""That get a process each; more would wait for the longest file."""
_MEMORY = 2e9
"""Of the machine for each process [B]."""
_FOLDER = pytest.StashKey[tempfile.TemporaryDirectory[str]]()
_LIST = "tiers"
"""Of a worker's input: the path of the file in which it says what tier each test is of."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--nightly", action="store_true", help="run the nightly tier: long tests, and property tests with more examples"
    )


def pytest_configure(config: pytest.Config) -> None:
    settings.register_profile("quick", deadline=None, max_examples=QUICK)
    settings.register_profile("nightly", deadline=None, max_examples=NIGHTLY)
    settings.load_profile("nightly" if config.getoption("--nightly") else "quick")


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        if not any(item.get_closest_marker(tier) for tier in TIERS):
            item.add_marker("unit")
    if config.getoption("--nightly"):
        selected = [item for item in items if item.get_closest_marker("nightly") or _has_examples(item)]
    elif "nightly" in config.getoption("-m"):
        return
    else:
        named = {str(argument).split("[")[0].rpartition("::")[2] for argument in config.args if "::" in str(argument)}
        selected = [item for item in items if not item.get_closest_marker("nightly") or _name(item) in named]
    chosen = set(selected)
    config.hook.pytest_deselected(items=[item for item in items if item not in chosen])
    items[:] = selected


def _name(item: pytest.Item) -> str:
    return getattr(item, "originalname", None) or item.name


def _has_examples(item: pytest.Item) -> bool:
    return bool(getattr(getattr(item, "obj", None), "is_hypothesis_test", False))


# -- processes --------------------------------------------------------------------------------------------------------


@pytest.hookimpl(optionalhook=True, tryfirst=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """One for each core, one more since tests also wait, and two for those marked `realtime`; none for single files."""
    files = any(Path(str(argument).partition("::")[0]).suffix == ".py" for argument in config.args)
    options = any(getattr(config.option, name, None) for name in ("keyword", "lf", "hardware"))
    if files or options or config.getoption("-m") == "realtime":
        return 0
    workers = min(len(os.sched_getaffinity(0)), _MOST_CORES) + 3
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return workers if memory >= workers * _MEMORY else workers - 1


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: WorkerController) -> None:
    stash = node.config.stash
    folder = stash.setdefault(_FOLDER, tempfile.TemporaryDirectory(prefix="toolee-tests-"))
    node.workerinput[_LIST] = str(Path(folder.name) / "tiers.json")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> RealtimeLast | None:
    if config.getoption("dist") != "loadfile":
        return None
    from tests.plugins.realtime_last import RealtimeLast

    return RealtimeLast(config, log, Path(config.stash[_FOLDER].name) / "tiers.json")


@pytest.hookimpl(tryfirst=True)  # before the worker says that it has collected
def pytest_collection_finish(session: pytest.Session) -> None:
    given: dict[str, Any] = getattr(session.config, "workerinput", {})
    if _LIST not in given:
        return
    tiers: dict[str, dict[str, float]] = {tier: {} for tier in (*TIERS, "light")}
    for item in session.items:
        (marker,) = (marker for tier in TIERS if (marker := item.get_closest_marker(tier)))
        tier = "light" if marker.kwargs.get("light") else marker.name
        tiers[tier][item.nodeid] = marker.kwargs.get("seconds", 0.0)
    path = Path(given[_LIST])
    own = path.with_suffix(f".{given['workerid']}")
    own.write_text(json.dumps(tiers))
    own.replace(path)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    folder = config.stash.get(_FOLDER, None)
    if folder is not None:
        folder.cleanup()

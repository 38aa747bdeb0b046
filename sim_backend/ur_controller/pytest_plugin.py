"""pytest fixtures for tests of your own UR program: a controller that answers as a UR10 or UR10e does.

In conftest.py: pytest_plugins = ("toolee_robot.sim_backend.ur_controller.pytest_plugin",)
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import count
from typing import Any

import pytest

from toolee_robot.sim_backend.ur_controller.process import ControllerProcess

StartController = Callable[..., ControllerProcess]


def _addresses() -> Iterator[str]:
    """Loopback addresses that no other pytest process hands out: the ports of a controller are fixed."""
    worker = os.getpid()
    for n in count():
        yield f"127.{1 + worker // 254 % 254}.{1 + worker % 254}.{1 + n % 254}"


_ADDRESSES = _addresses()


@pytest.fixture
def start_ur_controller() -> Iterator[StartController]:
    """A function that starts a controller with the fields of `ControllerOptions`, such as `model="UR10e"`.

    Each gets an address of its own, `controller.host`, and ends with the test, after what `controller.on_exit` closes.
    """
    with ExitStack() as stack:

        def start(**options: Any) -> ControllerProcess:
            return stack.enter_context(ControllerProcess(**{"host": next(_ADDRESSES), **options}))

        yield start


@pytest.fixture
def ur10(start_ur_controller: StartController) -> ControllerProcess:
    """A UR10 (CB3, 125 Hz), powered on, flange down."""
    return start_ur_controller(model="UR10")


@pytest.fixture
def ur10e(start_ur_controller: StartController) -> ControllerProcess:
    """A UR10e (e-Series, 500 Hz), powered on, flange down."""
    return start_ur_controller(model="UR10e")

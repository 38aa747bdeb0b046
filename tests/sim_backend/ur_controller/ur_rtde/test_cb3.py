"""The unmodified ur_rtde against the stand-in for a UR10 (CB3, 125 Hz)."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.sim_backend.ur_controller.ur_rtde.contract import Bench, UrRtdeContract, open_bench

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def rig() -> Iterator[Bench]:
    with open_bench("UR10", "127.0.0.13") as bench:
        yield bench


class TestCb3(UrRtdeContract):
    """Everything, at 125 Hz."""

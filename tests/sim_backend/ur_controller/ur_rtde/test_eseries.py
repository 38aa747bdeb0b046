"""The unmodified ur_rtde against the stand-in for a UR10e (e-Series, 500 Hz)."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.sim_backend.ur_controller.ur_rtde.client import UrRtde
from tests.sim_backend.ur_controller.ur_rtde.contract import Bench, UrRtdeContract, open_bench

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def rig() -> Iterator[Bench]:
    with open_bench("UR10e", "127.0.0.14") as bench:
        yield bench


@pytest.mark.nightly  # the CB3's in every run
class TestESeriesContract(UrRtdeContract):
    pass


class TestESeries:
    @pytest.fixture
    def bench(self, rig: Bench) -> Bench:
        rig.ready()
        return rig

    test_tells_what_it_is = UrRtdeContract.test_tells_what_it_is
    test_servo_j_follows = UrRtdeContract.test_servo_j_follows

    def test_serial_number_and_remote_control(self, bench: Bench) -> None:
        assert bench.ur_rtde.call("dashboard", "getSerialNumber").isdigit()
        assert bench.ur_rtde.call("dashboard", "isInRemoteControl") is True

    def test_local_control_refuses_the_control_interface(self, bench: Bench) -> None:
        bench.controller.fault("remote", remote=False)
        try:
            with UrRtde(bench.controller.host) as second, pytest.raises(RuntimeError, match="enable remote control"):
                second.open("control")
        finally:
            bench.controller.fault("remote", remote=True)

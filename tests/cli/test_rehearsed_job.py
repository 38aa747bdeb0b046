"""What a rehearsed job says where something came late."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from toolee_robot.cli.hammering.job import HammerJob
from toolee_robot.cli.hammering.sources import Opened, Tell
from toolee_robot.errors import DeviceError, StaleDataError
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.devices.arm import SimArm
from toolee_robot.station import StationConfig, sim_station
from toolee_robot.tasks.hammering.grasp import nominal_grasp

pytestmark = pytest.mark.sim(seconds=10)

CONFIG = sim_station()
WHY = "data came late, because this machine is busy. Close other programs"


@dataclass(frozen=True)
class DeadLink:
    """A simulated station whose arm no longer answers."""

    why: str
    facts: Mapping[str, Any] = field(default_factory=dict)
    config: StationConfig = CONFIG
    real_time_factor: float | None = None
    mode: str = "its arm's link is dead"

    @contextmanager
    def open(self, tell: Tell, doing: Tell) -> Iterator[Opened]:  # noqa: ARG002
        def why_late(error: DeviceError) -> str:
            assert isinstance(error, StaleDataError)
            return self.why

        with SimStation.build(CONFIG, 3, SimOptions()) as sim:
            assert isinstance(sim.station.arm, SimArm)
            sim.station.arm.cut_link()
            sim.world.advance(0.5)
            grasp = nominal_grasp(sim.tool, CONFIG)
            yield Opened(sim.station, CONFIG, grasp, sim.tool.name, "a hammer", sim.judge, sim.tool, why_late)


@pytest.mark.parametrize("why", [WHY, ""])
def test_the_reason_of_a_job_that_ended_for_late_data_says_why_they_were_late(tmp_path: Path, why: str) -> None:
    report = HammerJob(DeadLink(why), perfect_perception=True).run(tmp_path, Console(file=io.StringIO()))
    reason = report.figures["reason"]
    assert report.figures["outcome"] == "device_fault"
    assert "network link" in reason
    assert reason.endswith(". Data came late, because this machine is busy. Close other programs") == bool(why)

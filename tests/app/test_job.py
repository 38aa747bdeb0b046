"""`run_job` from inside: what its result says, and what it refuses."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.errors import raises
from tests.examples import seldom
from toolee_robot.app.job import JobSpec, run_job, true_poses
from toolee_robot.app.simulated import Rehearsal, Simulated, simulated_station
from toolee_robot.app.sources import Lab, Opened, Source, Tell
from toolee_robot.app.variant import Variant
from toolee_robot.errors import DeviceError, StaleDataError, TooleeError, UserError
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.devices.arm import SimArm
from toolee_robot.station import SIMULATED_CALIBRATION, StationConfig, load_lab_station, sim_station
from toolee_robot.tasks.hammering.grasp import nominal_grasp

CONFIG = sim_station()
LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"
WHY = "data came late, because this machine is busy. Close other programs"


@dataclass(frozen=True)
class DeadLink:
    """A simulated station whose arm no longer answers."""

    why: str
    facts: Mapping[str, Any] = field(default_factory=dict)
    config: StationConfig = CONFIG
    name: str = "dead"
    real_time_factor: float | None = None
    mode: str = "its arm's link is dead"

    def check(self, doing: Tell) -> None: ...

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


@pytest.mark.sim(seconds=10)
@pytest.mark.parametrize("why", seldom(WHY, ""))
def test_the_reason_of_a_job_that_ended_for_late_data_says_why_they_were_late(tmp_path: Path, why: str) -> None:
    job = run_job(JobSpec(DeadLink(why), Variant.PERFECT_PERCEPTION), tmp_path)
    reason = job.figures["reason"]
    assert job.figures["outcome"] == job.result.outcome == "device_fault"
    assert job.folder.name.endswith("-dead")
    assert {path.name for path in job.folder.iterdir()} == {"summary.json", "recording.mcap", "picture.png"}
    assert "network link" in reason
    assert reason.endswith(". Data came late, because this machine is busy. Close other programs") == bool(why)


_ON_A_FULL_DISK = """
import resource, sys
from pathlib import Path
from tests.app.test_job import DeadLink
from toolee_robot.app.job import JobSpec, run_job
from toolee_robot.app.sources import JobObserver
from toolee_robot.app.variant import Variant
class Told(JobObserver):
    def opened(self, *_):
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
    def message(self, text):
        print(text)
job = run_job(JobSpec(DeadLink(""), Variant.PERFECT_PERCEPTION), Path(sys.argv[1]), Told())
print(job.figures["outcome"], sorted(path.name for path in job.folder.iterdir()))
"""


@pytest.mark.sim(seconds=10)
@pytest.mark.nightly
def test_a_full_disk_loses_neither_the_result_nor_the_folder(tmp_path: Path) -> None:
    command = [sys.executable, "-c", _ON_A_FULL_DISK, str(tmp_path)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "recording has stopped, the job goes on: File too large" in said
    assert "picture.png is missing" in said
    assert "device_fault ['recording.mcap', 'summary.json']" in said


@pytest.mark.sim(seconds=10)
def test_a_job_prints_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run_job(JobSpec(DeadLink(""), Variant.PERFECT_PERCEPTION), tmp_path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.sim(seconds=10)
@pytest.mark.parametrize(
    ("variant", "nails", "weights", "words"),
    [
        (Variant.FULL, ("left",), None, "the station's nails are"),
        (Variant.PAPER, (), None, "--paper-weights"),
        (Variant.NO_CORRECTION, (), Path(), "--paper-weights"),
    ],
)
def test_what_is_no_job_is_refused(variant: Variant, nails: tuple[str, ...], weights: Path | None, words: str) -> None:
    with raises(UserError, says=words):
        JobSpec(Simulated(CONFIG, 0), variant, weights, nails)


@pytest.mark.sim(seconds=10)
def test_a_seed_and_a_real_time_factor_are_within_bounds() -> None:
    lab = load_lab_station(LAB)
    with raises(UserError, says="give a whole number from 0"):
        Simulated(CONFIG, -1)
    with raises(UserError, says="to 1, which is real time"):
        Rehearsal(lab, LAB, 0, factor=1.5)
    assert Rehearsal(lab, LAB, 0).real_time_factor == 0.25


@pytest.mark.sim(seconds=10)
def test_a_simulation_ignores_a_real_calibration_and_says_so() -> None:
    said: list[str] = []
    station = simulated_station(LAB, tell=said.append)
    assert (station.calibration, len(said)) == (SIMULATED_CALIBRATION, 1)
    assert f"ignores the calibration in {LAB}" in said[0]


@pytest.mark.sim(seconds=10)
def test_what_is_missing_is_told_before_the_networks_are_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("toolee_robot.app.job.job_networks", lambda *_: pytest.fail("the networks were loaded"))
    lab = load_lab_station(LAB)
    assert lab.camera.device is not None
    sources: tuple[Source, ...] = (
        Lab(replace(lab, calibration=None), LAB),
        Rehearsal(replace(lab, calibration=None), LAB, 0),
        Lab(lab, LAB),
    )
    for source, named in zip(sources, ("calibration", "calibration", lab.camera.device.serial), strict=True):
        with pytest.raises(TooleeError) as refused:
            run_job(JobSpec(source), tmp_path)
        assert named in str(refused.value)
        assert not list(tmp_path.iterdir())


@pytest.mark.sim(seconds=10)
def test_a_real_robots_job_loads_no_simulation() -> None:
    """Neither its parts nor the job itself, with the networks."""
    code = (
        "import sys, toolee_robot.app.job, toolee_robot.app.sources\n"
        "print([name for name in sys.modules if 'sim_backend' in name or name in ('pybullet', 'rehearsal')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def opened() -> Any:
    """What a perceiver needs of the open devices of a real station."""
    return SimpleNamespace(config=sim_station(), truth=None)


def test_what_only_a_simulation_knows_is_refused_on_a_robot() -> None:
    with raises(UserError, says="only a simulation knows"):
        true_poses(opened())

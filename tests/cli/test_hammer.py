"""`toolee hammer` from outside: what it prints, what it leaves, and that it can be stopped."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import pytest
from mcap.reader import make_reader

from tests.paper_weights import untrained_paper_weights
from toolee_robot.perception.evaluation.ledger import weights_hash
from toolee_robot.recording.reading import read_history

pytestmark = pytest.mark.sim(seconds=150)

_FIGURES = {
    "success",
    "outcome",
    "reason",
    "strikes",
    "protrusion_mm",
    "pose_error_mm",
    "pose_error_deg",
    "strike_offset_mm",
    "strike_tilt_deg",
    "stage_seconds",
    "seed",
    "run_folder",
}


def _start(folder: Path, *args: str) -> subprocess.Popen[str]:
    code = "from toolee_robot.cli import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", code, "hammer", *args],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
    )


def _only_folder(runs: Path) -> Path:
    (folder,) = runs.iterdir()
    return folder


def _line(out: str) -> dict[str, Any]:
    lines = out.splitlines()
    assert len(lines) == 1, "with --json, standard output is one line"
    record = json.loads(lines[0])
    assert set(record) >= _FIGURES
    return dict(record)


@dataclass(frozen=True)
class _Job:
    """A job that ran to its end.

    Attributes:
        returncode: Exit code of the command.
        record: The line that --json prints.
        err: Standard error.
        folder: Where the command ran; it wrote to out/.
    """

    returncode: int
    record: dict[str, Any]
    err: str
    folder: Path


def _whole_job(folder: Path, *args: str) -> _Job:
    process = _start(folder, "--seed", "101", "--json", "--out", "out", *args)
    out, err = process.communicate(timeout=600)
    return _Job(process.returncode, _line(out), err, folder)


@pytest.fixture(scope="module")
def corrected(tmp_path_factory: pytest.TempPathFactory) -> _Job:
    """Camera and networks in the loop."""
    return _whole_job(tmp_path_factory.mktemp("corrected"), "--exact")


def test_the_whole_job_ends_with_the_nail_flush(corrected: _Job) -> None:
    record = corrected.record
    assert corrected.returncode == 0, corrected.err
    assert (record["success"], record["outcome"], record["seed"]) == (True, "flush", 101)
    assert (record["correction"], record["perfect_perception"]) == (True, False)
    assert record["protrusion_mm"] <= 1.5
    assert record["strikes"] >= 3, "a nail of 20 mm takes more than a tap"
    assert {"handover", "grip", "view", "perceive", "plan", "touch", "strike", "park"} <= set(record["stage_seconds"])
    assert "Drive the nail" in corrected.err


def test_the_corrected_job_is_as_accurate_as_measured(corrected: _Job) -> None:
    """Bounds of twice what `toolee hammer --seed 101 --exact` gave: 0.81 mm, 0.22 deg, 0.54 mm.

    The tilt of a single hammer is chance (0.41, 0.76 and 1.12 deg with three versions, the last two of which tilt alike
    over 59 hammers): its bound is what 95 of the hundred of docs/benchmark/hammer_100.json keep; their median is 1.0.
    """
    record = corrected.record
    assert 0.0 < record["pose_error_mm"] <= 1.62
    assert 0.0 < record["pose_error_deg"] <= 0.44
    assert record["strike_offset_mm"] <= 1.07
    assert record["strike_tilt_deg"] <= 1.71


def test_the_whole_job_leaves_a_whole_folder(corrected: _Job) -> None:
    record = corrected.record
    folder = _only_folder(corrected.folder / "out")
    assert record["run_folder"] == f"out/{folder.name}"
    assert sorted(p.name for p in folder.iterdir()) == ["picture.png", "recording.mcap", "summary.json"]
    summary = json.loads((folder / "summary.json").read_text())
    log = summary["strike_log"]
    assert len(log) == record["strikes"]
    assert record["largest_impulse"] == pytest.approx(max(s["load"]["impulse"] for s in log), abs=1e-3)
    assert record["largest_flange_force"] == pytest.approx(max(s["peak_force"] for s in log), abs=1e-3)
    assert 0.1 < record["largest_torque_share"] < 1.0
    assert {strike["struck_by"] for strike in summary["strike_truth"]} == {"face"}
    assert summary["station"]["work"]["nail_protrusion"] == 0.02
    picture = cv2.imread(str(folder / "picture.png"))
    assert picture is not None
    assert picture.shape[1] > 1500
    with (folder / "recording.mcap").open("rb") as file:
        counts = make_reader(file).get_summary()
        assert counts is not None
        assert counts.statistics is not None
        topics = {c.topic: counts.statistics.channel_message_counts[i] for i, c in counts.channels.items()}
    assert topics["/camera/rgb"] == topics["/camera/depth"] >= 3
    assert topics["/arm/measured"] > 100
    history = read_history(folder / "recording.mcap")
    assert history.metadata["seed"] == str(record["seed"])
    assert history.station().work.nail_protrusion == 0.02
    motions = [decision.data for _, decision in history.decisions if decision.name == "motion"]
    met = [m["name"] for m in motions if m["outcome"] == "contact" and m["name"].startswith(("touch the", "strike"))]
    assert topics["/contacts"] == len(met) >= record["strikes"] + 6, "nail and wood were touched three times at least"


def test_a_job_that_is_told_what_a_person_measures_drives_the_nail(tmp_path: Path) -> None:
    (tmp_path / "short.yaml").write_text("work: {nail_protrusion: 0.006}")
    job = _whole_job(tmp_path, "--perfect-perception", "--config", "short.yaml")
    assert job.returncode == 0, job.err
    assert job.record["outcome"] == "flush"
    errors = job.record["errors"]
    assert errors["camera_mm"] > 0.5
    assert errors["nail_beside_mm"] > 0.1
    # Nobody told it that the nail leans; driven, it leans as it did, but for what it was bent.
    assert errors["nail_lean_deg"] > 0.1
    assert job.record["nail_lean_deg"] == pytest.approx(errors["nail_lean_deg"], abs=job.record["nail_bend_deg"] + 0.01)
    # The face is where the job takes it to be, and the nail is not.
    assert job.record["strike_offset_mm"] == pytest.approx(errors["nail_beside_mm"], abs=1.5)


def test_without_correction_the_same_hammer_misses_the_nail(tmp_path: Path) -> None:
    """What the correction is worth: measured, the face passes 48 mm beside the nail, tilted by 17 deg."""
    job = _whole_job(tmp_path, "--no-correction", "--exact")
    record = job.record
    assert job.returncode == 1, job.err
    assert (record["success"], record["outcome"], record["nail"]) == (False, "nail_missed", "standing")
    assert "the nail is not where the face went" in record["reason"]
    assert record["correction"] is False
    assert record["pose_error_mm"] is None
    assert record["strike_offset_mm"] > 30.0
    assert record["protrusion_mm"] > 19.5
    assert set(record["stage_seconds"]).isdisjoint({"view", "perceive"})
    assert "park" in record["stage_seconds"]
    assert "Traceback" not in job.err


def test_the_papers_estimator_takes_the_pose_networks_place(tmp_path: Path) -> None:
    """Of a network that has learnt nothing the samples agree on no place, so that no nail is struck."""
    weights = untrained_paper_weights(tmp_path / "weights")
    job = _whole_job(tmp_path, "--exact", "--ablation", "paper", "--paper-weights", str(weights))
    record = job.record
    assert job.returncode == 1, job.err
    assert (record["success"], record["strikes"], record["ablation"]) == (False, 0, "paper")
    assert record["outcome"] == "pose_unknown"
    assert record["paper_weights"] == weights_hash(weights)
    assert "perceive" in record["stage_seconds"]


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_stops_the_arm_and_is_reported(tmp_path: Path, sign: signal.Signals) -> None:
    process = _start(tmp_path, "--perfect-perception", "--seed", "101", "--json")
    assert process.stderr is not None
    for text in process.stderr:
        if text.startswith("Handover"):
            break
    time.sleep(0.5)
    process.send_signal(sign)
    out, err = process.communicate(timeout=60)
    record = _line(out)
    assert process.returncode == 130, err
    assert (record["success"], record["outcome"]) == (False, "interrupted")
    assert "the arm was stopped" in record["reason"]
    assert "Traceback" not in err
    summary = json.loads((_only_folder(tmp_path / "runs") / "summary.json").read_text())
    assert summary["outcome"] == "interrupted"


@pytest.mark.nightly
def test_a_nail_out_of_reach_ends_the_job_with_a_reason_and_the_arm_parked(tmp_path: Path) -> None:
    (tmp_path / "lab.yaml").write_text("frame: base_link\nwork: {nail_xy: [2.5, 0.1]}")
    process = _start(tmp_path, "--perfect-perception", "--seed", "101", "--json", "--config", "lab.yaml")
    out, err = process.communicate(timeout=120)
    record = _line(out)
    assert process.returncode == 1, err
    assert (record["outcome"], record["strikes"]) == ("no_plan", 0)
    assert "move the block" in record["reason"]
    assert "park" in record["stage_seconds"]
    assert "Traceback" not in err

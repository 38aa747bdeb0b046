"""What is shown of a run at a time, replayed and live, and in a browser."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
import time
import urllib.error
import urllib.request
from dataclasses import replace
from pathlib import Path
from subprocess import PIPE
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.nails import with_nails
from tests.recording import small_run
from tests.rigs.job_rig import CONFIG, SEED
from tests.viewer.browser import CHROMIUM, browser
from tests.viewer.logged import Logged, at
from toolee_robot.frames import Array
from toolee_robot.recording.history import RunHistory, Series
from toolee_robot.recording.observer import RecordingObserver
from toolee_robot.recording.reading import read_history
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.robots import load_robot
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.physics.wood import NailSpec
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.sim_backend.visuals import NailVisuals
from toolee_robot.station import NailConfig, sim_station
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tasks.hammering.task import HammeringTask
from toolee_robot.viewer.rerun_page import LivePage, RerunPage
from toolee_robot.viewer.run_view import RunStates, RunView, blueprint
from toolee_robot.viewer.station_view import CAMERA_BOX

RUNS = Path(__file__).parents[2] / "docs" / "benchmark" / "runs"


def _now(shown: dict[str, Any], stamp: float) -> str:
    return str(at(shown["now"], stamp, "text")[0])


@pytest.mark.sim(seconds=15)
def test_it_shows_the_run_by_time(tmp_path: Path) -> None:
    history = read_history(small_run.write(tmp_path / "run.mcap"))
    logged = Logged(tmp_path / "run.rrd")
    RunView(logged.stream, history, history.station()).update()
    shown = logged.read()
    assert "Handover" in _now(shown, 0.0)
    assert "20.0 mm over the wood" in _now(shown, 0.0)
    description = load_robot()
    links = description.link_poses(small_run.REACHED, description.hand_open)
    elbow = shown["world/bodies/forearm_link"]
    np.testing.assert_allclose(at(elbow, 2.0, "translation")[0], links["forearm_link"][:3, 3], atol=1e-6)
    head = shown["world/bodies/nail_head_nail"]
    sunk = np.subtract(at(head, 4.2, "translation"), at(head, 0.0, "translation"))[0]
    assert sunk[2] == pytest.approx(-0.0077, abs=1e-6), "the nail goes down with the hammer's strikes"
    assert [t for t, row in shown["world/tool"] if "blob" in row] == [2.0], "the tool is there once it is held"
    X_hand_ee = small_run.X_HAND_EE
    np.testing.assert_allclose(
        at(shown["world/tool"], 4.2, "translation")[0], (links[description.hand_frame] @ X_hand_ee)[:3, 3], atol=1e-6
    )
    said = _now(shown, 4.2)
    assert "12.3 mm over the wood" in said
    assert "strike 1: expected, 12.3 mm left, 54 N" in said
    assert "the nail went in" in said
    assert _now(shown, 5.0).startswith("# FLUSH\n\n## flush: the head stands 0.2 mm over the wood")
    assert max(row["scalars"][0] for t, row in shown["force"] if t >= 0.0) == 54.0
    assert [row["scalars"][0] for t, row in shown["nail"] if t >= 0.0] == pytest.approx([20.0, 12.3])
    assert len(shown["world/hand/seen/cloud"][0][1]["positions"]) == 50
    assert len(shown["world/hand/seen/candidates"][0][1]["vectors"]) == 3 * 8
    for ellipsoid in ("world/hand/seen/estimate", "world/hand/fused"):
        np.testing.assert_allclose(shown[ellipsoid][0][1]["half_sizes"][0], [0.01] * 3)
    assert [row["text"][0].split(":")[0] for _, row in shown["decisions"]] == [
        "stage", "stage", "pose in hand", "stage", "the nail went in", "strike", "ended",
    ]  # fmt: skip


@pytest.mark.nightly
@pytest.mark.sim(seconds=15)
def test_a_recorded_strike_is_shown_with_the_face_on_the_nail() -> None:
    """The handle turns in the fingers in a strike, which no sensor sees: the believed face is 100 mm in the wood."""
    path = RUNS / "full" / "20261130-213931-seed14023" / "recording.mcap"
    history = read_history(path)
    config = history.station()
    states = RunStates(history, config)
    lowest = 1.0
    for stamp in history.joints.stamps:
        X = states.at(stamp).X_base_ee
        if X is not None:
            p = X[:3, 3] - config.work.p_base_entry
            height = p @ config.work.nail_axis
            if np.linalg.norm(p - height * config.work.nail_axis) < max(config.work.block_size[:2]) / 2:
                lowest = min(lowest, float(height))
    assert -0.003 < lowest < 0.003, "on the wood beside the nail"


@pytest.mark.sim(seconds=15)
def test_it_follows_a_job_that_runs(tmp_path: Path) -> None:
    history = RunHistory(complete=False)
    logged = Logged(tmp_path / "run.rrd")
    view = RunView(logged.stream, history, sim_station(), live=True)
    view.prompt("Lay the hammer into the open hand.")
    with RunRecorder(tmp_path / "run.mcap", {"X_hand_ee": np.eye(4), "X_tool_ee": np.eye(4)}) as recorder:
        history.metadata.update(recorder.metadata)
        recorder.history = history
        small_run.record(recorder)
        end = time.monotonic() + 20.0
        while time.monotonic() < end and (not len(history.decisions) or history.decisions.values[-1].name != "ended"):
            view.update()
            time.sleep(0.02)
    view.update()
    view.update()
    shown = logged.read()
    assert len(shown["world/hand/seen/cloud"]) == 1
    said = [row["text"][0] for _, row in shown["now"]]
    assert "Connecting" in said[0]
    assert any("➤ Lay the hammer into the open hand." in text for text in said)
    assert "➤" not in said[-1], "the job has gone on"
    assert said[-1].startswith("# FLUSH")
    assert "12.3 mm over the wood" in said[-1]
    assert len([1 for t, row in shown["force"] if t >= 0.0]) == 2 * 126, "nothing is left out, nothing comes twice"


@pytest.mark.sim(seconds=15)
def test_the_page_asks_no_other_computer_and_answers_none() -> None:
    page = RerunPage("test", blueprint(), 8310)
    try:
        with urllib.request.urlopen(page.address) as served:
            policy = served.headers["Content-Security-Policy"]
            web, data = re.findall(r"http://[\d.:]+", served.url)
            assert b"<html" in served.read(2000)
        assert web == page.address
        assert re.findall(r"https?://[^ ;]+", policy) == [data]
        named = urllib.request.Request(page.address, headers={"Host": "elsewhere.example"})
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(named)
        for origin, allowed in (("http://evil.example", None), (web, web)):
            headers = {"Origin": origin, "Access-Control-Request-Method": "POST"}
            asked = urllib.request.Request(f"{data}/x", method="OPTIONS", headers=headers)
            with urllib.request.urlopen(asked) as answer:
                assert answer.headers["Access-Control-Allow-Origin"] == allowed
    finally:
        page.close()
    with pytest.raises(urllib.error.URLError, match="refused"):
        urllib.request.urlopen(page.address)


@pytest.mark.sim(seconds=15)
@pytest.mark.nightly
@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine")
def test_a_browser_shows_the_page(tmp_path: Path) -> None:
    history = read_history(small_run.write(tmp_path / "run.mcap"))
    page = RerunPage("test", blueprint(), 8310)
    try:
        RunView(page.stream, history, history.station()).update()
        with browser() as view:
            view.goto(page.address)
            camera = 0
            end = time.monotonic() + 90.0
            while camera < 300 and time.monotonic() < end:
                view.wait_for_timeout(2_000)
                pixels = np.asarray(Image.open(io.BytesIO(view.screenshot())).convert("RGB")).astype(int)[:, :900]
                camera = (abs(pixels - CAMERA_BOX).max(axis=-1) < 40).sum()
        assert camera > 300, "the camera's box is drawn"
    finally:
        page.close()


@pytest.mark.nightly
@pytest.mark.sim(seconds=15)
def test_a_live_page_ends_with_the_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("toolee_robot.viewer.rerun_page.SEEN_S", 0.0)
    page = LivePage(sim_station(), 8310)
    with urllib.request.urlopen(page.address) as served:
        assert served.status == 200
    with RunRecorder(tmp_path / "run.mcap", {"X_hand_ee": np.eye(4), "X_tool_ee": np.eye(4)}) as recorder:
        page.follow(recorder)
        small_run.record(recorder)
    page.close()


LEANS = {"left": (0.0, 0.0), "right": (0.12, -0.05)}


@pytest.mark.parametrize("name", LEANS)
def test_each_nail_sinks_along_its_own_axis(name: str) -> None:
    nails = (NailConfig("left", (0.75, 0.12)), NailConfig("right", (0.75, 0.08), lean=LEANS["right"]))
    config = replace(
        sim_station(),
        work=with_nails(replace(sim_station().work, block_size=(0.08, 0.14, 0.06), wood_rise=(0.02, 0.03)), *nails),
    )
    history = RunHistory()
    history.nails[name] = Series()
    history.nails[name].add(1.0, 0.004)
    work = config.work.only(name)
    states = RunStates(history, config)
    sunk = states.at(2.0).sunk
    visuals = NailVisuals(name, NailSpec.from_config(work))
    driven = visuals.bodies(work.X_base_nail(0.004))
    for before, after in zip(visuals.bodies(work.X_base_nail()), driven, strict=True):
        X = states.X_base_nail_part(before.name, before.X_base_body, sunk)
        np.testing.assert_allclose(X, after.X_base_body, atol=1e-12)


_MAIN = "from toolee_robot.cli import main; main()"


def _address(job: subprocess.Popen[str]) -> str:
    assert job.stderr is not None
    for line in job.stderr:
        if found := re.search(r"http://[\d.:]+", line):
            return found[0]
    raise AssertionError("no address was told")


@pytest.mark.nightly
@pytest.mark.sim
def test_a_job_is_shown_while_it_runs(tmp_path: Path) -> None:
    options = ["--seed", "100", "--view", "--json", "--out", str(tmp_path)]
    command = [sys.executable, "-c", _MAIN, "sim", "hammer", *options]
    with subprocess.Popen(command, stdout=PIPE, stderr=PIPE, text=True) as job:
        try:
            with urllib.request.urlopen(_address(job)) as served:
                assert b"<html" in served.read(2000)
            assert job.poll() is None, "the job still runs"
            said, _ = job.communicate(timeout=600.0)
        finally:
            job.kill()
    assert json.loads(said.splitlines()[-1])["success"]


@pytest.mark.nightly
@pytest.mark.sim(seconds=40)
def test_the_face_is_drawn_where_it_was_also_in_a_strike(tmp_path: Path) -> None:
    true: list[tuple[float, Array]] = []
    with SimStation.build(CONFIG, SEED, SimOptions()) as sim:
        grasp = nominal_grasp(sim.tool, CONFIG)
        metadata = {"X_hand_ee": grasp.X_hand_ee, "X_tool_ee": grasp.X_tool_ee}
        with RunRecorder(tmp_path / "run.mcap", metadata) as recorder:
            observer = RecordingObserver(recorder, sim.station, CONFIG)
            sim.world.observers.append(lambda sample: true.append((sample.stamp, sim.world.X_base_ee()[:3, 3])))
            HammeringTask(sim.station, PerfectPerception(sim.judge), CONFIG, grasp, observer=observer).run()
    history = read_history(tmp_path / "run.mcap")
    states, work = RunStates(history, CONFIG), CONFIG.work
    looked = history.in_hand.stamps[0]
    compared = 0
    for stamp, p in true:
        X = states.at(stamp).X_base_ee if looked < stamp < history.end else None
        if X is None:
            continue
        compared += 1
        up = float((X[:3, 3] - p) @ work.nail_axis)
        beside = float(np.linalg.norm(X[:3, 3] - p - up * work.nail_axis))
        assert beside < 0.015, f"{stamp:.2f} s"
        assert -0.005 < up < 0.020, f"{stamp:.2f} s: the nail is drawn as measured last, and goes in by up to 20 mm"
        over = X[:3, 3] - work.p_base_entry
        height = float(over @ work.nail_axis)
        away = float(np.linalg.norm(over - height * work.nail_axis))
        assert height > -0.003 or away > max(work.block_size[:2]) / 2, f"{stamp:.2f} s: in the wood"
    assert compared > 500
    strikes = [d for _, d in history.decisions if d.name == "strike"]
    assert len(strikes) == 1

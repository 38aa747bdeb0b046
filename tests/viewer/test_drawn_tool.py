"""The tool is drawn where it was: a short recorded job against the simulation's truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.rigs.job_rig import CONFIG, SEED
from toolee_robot.frames import Array
from toolee_robot.recording.observer import RecordingObserver
from toolee_robot.recording.reading import read_history
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tasks.hammering.task import HammeringTask
from toolee_robot.viewer.run_state import RunStates


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

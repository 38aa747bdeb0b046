"""Where a run's nails are drawn after they were driven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from toolee_robot.recording.history import RunHistory, Series
from toolee_robot.sim_backend.physics.wood import NailSpec
from toolee_robot.sim_backend.visuals import NailVisuals
from toolee_robot.station import NailConfig, sim_station
from toolee_robot.viewer.run_state import RunStates

LEANS = {"left": (0.0, 0.0), "right": (0.12, -0.05)}


@pytest.mark.parametrize("name", LEANS)
def test_each_nail_sinks_along_its_own_axis(name: str) -> None:
    nails = (NailConfig("left", (0.75, 0.12)), NailConfig("right", (0.75, 0.08), lean=LEANS["right"]))
    config = replace(
        sim_station(),
        work=replace(sim_station().work, block_size=(0.08, 0.14, 0.06), wood_rise=(0.02, 0.03)).with_nails(*nails),
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

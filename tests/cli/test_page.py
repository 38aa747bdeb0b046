"""The page of a job: what the person reads on it, and where the robot stands."""

from __future__ import annotations

import urllib.request
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from toolee_robot.cli.hammering.page import JobPage
from toolee_robot.config import StationConfig
from toolee_robot.control import RobotModel
from toolee_robot.hal import MotionReport
from toolee_robot.tasks.common.outcome import Stage, Strike


@pytest.fixture
def page() -> Iterator[JobPage]:
    page = JobPage(StationConfig(), 8310)
    yield page
    page.close()


@pytest.mark.sim(seconds=10)
def test_it_shows_stage_prompt_nail_and_robot(page: JobPage) -> None:
    with urllib.request.urlopen(page.address) as served:
        assert b"<html" in served.read(2000)
    assert "20.0 mm over the wood" in page.text
    page.stage_started(Stage.HANDOVER)
    page.prompt("Lay the hammer into the open hand.")
    assert "Handover" in page.text
    assert "➤ Lay the hammer into the open hand." in page.text
    robot, q = RobotModel.of_station(StationConfig()), np.array([0.3, -1.5, 1.6, -1.2, -1.5, 0.2])
    q_hand = robot.description.hand_open
    page.motion("to the handover", cast("MotionReport", SimpleNamespace(q_commanded=q[None])), q_hand)
    assert "➤" not in page.text, "the job has gone on"
    handle: Any = page._picture._meshes["forearm_link"]
    np.testing.assert_allclose(
        handle.position, robot.description.link_poses(q, q_hand)["forearm_link"][:3, 3], atol=1e-6
    )
    strike = cast("Strike", SimpleNamespace(number=3, protrusion=0.0123, peak_force=54.0))
    page.strike(strike)
    assert "12.3 mm over the wood" in page.text
    assert "strike 3: 12.3 mm left, 54 N" in page.text

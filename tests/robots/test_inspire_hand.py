"""An Inspire hand from a station file: its driver, what `toolee doctor` says of it, and its model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.devices.hands import open_hand
from toolee_robot.devices.hands.inspire import InspireHand
from toolee_robot.devices.hands.mount import MountedTool
from toolee_robot.errors import ConfigError
from toolee_robot.robots import hand_model, load_robot, wrap_fingers
from toolee_robot.robots.hands.inspire import CLOSED, INSPIRE, OPEN, joints_of_counts
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import HandConfig, StationConfig, load_station, sim_station
from toolee_robot.types import HandMounting

EXAMPLES = Path(__file__).parents[2] / "examples"
TURNED = HandMounting(position=(0.0, 0.02, 0.1), fingers=(0.0, 2.0, 0.0), thumb=(0.0, 0.0, -3.0))


@pytest.fixture(scope="module")
def config() -> StationConfig:
    return load_station(EXAMPLES / "inspire.yaml")


def test_every_lab_measures_how_it_is_mounted(config: StationConfig) -> None:
    with raises(ConfigError, "config.hand_mounting"):
        hand_model(HandConfig(INSPIRE))
    with raises(ConfigError, "config.hand_mounting"):
        hand_model(replace(sim_station().hand, mounting=TURNED))
    with raises(ConfigError, "config"):
        _ = hand_model(INSPIRE).tree
    with pytest.raises(ValueError, match="right angle"):
        HandMounting(position=(0.0, 0.0, 0.0), fingers=(0.0, 0.0, 1.0), thumb=(0.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="no direction"):
        HandMounting(position=(0.0, 0.0, 0.0), fingers=(0.0, 0.0, 0.0), thumb=(0.0, 1.0, 0.0))
    q = hand_model(config.hand).posture("open")
    for mounting in (TURNED, config.hand.mounting):
        assert mounting is not None
        X = load_robot(hand=replace(config.hand, mounting=mounting)).X_flange_hand(q)
        np.testing.assert_allclose(X, mounting.X_flange_hand, atol=1e-9)
    np.testing.assert_allclose(TURNED.X_flange_hand[:3, 2], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(TURNED.X_flange_hand[:3, 0], [0.0, 0.0, -1.0], atol=1e-12)


def test_counts_become_joints_within_the_models_limits(config: StationConfig) -> None:
    model = hand_model(config.hand)
    lower, upper = model.tree.limits()
    for counts in (OPEN, CLOSED, (1000,) * 6, (-20, 1100, 500, 500, 500, 500)):
        q = joints_of_counts(np.array(counts))
        assert np.all(q >= lower - 1e-9)
        assert np.all(q <= upper + 1e-9)
    np.testing.assert_allclose(joints_of_counts(np.array(OPEN)), model.posture("open"))
    np.testing.assert_allclose(joints_of_counts(np.array(CLOSED)), model.posture("closed"))
    one = joints_of_counts(np.array([1000, 1000, 1000, 500, 1000, 1000]))
    assert {name for name, q in zip(model.joints, one, strict=True) if q > 0} == {"index_knuckle", "index_middle"}


def test_its_fingers_wrap_around_a_handle(config: StationConfig) -> None:
    model = hand_model(config.hand)
    for radius in (0.012, 0.016):
        X_hand_tool = model.grasp.X_hand_tool(radius)
        q = wrap_fingers(model, X_hand_tool, radius)
        for finger in model.fingers:
            tip = model.link_poses(q)[finger.phalanges[-1].link] @ [0.0, 0.0, finger.phalanges[-1].length, 1.0]
            x, y, *_ = np.linalg.inv(X_hand_tool) @ tip
            assert radius < np.hypot(x, y) < 0.06
    open_tip = model.link_poses(model.posture("open"))["middle_distal"][:3, 3]
    assert open_tip[2] > 0.13, "fingers are along z"
    assert model.link_poses(model.posture("closed"))["middle_distal"][1, 3] < -0.02, "the palm faces -y"


def test_the_station_file_names_the_driver(config: StationConfig) -> None:
    clock = HostClock()
    assert isinstance(open_hand(config.hand, clock), InspireHand)
    assert isinstance(open_hand(load_station(EXAMPLES / "mount.yaml").hand, clock), MountedTool)
    with raises(ConfigError, "config.hand_port"):
        open_hand(replace(config.hand, port=None), clock)

"""An Ability Hand from a station file: its driver, what `toolee doctor` says of it, and its model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.devices.hands import open_hand
from toolee_robot.devices.hands.ability import AbilityHand
from toolee_robot.errors import ConfigError
from toolee_robot.robots import hand_model, wrap_fingers
from toolee_robot.robots.hands.ability import ABILITY, CLOSED, OPEN, joints_of_closures
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import HandConfig, StationConfig, load_station


@pytest.fixture(scope="module")
def config() -> StationConfig:
    return load_station(Path(__file__).parents[2] / "examples" / "ability.yaml")


def test_every_lab_measures_how_it_is_mounted(config: StationConfig) -> None:
    with raises(ConfigError, "config.hand_mounting"):
        hand_model(HandConfig(ABILITY))
    mounting = config.hand.mounting
    assert mounting is not None
    model = hand_model(config.hand)
    np.testing.assert_allclose(
        model.tree.link_poses(model.posture("open"))[model.frame], mounting.X_flange_hand, atol=1e-9
    )


def test_closures_become_joints_within_the_models_limits(config: StationConfig) -> None:
    model = hand_model(config.hand)
    lower, upper = model.tree.limits()
    for closures in (OPEN, CLOSED, (-5.0, 120.0, 50.0, 50.0, 50.0, 50.0)):
        q = joints_of_closures(np.array(closures))
        assert np.all(q >= lower - 1e-9)
        assert np.all(q <= upper + 1e-9)
    np.testing.assert_allclose(joints_of_closures(np.array(OPEN)), model.posture("open"))
    np.testing.assert_allclose(joints_of_closures(np.array(CLOSED)), model.posture("closed"))
    one = joints_of_closures(np.array([0.0, 0.0, 40.0, 0.0, 0.0, 0.0]))
    assert {name for name, q in zip(model.joints, one, strict=True) if q > 0} == {"ring_knuckle", "ring_middle"}


def test_its_fingers_wrap_around_a_handle_and_it_is_a_right_hand(config: StationConfig) -> None:
    model = hand_model(config.hand)
    for radius in (0.012, 0.016):
        X_hand_tool = model.grasp.X_hand_tool(radius)
        q = wrap_fingers(model, X_hand_tool, radius)
        for finger in model.fingers[1:]:
            tip = model.link_poses(q)[finger.phalanges[-1].link] @ [0.0, 0.0, finger.phalanges[-1].length, 1.0]
            x, y, *_ = np.linalg.inv(X_hand_tool) @ tip
            assert radius < np.hypot(x, y) < 0.06
    stretched = model.link_poses(model.posture("open"))
    assert stretched["middle_distal"][2, 3] > 0.12, "fingers are along z"
    assert stretched["index_distal"][0, 3] > 0.02 > -0.02 > stretched["little_distal"][0, 3], "the thumb's side is +x"
    assert stretched["thumb_distal"][0, 3] > 0.03
    assert model.link_poses(model.posture("closed"))["middle_distal"][1, 3] < -0.02, "the palm faces -y"


def test_the_makers_own_description_has_the_same_fingertips(config: StationConfig) -> None:
    """Of PSYONIC's URDF, its tip's frame `index_anchor` at index_q1 = 0 and 0.8 rad, by its own joints and mimics."""
    model = hand_model(config.hand)
    tip = np.array([0.0, 0.0, 0.033237, 1.0])
    for closure, expected in ((0.0, (-0.0298, -0.0088, 0.1667)), (0.8, (-0.0219, 0.0455, 0.1183))):
        q = joints_of_closures(np.array([np.rad2deg(closure), 0.0, 0.0, 0.0, 0.0, 0.0]))
        x, y, z, _ = model.link_poses(q)["index_distal"] @ tip
        np.testing.assert_allclose((-x, -y, z), expected, atol=2e-4)


def test_the_station_file_names_the_driver(config: StationConfig) -> None:
    assert isinstance(open_hand(config.hand, HostClock()), AbilityHand)
    with raises(ConfigError, "config.hand_port"):
        open_hand(replace(config.hand, port=None), HostClock())

"""The hands with a driver from their station files: driver, mounting, and how their motors move the model's joints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.errors import raises
from toolee_robot.errors import ConfigError
from toolee_robot.frames import Array
from toolee_robot.robots import SHADOW_HAND, hand_model, load_robot, wrap_fingers
from toolee_robot.robots.hands import ability, inspire
from toolee_robot.robots.hands.shadow import CLOSED, MAKER_SIGNS, MOTORS, OPEN, joints_of_motors, motors_of_joints
from toolee_robot.station import HandConfig, load_station, sim_station
from toolee_robot.types import HandMounting

TURNED = HandMounting(position=(0.0, 0.02, 0.1), fingers=(0.0, 2.0, 0.0), thumb=(0.0, 0.0, -3.0))
MAKER_AXES = {
    "rh_FFJ4": (0, -1, 0), "rh_MFJ4": (0, -1, 0), "rh_RFJ4": (0, 1, 0), "rh_LFJ4": (0, 1, 0), "rh_FFJ3": (1, 0, 0),
    "rh_FFJ1": (1, 0, 0), "rh_LFJ5": (0.5736, 0, 0.8192), "rh_THJ5": (-0.7071, 0, -0.7071),
    "rh_THJ4": (0.7071, 0, -0.7071), "rh_THJ3": (0.7071, 0, -0.7071), "rh_THJ2": (0, -1, 0), "rh_THJ1": (0, -1, 0),
}  # fmt: skip
"""Axes in the stretched hand's palm frame, of `sr_description/hand/xacro` (shadow-robot/sr_common at efa7d387)."""
RANGES = {
    "J1": (0, 90), "J2": (0, 90), "J3": (-15, 90), "J4": (-20, 20), "LFJ5": (0, 45), "THJ1": (-15, 90),
    "THJ2": (-40, 40), "THJ3": (-12, 12), "THJ4": (0, 70), "THJ5": (-60, 60), "WRJ1": (-40, 28), "WRJ2": (-30, 10),
}  # fmt: skip
"""Ranges of the Shadow Hand's joints [deg] (user guide, *Ranges*)."""


def config(name: str) -> HandConfig:
    return load_station(Path(__file__).parents[2] / "examples" / f"{name}.yaml").hand


@pytest.mark.parametrize("name", ["inspire", "ability"])
def test_every_lab_measures_how_it_is_mounted(name: str) -> None:
    hand = config(name)
    with raises(ConfigError, says="hand.mounting.position"):
        hand_model(HandConfig(hand.model))
    with raises(ConfigError, "config"):
        _ = hand_model(hand.model).tree
    q = hand_model(hand).posture("open")
    for mounting in (TURNED, hand.mounting):
        assert mounting is not None
        X = load_robot(hand=replace(hand, mounting=mounting)).X_flange_hand(q)
        np.testing.assert_allclose(X, mounting.X_flange_hand, atol=1e-9)


def test_what_is_no_mounting() -> None:
    with raises(ConfigError, says="hand.mounting: the model"):
        hand_model(replace(sim_station().hand, mounting=TURNED))
    with pytest.raises(ValueError, match="right angle"):
        HandMounting(position=(0.0, 0.0, 0.0), fingers=(0.0, 0.0, 1.0), thumb=(0.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="no direction"):
        HandMounting(position=(0.0, 0.0, 0.0), fingers=(0.0, 0.0, 0.0), thumb=(0.0, 1.0, 0.0))
    np.testing.assert_allclose(TURNED.X_flange_hand[:3, 2], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(TURNED.X_flange_hand[:3, 0], [0.0, 0.0, -1.0], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "maker", "joints_of", "beyond", "one", "bent"),
    [
        ("inspire", inspire, inspire.joints_of_counts, (-20, 1100, 500, 500, 500, 500),
         (1000, 1000, 1000, 500, 1000, 1000), "index"),
        ("ability", ability, ability.joints_of_closures, (-5, 120, 50, 50, 50, 50), (0, 0, 40, 0, 0, 0), "ring"),
    ],
    ids=["inspire", "ability"],
)  # fmt: skip
def test_motors_become_joints_within_the_models_limits(
    name: str, maker: Any, joints_of: Any, beyond: tuple[int, ...], one: tuple[int, ...], bent: str
) -> None:
    model = hand_model(config(name))
    lower, upper = model.tree.limits()
    for motors in (maker.OPEN, maker.CLOSED, beyond):
        q = joints_of(np.array(motors, float))
        assert np.all(q >= lower - 1e-9)
        assert np.all(q <= upper + 1e-9)
    np.testing.assert_allclose(joints_of(np.array(maker.OPEN)), model.posture("open"))
    np.testing.assert_allclose(joints_of(np.array(maker.CLOSED)), model.posture("closed"))
    moved = {name for name, q in zip(model.joints, joints_of(np.array(one, float)), strict=True) if q > 0}
    assert moved == {f"{bent}_knuckle", f"{bent}_middle"}


@pytest.mark.parametrize(("name", "first"), [("inspire", 0), ("ability", 1)])
def test_its_fingers_wrap_around_a_handle(name: str, first: int) -> None:
    model = hand_model(config(name))
    for radius in (0.012, 0.016):
        X_hand_tool = model.grasp.X_hand_tool(radius)
        q = wrap_fingers(model, X_hand_tool, radius)
        for finger in model.fingers[first:]:
            tip = model.link_poses(q)[finger.phalanges[-1].link] @ [0.0, 0.0, finger.phalanges[-1].length, 1.0]
            x, y, *_ = np.linalg.inv(X_hand_tool) @ tip
            assert radius < np.hypot(x, y) < 0.06
    stretched = model.link_poses(model.posture("open"))
    assert stretched["middle_distal"][2, 3] > (0.13 if name == "inspire" else 0.12), "fingers are along z"
    assert model.link_poses(model.posture("closed"))["middle_distal"][1, 3] < -0.02, "the palm faces -y"


def test_the_ability_hand_is_a_right_one_with_the_makers_fingertips() -> None:
    """Of PSYONIC's URDF, its tip's frame `index_anchor` at index_q1 = 0 and 0.8 rad, by its own joints and mimics."""
    model = hand_model(config("ability"))
    stretched = model.link_poses(model.posture("open"))
    assert stretched["index_distal"][0, 3] > 0.02 > -0.02 > stretched["little_distal"][0, 3], "the thumb's side is +x"
    assert stretched["thumb_distal"][0, 3] > 0.03
    tip = np.array([0.0, 0.0, 0.033237, 1.0])
    for closure, expected in ((0.0, (-0.0298, -0.0088, 0.1667)), (0.8, (-0.0219, 0.0455, 0.1183))):
        q = ability.joints_of_closures(np.array([np.rad2deg(closure), 0.0, 0.0, 0.0, 0.0, 0.0]))
        x, y, z, _ = model.link_poses(q)["index_distal"] @ tip
        np.testing.assert_allclose((-x, -y, z), expected, atol=2e-4)


@pytest.mark.parametrize("joint", MAKER_AXES)
def test_the_shadow_hands_joints_turn_about_the_models_axes(joint: str) -> None:
    hand = SHADOW_HAND
    q = np.zeros(len(hand.joints))
    index = hand.joints.index(joint)
    q[index] = 0.1 * MAKER_SIGNS[index]
    still, turned = hand.link_poses(np.zeros(len(hand.joints))), hand.link_poses(q)
    moved = [still[link][:3, :3].T @ turned[link][:3, :3] for link in still]
    turns = [still[link][:3, :3] @ _vector(R) for link, R in zip(still, moved, strict=True) if np.trace(R) < 2.999]
    np.testing.assert_allclose(turns[0] / np.linalg.norm(turns[0]), MAKER_AXES[joint], atol=0.01)


def _vector(R: Array) -> Array:
    return np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])


def test_the_shadow_hands_postures_are_within_the_makers_ranges() -> None:
    assert len(MOTORS) == len(set(MOTORS)) == 20
    for motors in (OPEN, CLOSED):
        q = MAKER_SIGNS * joints_of_motors(np.array(motors))
        np.testing.assert_allclose(motors_of_joints(MAKER_SIGNS * q), motors, atol=1e-9)
        for joint, angle in zip(SHADOW_HAND.joints, q, strict=True):
            low, high = RANGES.get(joint[3:]) or RANGES[joint[5:]]
            low, high = np.deg2rad(low), np.deg2rad(high)
            assert low - 1e-9 <= angle <= high + 1e-9, joint
    np.testing.assert_allclose(joints_of_motors(np.array(OPEN)), SHADOW_HAND.posture("open"), atol=1e-9)

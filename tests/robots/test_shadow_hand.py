"""A Shadow Hand from a station file: its driver, what `toolee doctor` says of it, and how its joints are counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from toolee_robot.devices.hands import open_hand
from toolee_robot.devices.hands.shadow import ShadowHand
from toolee_robot.frames import Array
from toolee_robot.robots import SHADOW_HAND
from toolee_robot.robots.hands.shadow import CLOSED, MAKER_SIGNS, MOTORS, OPEN, joints_of_motors, motors_of_joints
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import StationConfig, load_station

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
"""Ranges of the joints [deg] (user guide, *Ranges*)."""


@pytest.fixture(scope="module")
def config() -> StationConfig:
    return load_station(Path(__file__).parents[2] / "examples" / "shadow.yaml")


@pytest.mark.parametrize("joint", MAKER_AXES)
def test_the_makers_joints_turn_about_the_models_axes(joint: str) -> None:
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


def test_postures_are_within_the_makers_ranges() -> None:
    assert len(MOTORS) == len(set(MOTORS)) == 20
    for motors in (OPEN, CLOSED):
        q = MAKER_SIGNS * joints_of_motors(np.array(motors))
        np.testing.assert_allclose(motors_of_joints(MAKER_SIGNS * q), motors, atol=1e-9)
        for joint, angle in zip(SHADOW_HAND.joints, q, strict=True):
            low, high = RANGES.get(joint[3:]) or RANGES[joint[5:]]
            low, high = np.deg2rad(low), np.deg2rad(high)
            assert low - 1e-9 <= angle <= high + 1e-9, joint
    np.testing.assert_allclose(joints_of_motors(np.array(OPEN)), SHADOW_HAND.posture("open"), atol=1e-9)


def test_the_station_file_names_the_driver(config: StationConfig) -> None:
    assert isinstance(open_hand(config.hand, HostClock()), ShadowHand)

"""A hand that a lab's package brings: what its record and its model file may not say."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from tests.robots.three_finger import THREE_FINGER_HAND
from toolee_robot.errors import AssetError
from toolee_robot.robots import HANDS, load_robot

pytestmark = pytest.mark.sim

HAND = THREE_FINGER_HAND


@pytest.fixture(scope="module", autouse=True)
def _known() -> Iterator[None]:
    HANDS[HAND.name] = HAND
    yield
    del HANDS[HAND.name]


def test_a_model_file_with_other_joints_is_refused(tmp_path: Path) -> None:
    text = HAND.source.read_text()
    (tmp_path / "hand.urdf").write_text(text.replace("a_bend", "first_bend"))
    with pytest.raises(AssetError, match="first_bend"):
        _ = replace(HAND, source=tmp_path / "hand.urdf").tree
    (tmp_path / "hand.urdf").write_text(text.replace('type="revolute"', 'type="prismatic"', 1))
    with pytest.raises(AssetError, match="prismatic"):
        _ = replace(HAND, source=tmp_path / "hand.urdf").tree
    (tmp_path / "hand.urdf").write_text(text.replace("gripper_base", "base_link"))
    HANDS["clash"] = replace(HAND, name="clash", source=tmp_path / "hand.urdf")
    with pytest.raises(AssetError, match="base_link"):
        load_robot(hand="clash")
    del HANDS["clash"]


def test_a_record_that_names_no_joint_of_its_own_is_refused() -> None:
    with pytest.raises(ValueError, match="rh_FFJ3"):
        replace(HAND, closing_order=(("rh_FFJ3",),))

"""Perception of held tools, about the hand against the whole image: what counts, and the paired differences."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toolee_robot.cli.app import run
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.perception import StageTimes
from toolee_robot.perception.detection.hand_crop import hand_crop
from toolee_robot.perception.offline.dataset.records import SHOWN_HAND, Example
from toolee_robot.perception.offline.dataset.scene_writer import write_scene
from toolee_robot.perception.offline.dataset.spec import DatasetSpec
from toolee_robot.perception.offline.evaluation.held import (
    ABOUT_HAND,
    WHOLE,
    HeldTool,
    Seen,
    compare,
    held_tools,
    judge,
)
from toolee_robot.perception.offline.synthesis.example import examples_of
from toolee_robot.types import Detection, ToolEstimate

pytestmark = pytest.mark.sim(seconds=20)

TIMES = StageTimes(1.0, 1.0, 1.0, whole_image=False)


@pytest.fixture(scope="module")
def examples() -> list[Example]:
    return list(examples_of(DatasetSpec("hard", 12, 9, 1.0), "test", 0, 12))


@pytest.fixture(scope="module")
def folder(examples: list[Example], tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("held")
    (root / "test").mkdir()
    write_scene(root / "test" / "000000", examples)
    return root


@pytest.fixture(scope="module")
def held(folder: Path) -> list[HeldTool]:
    found = list(held_tools(folder))
    assert len(found) >= 2
    return found


def estimates(tool: HeldTool, error: Array, usable: Sequence[bool] = (True,)) -> list[ToolEstimate]:
    """Of each target its true pose with an error in its own frame, so often as `usable` says."""
    made = []
    for instance in tool.instances:
        if instance.target:
            mask = np.zeros(tool.frame.depth.shape, bool)
            detection = Detection(instance.category, 1.0, mask, (0.0, 0.0, 1.0, 1.0))
            X = instance.X_camera_ee @ error
            made += [ToolEstimate(detection, X, np.eye(6), 1.0, use, "ok", trust=0.9) for use in usable]
    return made


def test_the_held_tool_is_in_the_region_and_alone_is_asked_for(held: list[HeldTool]) -> None:
    for tool in held:
        targets = [i for i in tool.instances if i.target]
        assert len({i.tool for i in targets}) == 1
        K, region = tool.frame.intrinsics, tool.hand.region
        assert region is not None
        crop = hand_crop(tool.hand.X_camera_hand, region, K)
        assert crop is not None
        for instance in targets:
            x, y, z = instance.X_camera_ee[:3, 3]
            u, v = K.fx * x / z + K.cx, K.fy * y / z + K.cy
            # A target may be cut by the image's border, its origin beyond it.
            assert crop.x0 <= np.clip(u, 0, K.width - 1) < crop.x1
            assert crop.y0 <= np.clip(v, 0, K.height - 1) < crop.y1


def test_a_tool_that_is_held_the_other_way_round_is_left_out(
    examples: list[Example], held: list[HeldTool], tmp_path: Path
) -> None:
    """Of one frame with two hands about the same tool, half a turn apart, a job asks for one."""
    shown = next(e for e in examples if np.array_equal(e.frame.depth, held[0].frame.depth))
    across = SHOWN_HAND.grasp.R_hand_tool[:, 0]
    X_camera_hand = shown.table.X_camera_hand @ transform(Rotation.from_rotvec(np.pi * across)).astype(np.float32)
    turned = replace(shown, table=replace(shown.table, X_camera_hand=X_camera_hand))
    (tmp_path / "test").mkdir()
    write_scene(tmp_path / "test" / "000000", [turned, shown])
    (found,) = held_tools(tmp_path)
    np.testing.assert_allclose(found.hand.X_camera_hand, held[0].hand.X_camera_hand, atol=1e-5)
    row = int(np.isfinite(shown.table.X_camera_hand[:, 0, 0]).argmax())
    X_hand_tool = inverse(found.hand.X_camera_hand) @ shown.table.X_camera_tool[row]
    assert X_hand_tool[0, 2] > 0, "from the butt to the head is towards the thumb"


def test_an_uncertain_hand_widens_the_region(folder: Path, held: list[HeldTool]) -> None:
    wider = next(held_tools(folder, pose_error=0.02))
    assert wider.hand.region is not None
    assert held[0].hand.region is not None
    assert wider.hand.region.radius == pytest.approx(held[0].hand.region.radius + 0.02)


def test_right_poses_are_found_and_displaced_ones_wrong(held: list[HeldTool]) -> None:
    for tool in held:
        exact = judge(tool, estimates(tool, np.eye(4)), TIMES, 5.0, 4.0)
        assert exact.found == exact.usable_right == exact.targets > 0
        assert exact.wrong == 0
        assert max(mm for mm, _ in exact.errors) < 1e-3
        doubtful = judge(tool, estimates(tool, np.eye(4), (False,)), TIMES, 5.0, 4.0)
        assert (doubtful.found, doubtful.usable_right, doubtful.wrong) == (exact.targets, 0, 0)
        moved = judge(tool, estimates(tool, transform(p=(0.0, 0.0, 0.03))), TIMES, 5.0, 4.0)
        assert (moved.found, moved.usable_right) == (0, 0)
        assert moved.wrong > 0


def test_differences_are_paired() -> None:
    """Two ways that fail in the same frames differ by nothing, and certainly so."""
    base = [Seen(1, int(k % 2), 1, 0, (), 10.0, 10.0, False) for k in range(100)]
    same = compare({"a": base, "b": base}, "a")["b"]
    assert (same["found"], same["found_difference"], same["found_interval"]) == (0.5, 0.0, 0.0)
    worse = [replace(s, found=0) if k < 20 else s for k, s in enumerate(base)]
    row = compare({"a": base, "b": worse}, "a")["b"]
    assert row["found_difference"] == pytest.approx(-0.10)
    assert row["found_interval"] == pytest.approx(1.96 * np.sqrt(0.1 * 0.9 / 100))


def test_the_command_compares_the_whole_image_with_the_crop(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["evaluate", "held", str(folder), "--limit", "1", "--json"]) == 0
    ways = json.loads(capsys.readouterr().out)["ways"]
    assert list(ways) == [WHOLE, ABOUT_HAND]
    assert ways[WHOLE]["whole_image"] == 1.0
    assert all(row["frames"] == 1 and row["median_ms"] > 0 for row in ways.values())
    assert run(["evaluate", "held", str(folder), "--limit", "0"]) == 2

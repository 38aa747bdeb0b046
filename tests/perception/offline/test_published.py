"""The paper's own protocol: its tools, its views, and clouds that lie on the tool."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy.spatial import cKDTree

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import inverse, transform_points
from toolee_robot.perception.offline.published import clouds_of_image, published_scene, scaled, tools
from toolee_robot.tools import TOOL_SPECS, make_tool

KIND, NUMBER, DIAGONAL = tools(held_out=False)[0]


def test_it_has_the_papers_number_of_tools_and_no_seen_one_is_held_out() -> None:
    seen, held_out = tools(held_out=False), tools(held_out=True)
    families = Counter(str(TOOL_SPECS[kind].family) for kind, _, _ in seen)
    assert sorted(families.values()) == [11, 14, 17]
    assert all(Category.HAMMER_GRIP in TOOL_SPECS[kind].end_effectors for kind, _, size in seen if size == 0.3)
    assert not {tool[:2] for tool in seen} & {tool[:2] for tool in held_out}


def test_the_published_views() -> None:
    """The camera looks at the middle of the tool's box but for a shift along the handle; the tool does not turn."""
    tool = scaled(make_tool(KIND, NUMBER), 0.9)
    seen, shifts = [], []
    for index in range(40):
        sample = published_scene(np.random.default_rng(index), tool)
        (placed,) = sample.tools
        np.testing.assert_array_equal(placed.X_world_tool[:3, :3], np.eye(3))
        vertices = np.asarray(placed.tool.mesh.vertices) + placed.X_world_tool[:3, 3]
        middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        axis = sample.X_world_camera[:3, 2]
        target = axis * np.linalg.norm(middle[:2]) / np.linalg.norm(axis[:2])
        np.testing.assert_allclose(target[:2], middle[:2], atol=1e-9)
        shifts.append(middle[2] - target[2])
        seen.append(-target)
        pixels = transform_points(inverse(sample.X_world_camera), vertices)
        pixels = pixels[:, :2] / pixels[:, 2:] * 960.0 + [sample.intrinsics.cx, sample.intrinsics.cy]
        inside = (pixels > 0).all() and (pixels < [sample.intrinsics.width, sample.intrinsics.height]).all()
        assert inside or max(sample.intrinsics.width, sample.intrinsics.height) > 500, "cut by the image's border alone"
    assert np.abs(shifts).max() <= 0.05
    assert np.ptp(shifts) > 0.06
    x, y, z = np.transpose(seen)
    assert {(a > 0, b > 0) for a, b in zip(x, y, strict=True)} == {(a, b) for a in (True, False) for b in (True, False)}
    for beside in (np.abs(x), np.abs(y)):
        assert 0.3 <= beside.min() < 0.35
        assert 0.55 < beside.max() <= 0.6
    assert -0.1 <= z.min() < 0.0
    assert 0.4 < z.max() <= 0.5


@pytest.mark.parametrize("whole", [False, True])
def test_the_points_lie_on_the_tool_at_its_size_in_the_image(whole: bool) -> None:
    clouds = clouds_of_image((1, 0, 0, 3), KIND, NUMBER, DIAGONAL, whole)
    assert [CATEGORIES[i] for i in clouds.category] == [Category.HAMMER_HEAD, Category.HAMMER_GRIP]
    tool = make_tool(KIND, NUMBER)
    X_tool_ee = inverse(clouds.X_camera_tool[0].astype(float)) @ clouds.X_camera_ee[0]
    factor = X_tool_ee[2, 3] / tool.ees[0].X_tool_ee[2, 3]
    diagonal = factor * np.linalg.norm(tool.mesh.extents)
    assert 0.8 * DIAGONAL < diagonal < 1.2 * DIAGONAL
    surface = transform_points(clouds.X_camera_tool[0].astype(float), factor * tool.mesh.sample(200_000, seed=0))
    distance, _ = cKDTree(surface).query(clouds.points)
    assert distance.max() < 0.002, "exact depth, no cleaning"
    again = clouds_of_image((1, 0, 0, 3), KIND, NUMBER, DIAGONAL, whole)
    np.testing.assert_array_equal(again.points, clouds.points)

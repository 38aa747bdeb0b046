"""The exact shape of a tool, fitted to points of its surface."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from toolee_robot.cli.app import run
from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import Array, inverse, rotation_angle, transform, transform_points
from toolee_robot.perception.offline.dataset.scene_writer import write_scene
from toolee_robot.perception.offline.dataset.spec import DatasetSpec
from toolee_robot.perception.offline.evaluation.exact_shape import Fits, Surface, fit_exact_shape, tables
from toolee_robot.perception.offline.synthesis.example import examples_of
from toolee_robot.tools import Tool, ToolKind, make_tool

pytestmark = pytest.mark.sim(seconds=10)

X_TRUE = transform(Rotation.from_rotvec([2.3, 0.4, 0.3]).as_matrix(), [0.02, -0.03, 0.5])
OFF = transform(Rotation.from_rotvec([0.05, -0.03, 0.06]).as_matrix(), [0.003, 0.002, -0.002])


def claw_hammer() -> Tool:
    """A tool without a symmetry: its pose is one."""
    return make_tool(ToolKind.CLAW_HAMMER, 904)


def surface_of(tool: Tool) -> Surface:
    X_ee_tool = inverse(tool.ee(Category.HAMMER_HEAD).X_tool_ee)
    points, normals, _ = tool.sample_surface(20_000, np.random.default_rng(0))
    at = transform_points(X_ee_tool, points)
    return Surface(at, normals @ X_ee_tool[:3, :3].T, KDTree(at))


def seen(tool: Tool, noise: float) -> Array:
    """Points of the surface that face the camera, camera frame."""
    rng = np.random.default_rng(1)
    points, normals, _ = tool.sample_surface(4000, rng)
    X = X_TRUE @ inverse(tool.ee(Category.HAMMER_HEAD).X_tool_ee)
    at = transform_points(X, points)
    visible = at[np.einsum("ij,ij->i", at, normals @ X[:3, :3].T) < 0.0]
    return visible + rng.normal(size=visible.shape) * noise


@pytest.mark.parametrize(("noise", "degrees", "metres"), [(0.0, 0.1, 0.0002), (0.002, 1.0, 0.001)])
def test_a_shape_is_fitted_to_its_own_points(noise: float, degrees: float, metres: float) -> None:
    tool = claw_hammer()
    points = seen(tool, noise)
    X = fit_exact_shape(points, surface_of(tool), X_TRUE @ OFF)
    assert np.rad2deg(rotation_angle(X[:3, :3].T @ X_TRUE[:3, :3])) < degrees
    assert np.linalg.norm(X[:3, 3] - X_TRUE[:3, 3]) < metres


def test_what_another_thing_s_points_say_is_left_out() -> None:
    tool = claw_hammer()
    points = seen(tool, 0.001)
    far = points[: len(points) // 4] + np.array([0.0, 0.0, 0.08])
    X = fit_exact_shape(np.concatenate([points, far]), surface_of(tool), X_TRUE @ OFF)
    assert np.linalg.norm(X[:3, 3] - X_TRUE[:3, 3]) < 0.001
    nothing_near = far + np.array([0.0, 0.0, 1.0])
    assert np.allclose(fit_exact_shape(nothing_near, surface_of(tool), X_TRUE), X_TRUE)


def test_an_end_effector_without_a_cloud_counts_as_missed() -> None:
    head, claw = Category.HAMMER_HEAD, Category.HAMMER_GRIP
    category = np.array([CATEGORIES.index(c) for c in (head, head, head, head, claw)])
    angle, position = np.array([0.01, 0.01, 0.01, np.inf, 0.2]), np.array([0.001, 0.001, 0.001, np.inf, 0.001])
    rows = tables(Fits(category, np.full(5, True), angle, position))["held-out"]
    assert rows[head.value]["instances"] == 4
    assert rows[head.value]["5deg2cm"] == 0.75
    assert rows[claw.value]["5deg2cm"] == 0.0
    assert rows["average"]["5deg2cm"] == pytest.approx(0.375)
    assert rows[head.value]["median_mm"] == pytest.approx(1.0), "of those that have a cloud"
    assert tables(Fits.of([], [])) == {}


def test_the_command_reports_it_beside_the_estimator(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "test").mkdir()
    write_scene(tmp_path / "test" / "000000", examples_of(DatasetSpec("hard", 8, 5, 0.5), "test", 0, 3))
    out = tmp_path / "report"
    arguments = ["--true-masks-only", "--exact-shape", "--json", "--out", str(out)]
    assert run(["evaluate", "pose", str(tmp_path), *arguments]) == 0
    said = capsys.readouterr()
    report = json.loads(said.out.splitlines()[-1])
    found, ours = report["exact_shape"]["held-out"], report["estimators"]["ours"]["truth"]["groups"]["held-out"]
    assert {c: row["instances"] for c, row in found.items()} == {
        c: row["instances"] for c, row in ours["accuracy"].items()
    }
    assert found["average"]["10deg2cm"] > 0.5
    assert "exact shapes fitted from the true pose" in said.err
    assert "exact shapes" in (out / "report.html").read_text()

"""Tools at rest: on a plane in equilibrium, on a support, across another one; how many of each the scenes show."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import ConvexHull, KDTree

from toolee_robot.frames import inverse, is_rigid, transform_points
from toolee_robot.perception.offline.synthesis.bench import across, leaning, lying, standing
from toolee_robot.perception.offline.synthesis.hard import hard_scene
from toolee_robot.perception.offline.synthesis.placement import Pool, Stance
from toolee_robot.tools import Family, Tool, ToolKind, kinds_of, make_tool

POINT = np.array([0.3, -0.2, -0.45])
AHEAD = np.array([0.8, 0.1, -0.5])
Pose = Callable[[Tool, np.ndarray, np.random.Generator], np.ndarray | None]
ON_SURFACE = {Stance.LYING, Stance.STANDING, Stance.LEANING, Stance.STACKED}
SCENES = 60


def tools() -> list[Tool]:
    return [make_tool(kind, seed) for kind in ToolKind for seed in (0, 3)]


def placed(tool: Tool, X: np.ndarray) -> np.ndarray:
    """Vertices of a tool at a pose; its lowest point is on the plane, and the pose is one."""
    assert is_rigid(X)
    vertices = transform_points(X, np.asarray(tool.mesh.vertices))
    assert 0.0 < vertices[:, 2].min() - POINT[2] < 1e-3
    return vertices


@pytest.mark.parametrize("pose", [lying, standing])
def test_a_tool_that_lies_or_stands_is_in_equilibrium(pose: Pose) -> None:
    """Its true centre of mass is above what touches the plane, but for 1 mm: scenes guess it from the surface."""
    rng = np.random.default_rng(0)
    stood = 0
    for tool in tools():
        X = pose(tool, POINT, rng)
        if X is None:
            continue
        vertices = placed(tool, X)
        foot = vertices[vertices[:, 2] < vertices[:, 2].min() + 3e-4][:, :2]
        centre = (X[:3, :3] @ tool.center_of_mass + X[:3, 3])[:2]
        assert len(foot) > 2, tool.name
        outside = (ConvexHull(foot, qhull_options="QJ").equations @ [*centre, 1.0]).max()
        assert outside < 1e-3, tool.name
        assert bool(abs(X[2, 2]) < 0.75) is (pose is lying), "the handle is upright if the tool stands"
        stood += pose is standing
    assert pose is lying or stood >= 15, "most kinds can stand"


def test_every_hammer_and_screwdriver_stands() -> None:
    rng = np.random.default_rng(1)
    for family in (Family.HAMMERS, Family.SCREWDRIVERS):
        for kind in kinds_of(family):
            ends = set()
            for seed in range(6):
                X = standing(make_tool(kind, seed), POINT, rng)
                assert X is not None
                ends.add(bool(X[2, 2] > 0))
            assert family is not Family.SCREWDRIVERS or kind is ToolKind.NUT_DRIVER or ends == {True}, "never on a tip"


def test_a_tool_that_leans_touches_the_plane_and_its_support() -> None:
    rng = np.random.default_rng(2)
    tilts = []
    for tool in tools():
        X, support = leaning(tool, POINT, AHEAD, rng)
        vertices = placed(tool, X)
        tilts.append(np.rad2deg(np.arcsin(abs(X[2, 2]))))
        mesh = tool.mesh.copy()
        mesh.apply_transform(inverse(support.X_world_box) @ X)
        half = support.size / 2
        reach = mesh.vertices[mesh.vertices[:, 2] < half[2], 0].max()
        section = mesh.section(plane_origin=[0.0, 0.0, half[2]], plane_normal=[0.0, 0.0, 1.0])
        if section is not None:
            reach = max(reach, section.vertices[:, 0].max())
        assert 0.0 < -half[0] - reach < 1e-3, tool.name
        assert -1e-9 < support.X_world_box[2, 3] - half[2] - POINT[2] < 1e-3, "the support stands on the plane"
        assert vertices[:, 2].max() > POINT[2] + 0.01
    assert min(tilts) < 35.0
    assert max(tilts) > 60.0


@pytest.mark.nightly
def test_a_tool_across_another_one_touches_it_and_the_plane() -> None:
    rng = np.random.default_rng(3)
    found = 0
    for tool in tools():
        lower = make_tool(ToolKind.CLUB_HAMMER, 1)
        X_lower = lying(lower, POINT, rng)
        below = transform_points(X_lower, lower.sample_surface(6000, rng)[0])
        X = across(tool, below, float(POINT[2]), rng)
        if X is None:
            continue
        placed(tool, X)
        distances = KDTree(below).query(transform_points(X, tool.sample_surface(6000, rng)[0]))[0]
        assert 0.0 < distances.min() < 6e-3, tool.name
        found += 1
    assert found > 10


@pytest.mark.nightly
@pytest.mark.sim
def test_scenes_show_held_lying_standing_leaning_and_stacked_tools() -> None:
    pool = Pool.random(np.random.default_rng(4), "train")
    stances: Counter[Stance] = Counter()
    for index in range(SCENES):
        sample = hard_scene(np.random.default_rng([5, index]), pool)
        again = hard_scene(np.random.default_rng([5, index]), pool)
        assert [t.body_id for t in sample.tools] == list(range(1, len(sample.tools) + 1))
        heights = []
        for one, other in zip(sample.tools, again.tools, strict=True):
            np.testing.assert_array_equal(one.X_world_tool, other.X_world_tool)
            assert (one.X_world_hand is not None) is (one.stance is Stance.HELD)
            stances[one.stance] += 1
            lowest = transform_points(one.X_world_tool, np.asarray(one.tool.mesh.vertices))[:, 2].min()
            heights.append((lowest, one.stance in ON_SURFACE))
        table = [z for z, rests in heights if rests]
        if table:
            assert np.ptp(table) < 1e-3, "all stand on one table"
            assert min(z for z, _ in heights) > min(table) - 1e-3, "none is below it"
    total = sum(stances.values())
    assert stances[Stance.HELD] / total > 0.25
    assert sum(stances[s] for s in ON_SURFACE) / total > 0.25
    for stance, least in ((Stance.LYING, 0.1), (Stance.STANDING, 0.02), (Stance.LEANING, 0.02), (Stance.STACKED, 0.01)):
        assert stances[stance] / total > least, stance

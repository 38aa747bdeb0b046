"""EE frames against the meshes themselves: what ARCHITECTURE's definitions say must hold for rays and vertices."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tests.tools.rays import cast, first
from toolee_robot.end_effectors import Category
from toolee_robot.frames import Array, inverse, is_rigid, transform_points
from toolee_robot.tools import EndEffector, Family, Tool, ToolKind, kinds_of, make_tool

SEEDS, EVERY_RUN = range(6), 2
"""Of a kind, and how many of them are looked at in every run."""
TOOTHED = (ToolKind.MEAT_TENDERISER,)
"""Kinds whose striking faces may have teeth."""
SIDEWAYS = (ToolKind.PIPE_WRENCH, ToolKind.MONKEY_WRENCH)
"""Wrenches whose jaws are at right angles to the handle."""


def seeds(kind: ToolKind, *rest: object, name: str = "") -> list[object]:
    """A case of a kind for each seed: the tool is made when its test runs."""
    return [
        pytest.param(
            (kind, seed), *rest, id=f"{kind}-{seed:04d}{name}", marks=() if seed < EVERY_RUN else pytest.mark.nightly
        )
        for seed in SEEDS
    ]


def of(category: Category, family: Family, *, leave_out: tuple[ToolKind, ...] = ()) -> pytest.MarkDecorator:
    """A family's end effectors of a category."""
    cases = [
        case
        for kind in kinds_of(family)
        if kind not in leave_out
        for i, ee in enumerate(make_tool(kind, 0).ees)
        if ee.category is category
        for case in seeds(kind, i, name=f"-{i}")
    ]
    return pytest.mark.parametrize(("tool", "ee"), cases, indirect=True)


@pytest.fixture
def tool(request: pytest.FixtureRequest) -> Tool:
    return make_tool(*request.param)


@pytest.fixture
def ee(request: pytest.FixtureRequest, tool: Tool) -> EndEffector:
    return tool.ees[request.param % len(tool.ees)]  # an open-end wrench has one end or two


def axes(ee: EndEffector) -> tuple[Array, Array, Array, Array]:
    """x, y, z, p of the EE in the tool frame, each (3,)."""
    X = ee.X_tool_ee
    assert is_rigid(X)
    return X[:3, 0], X[:3, 1], X[:3, 2], X[:3, 3]


@of(Category.HAMMER_HEAD, Family.HAMMERS, leave_out=TOOTHED)
def test_hammer_face(tool: Tool, ee: EndEffector) -> None:
    x, _, z, p = axes(ee)
    # Just above the face: steel right behind, free space in front.
    assert first(tool.mesh, p + 1e-3 * z, -z) == pytest.approx(1e-3, abs=1e-5)
    assert first(tool.mesh, p + 1e-3 * z, z) == np.inf
    # The face is a flat disc or polygon in the plane z = 0, centred on the origin, the foremost thing of the tool.
    local = transform_points(inverse(ee.X_tool_ee), tool.mesh.vertices.view(np.ndarray))
    rim = local[np.abs(local[:, 2]) < 1e-6]
    assert local[:, 2].max() < 1e-6
    assert len(rim) >= 16
    np.testing.assert_allclose(rim[:, :2].max(0) + rim[:, :2].min(0), 0.0, atol=1e-5)
    assert 0.016 <= np.ptp(rim[:, 0]) <= 0.075
    _, normals = cast(tool.mesh, p + 1e-3 * z + 0.3 * rim[:, 0].max() * x, -z)
    assert normals[0] @ z > 1 - 1e-6
    # x points to the butt, in the plane of handle and face.
    butt = np.array([0.0, 0.0, tool.handle.z_min]) - p
    assert x @ butt > 0.1
    assert abs(np.cross(z, x)[1]) == pytest.approx(1.0, abs=1e-6)
    # The collision shape has the same face.
    corners = np.concatenate([part.vertices for part in tool.collision_parts()])
    heights = transform_points(inverse(ee.X_tool_ee), corners)[:, 2]
    assert abs(heights.max()) < 2e-6


@of(Category.HAMMER_GRIP, Family.HAMMERS)
def test_claw(tool: Tool, ee: EndEffector) -> None:
    x, y, z, p = axes(ee)
    # The slot: free across the plate, a tine on either side at the same distance, steel behind the slot's end.
    assert first(tool.mesh, p, z) == np.inf
    assert first(tool.mesh, p, x) > 0.01
    left, right = first(tool.mesh, p, y), first(tool.mesh, p, -y)
    assert left == pytest.approx(right, abs=1e-4)
    assert 0.001 < left < 0.009
    # Half of the tines' thickness: seen from inside a tine, both its skins are equally far.
    for side in (1.0, -1.0):
        inside = p + side * (left + 0.0015) * y
        assert first(tool.mesh, inside, z) == pytest.approx(first(tool.mesh, inside, -z), abs=4e-4)
    # Half of the slot's length: as far to the slot's end as to the tips, but for the curvature's change on the way.
    claw = next(part.mesh for part in tool.parts if part.label == "claw")
    local = transform_points(inverse(ee.X_tool_ee), claw.vertices.view(np.ndarray))
    tips = local[local[:, 0] > local[:, 0].max() - 0.002]
    wall = []
    for angle in np.linspace(-1.2, 1.2, 97):
        direction = -np.cos(angle) * x + np.sin(angle) * z
        distances, normals = cast(claw, p, direction)
        if len(distances) and normals[0] @ x > 0.4:
            wall.append(distances[0] * np.array([-np.cos(angle), np.sin(angle)]))
    near = np.array(wall)[np.linalg.norm(wall, axis=1) < 1.35 * np.min(np.linalg.norm(wall, axis=1))]
    root = 0.5 * (near.min(0) + near.max(0))
    to_tips = np.linalg.norm(tips[:, [0, 2]].mean(0))
    assert np.linalg.norm(root) == pytest.approx(to_tips, rel=0.12)
    # x leaves the face behind, z looks away from the butt.
    face = tool.ee(Category.HAMMER_HEAD).X_tool_ee
    assert (p - face[:3, 3]) @ x > 0.02
    assert z @ (p - [0.0, 0.0, tool.handle.z_min]) > 0
    assert abs(y[1]) == pytest.approx(1.0, abs=1e-6)


@of(Category.SCREWDRIVER_HEAD, Family.SCREWDRIVERS)
def test_screwdriver_tip(tool: Tool, ee: EndEffector) -> None:
    _, _, z, p = axes(ee)
    vertices = tool.mesh.vertices.view(np.ndarray)
    np.testing.assert_allclose(z, [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(p[:2], 0.0, atol=1e-12)
    assert vertices[:, 2].max() == pytest.approx(p[2], abs=1e-6)
    depth = first(tool.mesh, p + 1e-3 * z, -z) - 1e-3
    if tool.kind is ToolKind.NUT_DRIVER:
        assert depth > 0.005, "no hole in the nut driver's mouth"
    else:
        assert depth == pytest.approx(0.0, abs=1e-6)
    assert p[2] - tool.handle.z_max >= (0.15 if tool.kind.startswith("long_") else 0.055) - 1e-9


@of(Category.WRENCH_HEAD, Family.WRENCHES)
def test_wrench_jaw(tool: Tool, ee: EndEffector) -> None:
    x, y, z, p = axes(ee)
    turns = [np.cos(a) * x + np.sin(a) * y for a in np.arange(12) * np.pi / 6]
    around = np.array([first(tool.mesh, p, d) for d in turns])
    if np.all(around < 0.03):  # a ring or a socket: six or twelve corners about its centre
        np.testing.assert_allclose(around[::2], around[0], atol=1e-4)
        np.testing.assert_allclose(around[1::2], around[1], atol=1e-4)
    elif tool.kind not in SIDEWAYS:
        _check_flats(tool.mesh, ee)
    # The nut's axis is free, at least to one side (a socket has a floor).
    assert np.inf in (first(tool.mesh, p, z), first(tool.mesh, p, -z))
    # x points to the far end of the handle.
    z_tool = tool.mesh.vertices.view(np.ndarray)[:, 2]
    far_end = z_tool.min() if p[2] > 0 else z_tool.max()
    to_end = transform_points(inverse(ee.X_tool_ee), np.array([[0.0, 0.0, far_end]]))[0]
    assert to_end[0] > 0.08
    assert abs(to_end[1]) < 2e-3


def _check_flats(mesh: trimesh.Trimesh, ee: EndEffector) -> None:
    """Across the flats it is narrowest, nearly along y (heads turn by at most 22.5 degrees), and as far to either."""
    x, y, _, p = axes(ee)
    angles = np.deg2rad(np.linspace(-30.0, 30.0, 241))
    across = [np.cos(a) * y + np.sin(a) * x for a in angles]
    widths = [first(mesh, p, d) + first(mesh, p, -d) for d in across]
    flat = across[int(np.argmin(widths))]
    left, right = first(mesh, p, flat), first(mesh, p, -flat)
    assert left == pytest.approx(right, abs=1.5e-4)
    assert 0.002 <= left <= 0.020
    for side in (flat, -flat):
        assert abs(cast(mesh, p, side)[1][0] @ flat) > np.cos(np.deg2rad(0.3))

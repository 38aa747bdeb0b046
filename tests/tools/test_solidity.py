"""Meshes, masses, grips and collision pieces of all kinds."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from tests.tools.rays import cast
from toolee_robot.tools import TOOL_SPECS, Family, Tool, ToolKind, make_tool

TOOLS = [pytest.param(kind, seed, id=f"{kind}-{seed}") for kind in ToolKind for seed in range(4)]

MASSES = {
    ToolKind.WOODEN_MALLET: (0.07, 0.7),
    ToolKind.MEAT_TENDERISER: (0.1, 1.3),
    ToolKind.SLEDGE_HAMMER: (1.2, 5.8),
    ToolKind.PIPE_WRENCH: (0.25, 2.5),
    ToolKind.MONKEY_WRENCH: (0.2, 2.8),
}
"""Range of the mass [kg] of kinds that are not as heavy as the others of their family."""


@pytest.fixture
def tool(request: pytest.FixtureRequest) -> Tool:
    return make_tool(*request.param)


every_tool = pytest.mark.parametrize(
    "tool", [param.values for param in TOOLS], indirect=True, ids=[p.id for p in TOOLS]
)


@every_tool
def test_meshes_are_closed_and_parts_fill_the_tool_without_overlap(tool: Tool) -> None:
    for mesh in (tool.mesh, *(part.mesh for part in tool.parts)):
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 0
    assert sum(part.mesh.volume for part in tool.parts) == pytest.approx(tool.mesh.volume, rel=1e-4)
    assert len(tool.mesh.split(only_watertight=False)) == 1, "something floats"
    assert tool.face_parts.shape == (len(tool.mesh.faces),)
    assert tool.face_parts.max() < len(tool.parts)


@every_tool
def test_mass_properties_are_physical(tool: Tool) -> None:
    family = (0.3, 1.5) if TOOL_SPECS[tool.kind].family is Family.HAMMERS else (0.02, 1.2)
    low, high = MASSES.get(tool.kind, family)
    assert low <= tool.mass <= high
    np.testing.assert_allclose(tool.inertia, tool.inertia.T, atol=1e-12)
    a, b, c = np.linalg.eigvalsh(tool.inertia)
    assert a > 0
    assert a + b > c
    low_corner, high_corner = tool.mesh.bounds
    assert np.all((tool.center_of_mass > low_corner) & (tool.center_of_mass < high_corner))


def test_mass_properties_agree_with_trimesh() -> None:
    tool = make_tool(ToolKind.CLAW_HAMMER, 0)
    mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    for part in tool.parts:
        part_mesh = part.mesh.copy()
        part_mesh.density = part.density
        mass += part_mesh.mass
        moment += part_mesh.mass * part_mesh.center_mass
        d = part_mesh.center_mass - tool.center_of_mass
        inertia += part_mesh.moment_inertia + part_mesh.mass * (d @ d * np.eye(3) - np.outer(d, d))
    assert tool.mass == pytest.approx(mass, rel=1e-9)
    np.testing.assert_allclose(tool.center_of_mass, moment / mass, atol=1e-9)
    np.testing.assert_allclose(tool.inertia, inertia, atol=1e-10)


@every_tool
def test_handle_is_where_and_as_thick_as_it_says(tool: Tool) -> None:
    handle = tool.handle
    assert handle.z_min < -0.03 < 0.03 < handle.z_max
    assert np.all(np.diff(handle.z) > 0)
    for z in np.linspace(-0.025, 0.025, 5):
        cut = tool.mesh.section(plane_origin=[0.0, 0.0, z], plane_normal=[0.0, 0.0, 1.0])
        assert cut is not None
        width = np.ptp(np.asarray(cut.vertices), axis=0)[:2] / 2
        np.testing.assert_allclose(width, handle.radii_at(z), atol=1.5e-3)


@every_tool
def test_surface_samples_lie_on_the_tool_with_outward_normals(tool: Tool) -> None:
    points, normals, parts = tool.sample_surface(40, np.random.default_rng(0))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-9)
    assert set(parts) <= set(range(len(tool.parts)))
    for point, normal in zip(points[:8], normals[:8], strict=True):
        # An even number of walls outside, an odd number inside.
        assert len(cast(tool.mesh, point + 1e-7 * normal, normal)[0]) % 2 == 0
    again, _, _ = tool.sample_surface(40, np.random.default_rng(0))
    np.testing.assert_array_equal(points, again)


@every_tool
def test_collision_pieces_are_convex_and_hug_the_tool(tool: Tool) -> None:
    pieces = tool.collision_parts()
    assert 1 <= len(pieces) <= 32
    for piece in pieces:
        assert piece.is_watertight
        assert piece.volume == pytest.approx(ConvexHull(piece.vertices).volume, rel=1e-3)
    points, _, _ = tool.sample_surface(400, np.random.default_rng(1))
    outside = np.min([_above(piece, points) for piece in pieces], axis=0)
    assert outside.max() < 0.003, "the tool sticks out of its collision shape"
    probes = np.concatenate([piece.vertices for piece in pieces])
    assert np.all(probes >= tool.mesh.bounds[0] - 1e-3)
    assert np.all(probes <= tool.mesh.bounds[1] + 1e-3)


def _above(piece: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """How far the points (N, 3) lie above a convex mesh's highest plane [m]; negative inside."""
    equations = ConvexHull(piece.vertices).equations
    return np.max(points @ equations[:, :3].T + equations[:, 3], axis=1)

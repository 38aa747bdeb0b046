"""Determinism, variety and the split."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from tests.errors import raises
from tests.examples import seldom
from tests.tools.rays import cast
from toolee_robot.end_effectors import Category
from toolee_robot.errors import UserError
from toolee_robot.tools import (
    NAIL_DRIVERS,
    TOOL_SPECS,
    Family,
    Tool,
    ToolKind,
    kinds_of,
    make_tool,
    split,
    test_seeds,
    train_seeds,
)

MASSES = {
    ToolKind.CLAW_HAMMER: 0.537,
    ToolKind.BALL_PEEN_HAMMER: 0.4993,
    ToolKind.CROSS_PEEN_HAMMER: 0.8324,
    ToolKind.CLUB_HAMMER: 0.4649,
    ToolKind.MALLET: 0.31,
    ToolKind.SLOTTED_SCREWDRIVER: 0.2032,
    ToolKind.PHILLIPS_SCREWDRIVER: 0.05472,
    ToolKind.NUT_DRIVER: 0.1698,
    ToolKind.OPEN_END_WRENCH: 0.0473,
    ToolKind.COMBINATION_WRENCH: 0.2496,
    ToolKind.ADJUSTABLE_WRENCH: 0.3915,
    ToolKind.BOX_WRENCH: 0.2519,
    ToolKind.SOCKET_WRENCH: 0.5733,
    ToolKind.HANGING_CLAW_HAMMER: 0.4095,
    ToolKind.WOODEN_MALLET: 0.1256,
    ToolKind.MEAT_TENDERISER: 0.1756,
    ToolKind.SLEDGE_HAMMER: 4.61,
    ToolKind.LONG_SLOTTED_SCREWDRIVER: 0.04216,
    ToolKind.LONG_PHILLIPS_SCREWDRIVER: 0.05246,
    ToolKind.PIPE_WRENCH: 1.093,
    ToolKind.MONKEY_WRENCH: 2.427,
    ToolKind.EYE_ADJUSTABLE_WRENCH: 0.4713,
}
"""Mass [kg] of the tool of seed 9 of every kind."""


@pytest.mark.parametrize("kind", list(ToolKind))
def test_a_seed_always_gives_the_same_tool(kind: ToolKind) -> None:
    once, again = make_tool.__wrapped__(kind, 3), make_tool.__wrapped__(kind, 3)
    np.testing.assert_array_equal(once.mesh.vertices, again.mesh.vertices)
    np.testing.assert_array_equal(once.mesh.faces, again.mesh.faces)
    assert once.mass == again.mass
    assert [part.material for part in once.parts] == [part.material for part in again.parts]


@pytest.mark.parametrize("kind", seldom(*ToolKind))
def test_every_seed_gives_another_shape(kind: ToolKind) -> None:
    shapes = np.array(
        [[*tool.mesh.extents, *tool.ees[0].X_tool_ee[:3, 3]] for tool in (make_tool(kind, s) for s in range(16))]
    )
    gaps = np.abs(shapes[:, None] - shapes[None]).max(-1) + np.eye(len(shapes))
    assert gaps.min() > 5e-4, "two seeds give nearly the same tool"


def test_split_holds_out_a_fifth_and_never_mixes() -> None:
    assert sum(split(s) == "test" for s in range(1000)) == 200
    assert len(set(train_seeds(80)) | set(test_seeds(20))) == 100
    assert all(split(s) == "train" for s in train_seeds(80))
    assert all(split(s) == "test" for s in test_seeds(20))


def test_every_kind_has_a_record_and_makes_tools_with_its_end_effectors() -> None:
    assert set(TOOL_SPECS) == set(ToolKind)
    # 13 to 99 are left to custom tools: their numbers in data sets follow the first 13 kinds.
    later = range(100, 100 + len(TOOL_SPECS) - 13)
    assert [spec.number for spec in TOOL_SPECS.values()] == [*range(13), *later]
    for kind, spec in TOOL_SPECS.items():
        for seed in range(3):
            assert make_tool(kind, seed).categories == spec.end_effectors


@pytest.mark.parametrize("family", list(Family))
def test_the_first_kinds_of_a_family_make_two_thirds_of_its_draws(family: Family) -> None:
    specs = [TOOL_SPECS[kind] for kind in kinds_of(family)]
    first = sum(spec.draw_weight for spec in specs if spec.number < 13)
    assert first / sum(spec.draw_weight for spec in specs) == pytest.approx(2 / 3, abs=0.01)


def test_jobs_and_doctor_draw_from_the_same_hammers_as_ever() -> None:
    assert [str(kind) for kind in NAIL_DRIVERS] == [
        "claw_hammer", "ball_peen_hammer", "cross_peen_hammer", "club_hammer",
    ]  # fmt: skip


@pytest.mark.parametrize(("kind", "mass"), MASSES.items())
def test_a_tool_of_a_seed_stays_what_it_is(kind: ToolKind, mass: float) -> None:
    assert make_tool(kind, 9).mass == pytest.approx(mass, rel=1e-3)


def test_wrong_requests_are_named() -> None:
    with raises(UserError, code="user.seed_negative"):
        make_tool(ToolKind.MALLET, -1)
    with raises(UserError, says=" has no "):
        make_tool(ToolKind.MALLET, 0).ee(Category.WRENCH_HEAD)


TOOLS = [pytest.param(kind, seed, id=f"{kind}-{seed}") for kind in ToolKind for seed in range(4)]
MASSES_SOLIDITY = {
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
    low, high = MASSES_SOLIDITY.get(tool.kind, family)
    assert low <= tool.mass <= high
    np.testing.assert_allclose(tool.inertia, tool.inertia.T, atol=1e-12)
    a, b, c = np.linalg.eigvalsh(tool.inertia)
    assert a > 0
    assert a + b > c
    low_corner, high_corner = tool.mesh.bounds
    assert np.all((tool.center_of_mass > low_corner) & (tool.center_of_mass < high_corner))


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

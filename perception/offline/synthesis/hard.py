"""Hard scenes: random orientations, surroundings, hands and occluders; also scenes without tools."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import (
    Array,
    frame_from_axes,
    inverse,
    random_rotation,
    transform,
    transform_points,
)
from toolee_robot.perception.offline.dataset.records import FARTHEST, NEAREST
from toolee_robot.perception.offline.synthesis.bench import Bench
from toolee_robot.perception.offline.synthesis.bodies import (
    HandStyle,
    X_base_hand_of,
    X_hand_tool_of,
    arm_bodies,
    hand_bodies,
    tool_bodies,
)
from toolee_robot.perception.offline.synthesis.clutter import Surfaces, any_object, backdrop, corners_of, walls
from toolee_robot.perception.offline.synthesis.placement import (
    PlacedTool,
    Pool,
    SceneSample,
    Stance,
    X_world_hand_of,
    look,
    random_intrinsics,
    random_pixel,
    tool_in_view,
)
from toolee_robot.render import Body, Scene
from toolee_robot.render.lab import environment, lamps, uneven_light
from toolee_robot.render.mesh import box, cylinder
from toolee_robot.tools import ToolShape
from toolee_robot.types import CameraIntrinsics

ROOM, HAND, ARM, OBJECT = 100, 101, 102, 103
"""Body ids of everything except tools."""
_BENCH_SHARE, _UNEVEN_SHARE = 0.3, 0.3
"""Shares of the scenes with a bench seen from above, and with light of a high range."""
_SAMPLES = 1500
"""Points on the surface of a held tool."""
_R_ROD = Rotation.from_euler("x", np.pi / 2).as_matrix()
"""Rotation from z to y, for rods that are modelled along z."""


def hard_scene(rng: np.random.Generator, pool: Pool, with_tools: bool = True) -> SceneSample:
    """Generate a hard scene: up to three tools in clutter, the first one mostly in a hand, or a bench seen from above.

    Args:
        rng: Random generator.
        pool: Tools, grasps and surfaces.
        with_tools: Whether to include tools; without them, the scene still contains hands.

    Returns:
        The scene, with the camera.
    """
    bench_view = with_tools and rng.random() < _BENCH_SHARE
    view = _View.random(rng, bench_view)
    bodies, placed, resting = _tools(rng, pool, view, bench_view) if with_tools else ([], [], [])
    hands = [corners_of([body]) for body in bodies]
    shown = hands + [transform_points(t.X_world_tool, np.asarray(t.tool.mesh.vertices)) for t in placed]
    lowest = min((float(points[:, 2].min()) for points in shown), default=np.inf) - 0.002
    if not with_tools and rng.random() < 0.6:
        bodies += _empty_hand(rng, pool, view)
    table = _table_height(rng, bench_view, bool(resting), lowest, view.pitch)
    bench = None if table is None else _bench(rng, pool, view, table, hands, placed)
    bench = _rest(rng, view, bench, resting, placed)
    for item in placed:
        bodies += tool_bodies(item.tool, item.X_world_tool, item.body_id, rng)
    bodies += _objects(rng, pool.surfaces, view, bench)
    if bench is not None:
        if resting and rng.random() < 0.6:
            bench.add_small_parts(rng, int(rng.poisson(7.0)))
        bodies += [bench.top(rng, ROOM), *bench.bodies]
    bodies += _occluders(rng, pool.surfaces, view.X_world_camera, placed)
    ground = min(lowest, 0.0) if bench is None else bench.height
    scene = _surrounded(rng, pool.surfaces, bodies, ground)
    return SceneSample(scene, view.intrinsics, view.X_world_camera, tuple(placed), 0 if with_tools else 2)


def _bench(
    rng: np.random.Generator, pool: Pool, view: _View, height: float, hands: list[Array], placed: list[PlacedTool]
) -> Bench:
    """A table that keeps away from hands and placed tools."""
    taken = [points[::4] for points in hands]
    taken += [transform_points(t.X_world_tool, t.tool.sample_surface(_SAMPLES, rng)[0]) for t in placed]
    return Bench(height, view.intrinsics, view.X_world_camera, pool.surfaces, taken, OBJECT)


def _surrounded(rng: np.random.Generator, surfaces: Surfaces, bodies: list[Body], ground: float) -> Scene:
    """The scene with a room whose floor is under the ground [m], or a backdrop, and with light."""
    background = None
    if rng.random() < 0.85:
        bodies = bodies + walls(rng, surfaces, ROOM, ground - float(rng.uniform(0.3, 1.2)))
    else:
        background = backdrop(rng, surfaces)
    lights, ambient = uneven_light(rng) if rng.random() < _UNEVEN_SHARE else (lamps(rng), environment(rng))
    return Scene(bodies, lights, ambient, background)


@dataclass(frozen=True)
class _View:
    """The camera: its intrinsics, its pose in the world, and its pitch [rad]."""

    intrinsics: CameraIntrinsics
    X_world_camera: Array
    pitch: float

    @staticmethod
    def random(rng: np.random.Generator, bench_view: bool) -> _View:
        """At the origin of a world with z up; the table is placed so that it does not intersect held tools."""
        intrinsics = random_intrinsics(rng)
        pitch = np.deg2rad(rng.uniform(-85.0, -20.0 if bench_view else 30.0))
        roll = rng.normal(0.0, 0.15) if rng.random() < 0.5 else rng.uniform(-np.pi, np.pi)
        way = np.array([np.cos(pitch), 0.0, np.sin(pitch)])
        return _View(intrinsics, look(np.zeros(3), way, roll), pitch)

    def tool(self, tool: ToolShape, rng: np.random.Generator) -> Array:
        """X_world_tool of a tool anywhere in view."""
        return self.X_world_camera @ tool_in_view(tool, self.intrinsics, rng)


def _tools(
    rng: np.random.Generator, pool: Pool, view: _View, bench_view: bool
) -> tuple[list[Body], list[PlacedTool], list[ToolShape]]:
    """The hands of the tools that are held, the tools in the air, and those that are to rest on the table."""
    count = int(rng.choice([1, 2, 3], p=[0.2, 0.3, 0.5] if bench_view else [0.5, 0.3, 0.2]))
    hands: list[Body] = []
    placed: list[PlacedTool] = []
    resting: list[ToolShape] = []
    for k in range(count):
        tool = pool.tool(rng)
        if rng.random() < (0.85 if bench_view else 0.12 if k == 0 else 0.5):
            resting.append(tool)
            continue
        X_world_tool = view.tool(tool, rng)
        if any(np.linalg.norm(X_world_tool[:3, 3] - other.X_world_tool[:3, 3]) < 0.12 for other in placed):
            continue
        if rng.random() < (0.8 if k == 0 else 0.6):
            item, hand = _held(rng, pool, tool, X_world_tool, len(placed) + 1)
            hands += hand
            placed.append(item)
        else:
            placed.append(PlacedTool(tool, X_world_tool, None, False, len(placed) + 1, Stance.FLOATING))
    return hands, placed, resting


def _empty_hand(rng: np.random.Generator, pool: Pool, view: _View) -> list[Body]:
    grasp = pool.any_grasp(rng)
    R = random_rotation(rng)
    p = view.intrinsics.rays(random_pixel(rng)) * rng.uniform(NEAREST, FARTHEST)
    X = view.X_world_camera @ transform(R, p)
    return hand_bodies(grasp, HandStyle.varied(rng), X, HAND)


def _table_height(
    rng: np.random.Generator, bench_view: bool, needed: bool, lowest: float, pitch: float
) -> float | None:
    """Height of the table's top under what is held, whose lowest point is given [m]; None without a table."""
    if bench_view:
        return min(float(rng.uniform(0.45, 1.0) * np.sin(pitch)), lowest)
    if not needed and rng.random() >= 0.7:
        return None
    drop = rng.uniform(0.0, 0.1) if rng.random() < 0.4 else rng.uniform(0.1, 0.6)
    return float(min(lowest if np.isfinite(lowest) else -0.3, -0.2) - drop)


def _rest(
    rng: np.random.Generator, view: _View, bench: Bench | None, resting: list[ToolShape], placed: list[PlacedTool]
) -> Bench | None:
    """Place the tools that are to rest; returns the bench, None if a tool must be shown that finds no place on it."""
    for tool in resting:
        there = None if bench is None else bench.place(tool, rng)
        if there is None and placed:
            continue
        if there is None:
            bench = None  # the camera does not see it: without it the tool may be anywhere
        X, stance = there or (view.tool(tool, rng), Stance.FLOATING)
        placed.append(PlacedTool(tool, X, None, False, len(placed) + 1, stance))
    return bench


def _held(
    rng: np.random.Generator, pool: Pool, tool: ToolShape, X_world_tool: Array, body_id: int
) -> tuple[PlacedTool, list[Body]]:
    """A hand around the handle, rarely with the arm."""
    grasp = pool.grasp(tool, rng)
    style = HandStyle.varied(rng)
    along = transform(p=(0.0, 0.0, rng.uniform(-0.03, 0.04)))
    X_world_hand = X_world_hand_of(X_world_tool @ along, X_hand_tool_of(grasp, style.mirrored))
    bodies = hand_bodies(grasp, style, X_world_hand, HAND, forearm=rng.random() < 0.85)
    if not style.mirrored and rng.random() < 0.3:
        q = rng.uniform([-3.0, -2.5, -2.4, -3.0, -3.0, -3.0], [3.0, -0.5, 2.4, 3.0, 3.0, 3.0])
        X_base_hand = X_base_hand_of(q, grasp.q_hand)
        bodies += arm_bodies(q, X_world_hand @ inverse(X_base_hand), ARM, rng)
    return PlacedTool(tool, X_world_tool, X_world_hand, style.mirrored, body_id, Stance.HELD), bodies


def _objects(rng: np.random.Generator, surfaces: Surfaces, view: _View, bench: Bench | None) -> list[Body]:
    """Put random objects on the bench, and return those in the air."""
    bodies: list[Body] = []
    for _ in range(rng.poisson(12.0 if rng.random() < 0.35 else 3.5)):
        size = float(np.exp(rng.uniform(np.log(0.03), np.log(0.35))))
        if bench is not None and rng.random() < 0.85 and bench.add_object(rng, size):
            continue
        p = view.X_world_camera[:3, :3] @ view.intrinsics.rays(random_pixel(rng, -0.1)) * rng.uniform(0.7, 2.2)
        X = transform(random_rotation(rng), p)
        bodies += any_object(rng, surfaces, X, OBJECT, size)
    return bodies


def _occluders(
    rng: np.random.Generator, surfaces: Surfaces, X_world_camera: Array, placed: list[PlacedTool]
) -> list[Body]:
    """Occluders in front of most EEs of most scenes; each hides 0 to about 70 % of an EE."""
    bodies: list[Body] = []
    if rng.random() < 0.15:
        return bodies
    for item, ee in [(tool, ee) for tool in placed for ee in tool.tool.ees]:
        if rng.random() < 0.4:
            continue
        sight = (item.X_world_tool @ ee.X_tool_ee)[:3, 3] - X_world_camera[:3, 3]
        share = rng.uniform(0.45, 0.93)
        reach = share * ee.category.spec.radius  # of the EE, projected to the distance of the occluder
        R = frame_from_axes(z=sight, x=np.cross(sight, rng.normal(size=3)), p=np.zeros(3))[:3, :3]
        if rng.random() < 0.3:
            p = R[:, 0] * rng.uniform(0.2, 1.3) * reach
            X = transform(random_rotation(rng), X_world_camera[:3, 3] + share * sight + p)
            bodies += any_object(rng, surfaces, X, OBJECT, float(reach * rng.uniform(1.0, 3.0)))
        else:
            bodies.append(_edge(rng, surfaces, X_world_camera[:3, 3] + share * sight, R, reach))
    return bodies


def _edge(rng: np.random.Generator, surfaces: Surfaces, p_world_sight: Array, R: Array, reach: float) -> Body:
    """A board or a rod with one edge in front of an EE of that reach [m]."""
    board = rng.random() < 0.6
    half = reach * (rng.uniform(0.8, 3.0) if board else rng.uniform(0.15, 0.7))
    size = (2.0 * half, reach * rng.uniform(2.0, 6.0), 0.01) if board else (half, reach * rng.uniform(3.0, 8.0))
    p = R[:, 0] * (half + rng.uniform(-0.5, 0.9) * reach)
    R = R @ Rotation.from_rotvec(rng.normal(0.0, 0.25, 3)).as_matrix()
    mesh = box(np.asarray(size)) if board else cylinder(size[0], size[1], 16)
    if not board:
        R = R @ _R_ROD
    return Body(mesh, transform(R, p_world_sight + p), surfaces.material(rng), OBJECT)

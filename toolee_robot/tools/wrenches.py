"""Open-end, combination, adjustable, box and socket wrenches.

A head is made in its own axes: x out of the jaw's mouth (or away from the handle), y across the flats, z the nut's
axis; the origin is the nut's centre. The EE frame's x points the other way, towards the far end of the handle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.frames import Array, frame_from_axes, transform
from toolee_robot.tools.assembly import assemble
from toolee_robot.tools.materials import PLASTIC, RUBBER, STEEL_BRIGHT, STEEL_DARK, Material, varied
from toolee_robot.tools.model import EndEffector, Handle, Tool, ToolKind
from toolee_robot.tools.solids import (
    Piece,
    convex_runs,
    cross_section,
    extrude,
    loft,
    move,
    place,
    prism_points,
    stack,
    superellipse,
)
from toolee_robot.types import Category


@dataclass(frozen=True, eq=False)
class WrenchHead:
    """pieces in head axes; ee_x: the EE origin on the head's x axis; join: how far from the nut's centre the handle
    may begin so that it stays clear of the jaw; half_thickness along z."""

    pieces: list[Piece]
    ee_x: float
    join: float
    radius: float
    half_thickness: float


def make_wrench(kind: ToolKind, seed: int, rng: np.random.Generator) -> Tool:
    size = rng.uniform(0.008, 0.032)
    material = varied(STEEL_BRIGHT if rng.uniform() < 0.7 else STEEL_DARK, rng)
    if kind is ToolKind.SOCKET_WRENCH:
        return _socket_wrench(seed, rng, min(size, 0.024), material)
    length = float(np.clip(rng.uniform(7.5, 11.0) * size + 0.05, 0.11, 0.33))
    angle = np.deg2rad(rng.choice([0.0, 15.0, 15.0, rng.uniform(0.0, 22.5)]))
    far: WrenchHead | None = None
    far_angle = 0.0
    match kind:
        case ToolKind.OPEN_END_WRENCH:
            near = _open_head(rng, size, material)
            if rng.uniform() < 0.6:
                far, far_angle = _open_head(rng, size * rng.uniform(0.78, 1.0), material), angle
        case ToolKind.COMBINATION_WRENCH:
            near = _open_head(rng, size, material)
            far = _ring_head(rng, size, material)
        case ToolKind.BOX_WRENCH:
            near = _ring_head(rng, size, material)
            far = _ring_head(rng, size * rng.uniform(0.8, 1.0), material) if rng.uniform() < 0.8 else None
            angle = 0.0
        case _:
            near = _adjustable_head(rng, material)
            length = float(np.clip(7.0 * near.radius + rng.uniform(0.02, 0.08), 0.14, 0.33))
            angle = np.deg2rad(rng.uniform(10.0, 22.5))
    return _join(kind, seed, rng, near, far, length, angle, far_angle, material)


def _join(
    kind: ToolKind, seed: int, rng: np.random.Generator, near: WrenchHead, far: WrenchHead | None, length: float,
    angle: float, far_angle: float, material: Material,
) -> Tool:  # fmt: skip
    """Near head at the handle's +z end, far head (if any) at the other; the grip centre between them."""
    z_near = 0.5 * length
    z_far = -0.5 * length
    bow = np.deg2rad(rng.uniform(3.0, 15.0)) if kind is ToolKind.BOX_WRENCH and rng.uniform() < 0.7 else 0.0
    tip_far = np.deg2rad(rng.uniform(0.0, 15.0)) if kind is ToolKind.COMBINATION_WRENCH else bow
    top, bottom = z_near - near.join, (z_far + far.join) if far else z_far
    half_y = min(near.half_thickness, far.half_thickness if far else 1.0) * rng.uniform(0.55, 0.85)
    if kind is ToolKind.ADJUSTABLE_WRENCH:
        half_y = near.half_thickness * rng.uniform(0.6, 0.9)
    widest = near.radius * rng.uniform(0.42, 0.62)
    taper = rng.uniform(0.8, 1.05) if kind is not ToolKind.ADJUSTABLE_WRENCH else rng.uniform(0.85, 1.25)
    z = np.linspace(bottom, top, 16)
    u = np.linspace(0.0, 1.0, 16)
    waist = 1.0 - rng.uniform(0.0, 0.2) * np.sin(np.pi * u)
    a = widest * (taper + (1 - taper) * u) * waist
    exponent = float(rng.choice([2.0, 3.0, 5.0, 8.0]))
    rounding = np.ones(16)
    if far is None:
        rounding[0] = rng.uniform(0.55, 0.9)
    rings = stack(z, a * rounding, half_y * np.sqrt(rounding), superellipse(exponent))
    shaft = loft(rings)
    if far is None and rng.uniform() < 0.75:
        hole = superellipse(2.0, 24) * 0.45 * a[0]
        shaft = shaft - place(extrude(hole, -0.05, 0.05), _X_head(bottom + 1.1 * a[0], 0.0, 1.0, 0.0))
    handle_piece = Piece("handle", shaft, material, convex_runs(rings, 0.12))
    if far is None and kind is ToolKind.ADJUSTABLE_WRENCH and rng.uniform() < 0.4:
        cover_z = np.linspace(bottom - 0.003, bottom + 0.55 * (top - bottom), 10)
        scale = np.array([0.8, *[1.0] * 8, 0.85])
        sleeve = stack(cover_z, (np.interp(cover_z, z, a) + 0.002) * scale, (half_y + 0.002) * scale, superellipse(3.0))
        cover = varied(RUBBER if rng.uniform() < 0.5 else PLASTIC, rng)
        handle_pieces = [Piece("grip", loft(sleeve), cover, convex_runs(sleeve, 0.12)), handle_piece]
    else:
        handle_pieces = [handle_piece]
    ends = {1.0: z_near + near.radius, -1.0: (z_far - far.radius) if far else bottom}
    pieces, ees = list(handle_pieces), []
    heads = [(near, 1.0, z_near, angle, bow)] + ([(far, -1.0, z_far, far_angle, tip_far)] if far else [])
    for head, side, at, turn, pitch in heads:
        X_tool_head = _X_head(at, turn, side, pitch)
        for p in head.pieces:
            convex = tuple(move(c, X_tool_head) for c in p.convex)
            pieces.append(Piece(p.label, place(p.solid, X_tool_head), p.material, convex))
        origin = (X_tool_head @ [head.ee_x, 0.0, 0.0, 1.0])[:3]
        handle_end = np.array([0.0, 0.0, ends[-side]])
        X = frame_from_axes(z=X_tool_head[:3, 2], x=handle_end - origin, p=origin)
        ees.append(EndEffector(Category.WRENCH_HEAD, X))
    return assemble(kind, seed, pieces, tuple(ees), Handle(z, a * rounding, np.full(16, half_y)))


def _X_head(z: float, turn: float, side: float, pitch: float) -> Array:
    """Pose of a head at height z: its x out along side * tool z, turned about the nut's axis (tool y), pitched out of
    the plane of the jaws."""
    c, s, cp, sp = np.cos(turn), np.sin(turn), np.cos(pitch), np.sin(pitch)
    out = np.array([side * s, 0.0, side * c])
    normal = np.array([0.0, 1.0, 0.0])
    x = cp * out + sp * normal
    n = cp * normal - sp * out
    X = transform(np.column_stack([x, np.cross(n, x), n]), [0.0, 0.0, z])
    return X


def _open_head(rng: np.random.Generator, size: float, material: Material) -> WrenchHead:
    """A round head with a slot of parallel flats; the throat is flat, a V of 120 degrees, or round."""
    half = 0.5 * size
    wall = half * rng.uniform(0.85, 1.25)
    radius = half + wall
    throat = half * rng.uniform(0.9, 1.25)
    reach = half * rng.uniform(1.0, 1.6)
    skew = rng.uniform(-0.25, 0.25) * half
    t = 2 * np.pi * np.arange(64) / 64
    stretch = rng.uniform(1.0, 1.12)
    outline = np.column_stack([radius * stretch * np.cos(t), radius * np.sin(t)])
    reach = min(reach, 0.92 * np.sqrt(max(radius**2 - (half + 0.35 * wall) ** 2, 1e-9)) * stretch + 0.2 * half)
    mouth_low, mouth_high = reach - abs(skew) - skew, reach - abs(skew) + skew
    slope = (mouth_high - mouth_low) / (2 * half)
    far_side = 2 * radius
    keep = np.array([
        [-far_side, -far_side], [reach - abs(skew) - slope * far_side, -far_side],
        [reach - abs(skew) + slope * far_side, far_side], [-far_side, far_side],
    ])  # fmt: skip
    flat_start = {"flat": -throat, "v": -throat + half * np.tan(np.pi / 6), "round": -throat + 0.6 * half}
    shape = str(rng.choice(list(flat_start)))
    start = flat_start[shape]
    if shape == "round":
        arc = np.linspace(-np.pi / 2, np.pi / 2, 13)
        inner = np.column_stack([start - 0.6 * half * np.cos(arc), half * np.sin(arc)])
    elif shape == "v":
        inner = np.array([[start, -half], [-throat, 0.0], [start, half]])
    else:
        inner = np.array([[-throat, -half], [-throat, half]])
    slot = np.concatenate([inner, [[far_side, half], [far_side, -half]]])
    half_thickness = float(np.clip(size * rng.uniform(0.16, 0.26), 0.002, 0.007))
    region = (cross_section(outline) ^ cross_section(keep)) - cross_section(slot)
    solid = _beveled(region, half_thickness, min(0.25 * half_thickness, 0.08 * wall))
    shorter = min(mouth_low, mouth_high)
    x_root = -throat - 0.0
    jaws = tuple(
        prism_points(_clip(cross_section(outline) ^ cross_section(keep), box), -half_thickness, half_thickness)
        for box in (
            [[x_root, half], [far_side, half], [far_side, far_side], [x_root, far_side]],
            [[x_root, -half], [far_side, -half], [far_side, -far_side], [x_root, -far_side]],
            [[-far_side, -far_side], [x_root, -far_side], [x_root, far_side], [-far_side, far_side]],
        )
    )
    piece = Piece("jaw", solid, material, jaws)
    join = max(throat + 0.25 * (radius * stretch - throat), 0.75 * radius * stretch)
    return WrenchHead([piece], 0.5 * (shorter - throat), join, radius, half_thickness)


def _clip(region: object, box: list[list[float]]) -> Array:
    polygons = (region ^ cross_section(box)).to_polygons()  # type: ignore[operator]
    return np.concatenate([np.asarray(p) for p in polygons])


def _beveled(region: object, half_thickness: float, bevel: float) -> object:
    """The region as a plate with bevelled outer edges would need a straight skeleton; two steps come close."""
    del bevel
    return extrude(region, -half_thickness, half_thickness)


def _ring_head(rng: np.random.Generator, size: float, material: Material) -> WrenchHead:
    """A ring with a hexagonal or twelve-point hole; its EE is the nut's centre."""
    half = 0.5 * size
    corner = half / np.cos(np.pi / 6)
    radius = corner * rng.uniform(1.25, 1.5)
    half_thickness = float(np.clip(size * rng.uniform(0.2, 0.34), 0.003, 0.009))
    bevel = 0.15 * (radius - corner)
    z = half_thickness * np.array([-1.0, -0.7, 0.7, 1.0])
    rings = stack(z, np.array([radius - bevel, radius, radius, radius - bevel]), None, superellipse(2.0, 48))
    # A flat of the hexagon is normal to y.
    hexagon = corner * np.column_stack([np.cos(np.arange(6) * np.pi / 3), np.sin(np.arange(6) * np.pi / 3)])
    hole = cross_section(hexagon)
    if rng.uniform() < 0.6:
        hole = hole + cross_section(hexagon @ np.array([[np.cos(np.pi / 6), np.sin(np.pi / 6)], [-0.5, np.cos(np.pi / 6)]]))
    solid = loft(rings) - extrude(hole, -2 * half_thickness, 2 * half_thickness)
    convex = []
    t = np.linspace(0, 2 * np.pi, 13)
    for i in range(12):
        wedge = [[r * np.cos(a), r * np.sin(a)] for r in (corner, radius) for a in (t[i], t[i + 1])]
        convex.append(prism_points(wedge, -half_thickness, half_thickness))
    return WrenchHead([Piece("ring", solid, material, tuple(convex))], 0.0, 0.5 * (corner + radius), radius, half_thickness)


def _adjustable_head(rng: np.random.Generator, material: Material) -> WrenchHead:
    """A fixed jaw with the body, a sliding jaw, and the worm that moves it, at a random opening."""
    scale = rng.uniform(0.55, 1.25)
    capacity = 0.030 * scale
    opening = rng.uniform(0.25, 1.0) * capacity
    half = 0.5 * opening
    depth = capacity * rng.uniform(0.75, 1.0)
    wall = capacity * rng.uniform(0.42, 0.6)
    half_thickness = float(np.clip(0.0065 * scale * rng.uniform(0.85, 1.2), 0.0035, 0.0085))
    throat = 0.5 * depth
    tip = 0.5 * depth
    back = -throat - capacity * rng.uniform(0.75, 0.95)
    # The fixed jaw at negative y; the body reaches under the sliding jaw at its widest opening.
    rail = capacity - half + 0.35 * wall
    fixed = np.array([
        [tip, -half], [tip, -half - 0.45 * wall], [0.3 * tip, -half - 0.95 * wall], [-throat, -half - wall],
        [back, -half - 0.55 * wall], [back - 0.2 * capacity, -0.25 * capacity], [back - 0.2 * capacity, 0.25 * capacity],
        [back, rail - 0.3 * capacity], [-throat - 0.35 * capacity, rail], [-throat, rail], [-throat, -half],
    ])  # fmt: skip
    lip = rng.uniform(0.0, 0.12) * depth
    sliding = np.array([
        [tip - lip, half], [tip - lip, half + 0.4 * wall], [0.2 * tip, half + 0.85 * wall], [-throat, half + 0.95 * wall],
        [-throat - 0.18 * capacity, half + 0.95 * wall], [-throat - 0.18 * capacity, half], [-throat - 0.0, half],
    ])  # fmt: skip
    worm_radius = 0.16 * capacity
    worm_x = -throat - 0.42 * capacity
    window = np.array([[worm_x - 1.25 * worm_radius, -0.32 * capacity], [worm_x + 1.25 * worm_radius, -0.32 * capacity],
                       [worm_x + 1.25 * worm_radius, 0.22 * capacity], [worm_x - 1.25 * worm_radius, 0.22 * capacity]])  # fmt: skip
    body = extrude(cross_section(fixed) - cross_section(window), -half_thickness, half_thickness)
    thin = half_thickness * rng.uniform(0.8, 0.97)
    jaw = extrude(sliding, -thin, thin)
    n = 17
    ridges = worm_radius * (1.0 - 0.14 * (np.arange(n) % 2))
    rings = stack(np.linspace(-0.31, 0.21, n) * capacity, ridges, None, superellipse(2.0, 20))
    lay = transform(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), [worm_x, 0.0, 0.0])
    worm = Piece("worm", place(loft(rings), lay), varied(STEEL_BRIGHT, rng), ())
    hulls = [fixed[[0, 1, 2, 3, 10]], fixed[[3, 4, 5, 6, 7, 8, 9, 10]]]
    pieces = [
        Piece("jaw", body, material, tuple(prism_points(h, -half_thickness, half_thickness) for h in hulls)),
        Piece("sliding_jaw", jaw, material, (prism_points(sliding, -thin, thin),)),
        worm,
    ]
    shorter = tip - lip
    return WrenchHead(pieces, 0.5 * (shorter - throat), -back, 0.5 * capacity + wall, half_thickness)


def _socket_wrench(seed: int, rng: np.random.Generator, size: float, material: Material) -> Tool:
    """A ratchet with its socket: the nut's axis stands across the handle, the EE is inside the socket."""
    length = rng.uniform(0.14, 0.25)
    corner = 0.5 * size / np.cos(np.pi / 6)
    outer = corner * rng.uniform(1.2, 1.4) + 0.001
    drive = max(0.0125, 0.8 * outer) * rng.uniform(1.0, 1.3)
    half = rng.uniform(0.006, 0.010)
    depth = rng.uniform(0.020, 0.034)
    z_head = 0.5 * length
    X = _X_head(z_head, 0.0, 1.0, 0.0)
    head = stack(half * np.array([-1.0, -0.8, 0.8, 1.0]), drive * np.array([0.92, 1.0, 1.0, 0.92]), None, superellipse(2.0, 40))
    socket = stack(np.array([half - 0.001, half + depth - 0.0008, half + depth]), np.array([outer, outer, outer - 0.0008]), None, superellipse(2.0, 40))
    hexagon = corner * np.column_stack([np.cos(np.arange(6) * np.pi / 3), np.sin(np.arange(6) * np.pi / 3)])
    hole = rng.uniform(0.4, 0.6) * depth
    solid = loft(socket) - extrude(hexagon, half + depth - hole, half + depth + 0.01)
    shaft_radius = rng.uniform(0.005, 0.0075)
    grip_radius = rng.uniform(0.009, 0.015)
    z = np.linspace(-0.5 * length, z_head - 0.6 * drive, 20)
    u = (z - z[0]) / (z[-1] - z[0])
    grip_end = rng.uniform(0.5, 0.7)
    a = np.where(u < grip_end, grip_radius, shaft_radius)
    a[0] *= 0.8
    rings = stack(z, a, None, superellipse(float(rng.choice([2.0, 3.0]))))
    grip = varied(RUBBER if rng.uniform() < 0.5 else PLASTIC, rng) if rng.uniform() < 0.6 else material
    pieces = [
        Piece("handle", loft(rings), grip if grip is material else material, convex_runs(rings, 0.12)),
        Piece("ratchet", place(loft(head), X), material, (move(head, X).reshape(-1, 3),)),
        Piece("socket", place(solid, X), varied(STEEL_BRIGHT, rng), (move(socket, X).reshape(-1, 3),)),
    ]
    if grip is not material:
        soft = u < grip_end
        sleeve = stack(z[soft], a[soft] + 0.0008, None, superellipse(2.0))
        pieces.insert(0, Piece("grip", loft(sleeve), grip, ()))
    origin = (X @ [0.0, 0.0, half + depth - 0.5 * hole, 1.0])[:3]
    ee = EndEffector(
        Category.WRENCH_HEAD, frame_from_axes(z=X[:3, 2], x=np.array([0.0, origin[1], z[0]]) - origin, p=origin)
    )
    return assemble(ToolKind.SOCKET_WRENCH, seed, pieces, (ee,), Handle(z, a, a))

"""Textures, patterns of materials, environment maps and background images."""

from __future__ import annotations

import warp as wp

TABLE_SIZE = 128
"""Cells a side of the noise table, a power of two."""
_FEATURE = wp.constant(16.0)  # table cells a unit of noise coordinates: features are about one unit large
_MASK = wp.constant(TABLE_SIZE - 1)
_SIZE = wp.constant(TABLE_SIZE)

SOLID, CLOUD, WOOD, STRIPES, CHECKER, SPECKLE, SCRATCHES, PLANKS, TILES = range(9)
_SOLID, _CLOUD, _WOOD, _STRIPES = (wp.constant(k) for k in (SOLID, CLOUD, WOOD, STRIPES))
_CHECKER, _SPECKLE, _SCRATCHES, _PLANKS = (wp.constant(k) for k in (CHECKER, SPECKLE, SCRATCHES, PLANKS))


@wp.struct
class Surface:
    """A body's pose in the camera's frame and its material; see `material.Material`."""

    R: wp.mat33
    p: wp.vec3
    color: wp.vec3
    color2: wp.vec3
    offset: wp.vec3
    pattern: wp.int32
    axis: wp.int32
    per_scale: wp.float32
    roughness: wp.float32
    metallic: wp.float32
    wear: wp.float32


@wp.func
def noise(q: wp.vec3, table: wp.array[wp.float32]) -> wp.float32:
    """Smooth noise with features about one unit large and a period of 8 units.

    Args:
        q: Point in noise units.
        table: The noise table, (TABLE_SIZE ** 3,).

    Returns:
        A value in [0, 1].
    """
    i = wp.int32(wp.floor(q[0] * _FEATURE)) & _MASK
    j = wp.int32(wp.floor(q[1] * _FEATURE)) & _MASK
    k = wp.int32(wp.floor(q[2] * _FEATURE)) & _MASK
    return table[(i * _SIZE + j) * _SIZE + k]


@wp.func
def fractal(q: wp.vec3, table: wp.array[wp.float32]) -> wp.float32:
    """Two octaves of `noise`.

    Args:
        q: Point in noise units.
        table: The noise table.

    Returns:
        A value in [0, 1].
    """
    return 0.65 * noise(q, table) + 0.35 * noise(2.7 * q, table)


@wp.func
def odd(whole: wp.float32) -> wp.float32:
    """1 for odd numbers, 0 for even ones."""
    return whole - 2.0 * wp.floor(0.5 * whole)


@wp.func
def mixed(s: Surface, q: wp.vec3, table: wp.array[wp.float32]) -> wp.float32:
    """Share of a material's second colour.

    Args:
        s: The material.
        q: Point in pattern coordinates.
        table: The noise table.

    Returns:
        The share, in [0, 1].
    """
    along = q[s.axis]
    u = q[(s.axis + 1) % 3]
    v = q[(s.axis + 2) % 3]
    if s.pattern == _CLOUD:
        return fractal(q, table)
    if s.pattern == _WOOD:
        slow = wp.vec3(0.12 * along, u, v)
        rings = wp.sin(6.3 * (u + 0.35 * v) + 7.0 * noise(0.4 * slow, table))
        return wp.clamp(0.45 + 0.3 * rings + 0.5 * (noise(4.0 * slow, table) - 0.5), 0.0, 1.0)
    if s.pattern == _STRIPES:
        return odd(wp.floor(along))
    if s.pattern == _CHECKER:
        return odd(wp.floor(along) + wp.floor(u) + wp.floor(v))
    if s.pattern == _SPECKLE:
        return wp.where(noise(1.7 * q, table) > 0.72, 1.0, 0.0)
    if s.pattern == _SCRATCHES:
        return wp.clamp(noise(wp.vec3(0.08 * along, 2.0 * u, 2.0 * v), table) * 1.3 - 0.15, 0.0, 1.0)
    if s.pattern == _PLANKS:
        board = wp.floor(u)
        grain = noise(wp.vec3(0.7 * along + 3.1 * board, 8.0 * u, 2.0 * v), table)
        gap = wp.where(u - board < 0.03, 1.0, 0.0)
        return wp.clamp(0.6 * grain + 0.4 * noise(1.7 * wp.vec3(board, board, 0.0), table) + gap, 0.0, 1.0)
    # Tiles: joints of the second colour.
    return wp.where(u - wp.floor(u) < 0.04 or along - wp.floor(along) < 0.04, 1.0, 0.0)


@wp.func
def albedo(s: Surface, q: wp.vec3, table: wp.array[wp.float32]) -> wp.vec3:
    """Albedo of a body.

    Args:
        s: Its material.
        q: Point, body frame [m].
        table: The noise table.

    Returns:
        Linear RGB.
    """
    placed = q + s.offset
    color = s.color
    if s.pattern != _SOLID:
        color = color + mixed(s, placed * s.per_scale, table) * (s.color2 - color)
    if s.wear > 0.0:
        # Dirt has the size of a hand's touch, whatever the pattern's scale.
        dirt = fractal(25.0 * placed, table)
        color = color * (1.0 - s.wear * wp.clamp(2.0 * dirt - 0.7, 0.0, 1.0))
    return color


SKY_SIZE = 64
"""Cells a side of a map."""
SKY_LEVELS = 4
"""Maps, from sharp to blurred; the last one serves as the diffuse irradiance."""
_CELLS = wp.constant(SKY_SIZE)
_HALF = wp.constant(0.5 * SKY_SIZE)


@wp.struct
class Lobe:
    """See `scene.Lobe`."""

    direction: wp.vec3
    width: wp.float32
    color: wp.vec3


@wp.struct
class Patch:
    """See `scene.Patch`; cos, sin: of its angle."""

    centre: wp.vec2
    half_axes: wp.vec2
    cos: wp.float32
    sin: wp.float32
    oval: wp.int32
    color: wp.vec3


@wp.func
def unfolded(u: wp.float32, v: wp.float32) -> wp.vec3:
    """Direction of a point of an octahedral map.

    Args:
        u: Coordinate in [-1, 1].
        v: Coordinate in [-1, 1].

    Returns:
        The unit direction.
    """
    z = 1.0 - wp.abs(u) - wp.abs(v)
    fold = wp.max(-z, 0.0)
    return wp.normalize(wp.vec3(u - wp.sign(u) * fold, v - wp.sign(v) * fold, z))


@wp.kernel(enable_backward=False)
def bake(
    zenith: wp.vec3,
    horizon: wp.vec3,
    ground: wp.vec3,
    lobes: wp.array[Lobe],
    blurs: wp.array[wp.float32],
    maps: wp.array[wp.vec3],
):
    """Bake the light from all directions into maps of decreasing sharpness; one thread per cell.

    Args:
        zenith: Radiance from above, linear RGB.
        horizon: Radiance from the horizon.
        ground: Radiance from below.
        lobes: Further sources of light.
        blurs: Half-width of the lobe that each level averages over, (SKY_LEVELS,) [rad].
        maps: Output: radiance at the middle of each cell, (SKY_LEVELS * SKY_SIZE * SKY_SIZE,).
    """
    cell = wp.tid()
    level = cell // (_CELLS * _CELLS)
    i = (cell // _CELLS) % _CELLS
    j = cell % _CELLS
    d = unfolded((wp.float32(i) + 0.5) / _HALF - 1.0, (wp.float32(j) + 0.5) / _HALF - 1.0)
    blur = blurs[level]
    # The gradient's slope at the horizon softens with the blur.
    s = 0.5 + 0.5 * wp.tanh(d[2] / (0.25 + blur))
    up = horizon + (zenith - horizon) * wp.clamp(d[2], 0.0, 1.0)
    total = ground + (up - ground) * s
    for k in range(lobes.shape[0]):
        lobe = lobes[k]
        width2 = lobe.width * lobe.width + blur * blur
        gain = lobe.width * lobe.width / width2
        total += lobe.color * (gain * wp.exp((wp.dot(d, lobe.direction) - 1.0) / width2))
    maps[cell] = total


@wp.func
def sky(d: wp.vec3, level: wp.int32, maps: wp.array[wp.vec3]) -> wp.vec3:
    """Radiance of the surroundings.

    Args:
        d: Unit direction, world frame.
        level: Level of blur, 0 for the sharpest.
        maps: The maps, as from `bake`.

    Returns:
        Linear RGB.
    """
    scale = 1.0 / wp.max(wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2]), 1e-9)
    u = d[0] * scale
    v = d[1] * scale
    if d[2] < 0.0:
        folded_u = wp.where(u < 0.0, wp.abs(v) - 1.0, 1.0 - wp.abs(v))
        v = wp.where(v < 0.0, wp.abs(u) - 1.0, 1.0 - wp.abs(u))
        u = folded_u
    i = wp.clamp(wp.int32((u + 1.0) * _HALF), 0, _CELLS - 1)
    j = wp.clamp(wp.int32((v + 1.0) * _HALF), 0, _CELLS - 1)
    return maps[(level * _CELLS + i) * _CELLS + j]


@wp.kernel(enable_backward=False)
def backdrop(
    width: wp.int32,
    corner: wp.vec3,
    right: wp.vec3,
    down: wp.vec3,
    patches: wp.array[Patch],
    out: wp.array[wp.vec3],
):
    """Draw a background image: a gradient with patches.

    Args:
        width: Width of the image [px].
        corner: Colour at the upper left corner, linear RGB.
        right: Change of the colour along the width.
        down: Change of the colour along the same distance downwards.
        patches: The patches, drawn in order.
        out: Output: linear RGB at each pixel, (H * W,).
    """
    i = wp.tid()
    x = wp.float32(i % width) / wp.float32(width)
    y = wp.float32(i // width) / wp.float32(width)
    color = corner + x * right + y * down
    for k in range(patches.shape[0]):
        patch = patches[k]
        dx = x - patch.centre[0]
        dy = y - patch.centre[1]
        u = (patch.cos * dx + patch.sin * dy) / patch.half_axes[0]
        v = (patch.cos * dy - patch.sin * dx) / patch.half_axes[1]
        if patch.oval != 0:
            if u * u + v * v < 1.0:
                color = patch.color
        elif wp.abs(u) < 1.0 and wp.abs(v) < 1.0:
            color = patch.color
    out[i] = color

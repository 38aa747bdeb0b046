"""Textures: smooth noise from a table, and the patterns of materials made of it."""

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

"""Shadows: rays from the points that are seen to the lamps, and the visible share of each lamp."""

from __future__ import annotations

import warp as wp

from toolee_robot.render.kernels.light import Lamp, towards

_OFFSET = wp.constant(4e-4)  # shadow rays start this far [m] off the surface, or it would shadow itself
_JITTER_LENGTH = wp.constant(65537)  # a prime above any image's width, so that rows differ


@wp.func
def jitter(i: wp.int32) -> wp.vec3:
    """In the cube [-1, 1]^3: the R3 low-discrepancy sequence."""
    k = wp.float64(i % _JITTER_LENGTH)
    a = k * wp.float64(0.8191725134)
    b = k * wp.float64(0.6710436067)
    c = k * wp.float64(0.5497004779)
    x = wp.float32(a - wp.floor(a))
    y = wp.float32(b - wp.floor(b))
    z = wp.float32(c - wp.floor(c))
    return wp.vec3(2.0 * x - 1.0, 2.0 * y - 1.0, 2.0 * z - 1.0)


@wp.kernel(enable_backward=False)
def rays_to_lamp(
    ids: wp.array2d[wp.int32],
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    lamps: wp.array[Lamp],
    which: wp.int32,
    first: wp.int32,
    origins: wp.array2d[wp.float32],
    directions: wp.array2d[wp.float32],
    reach: wp.array[wp.float32],
):
    """Rays from hits towards a lamp; towards a point of a soft lamp that a fixed hash of first + i chooses.

    Args:
        ids: `Found.ids` of the hits, (2, N).
        points: Hits, camera frame, (N,) [m].
        normals: Unit normals there, (N,).
        lamps: The lamps.
        which: Index of the lamp.
        first: Number of the first ray.
        origins: Output: origins, camera frame, (3, N) [m].
        directions: Output: directions, (3, N).
        reach: Output: lengths, (N,); -1 where nothing was hit or the surface faces away.
    """
    i = wp.tid()
    # What is not asked for shares packets with what is: its numbers must be numbers.
    length = wp.float32(-1.0)
    origin = wp.vec3(0.0)
    direction = wp.vec3(0.0, 0.0, 1.0)
    if ids[1, i] >= 0:
        lamp = lamps[which]
        way = towards(lamp, points[i])
        if wp.dot(way.direction, normals[i]) > 0.0:
            length = way.distance - 2.0 * _OFFSET
            origin = points[i] + normals[i] * _OFFSET
            direction = way.direction
            if lamp.softness > 0.0:
                spread = wp.where(lamp.far != 0, lamp.softness, lamp.softness / way.distance)
                direction = direction + jitter(first + i) * spread
    reach[i] = length
    for k in range(3):
        origins[k, i] = origin[k]
        directions[k, i] = direction[k]


@wp.kernel(enable_backward=False)
def seen_unblurred(
    reach: wp.array[wp.float32], blocked: wp.array[wp.uint8], which: wp.int32, seen: wp.array2d[wp.float32]
):
    """Visibility of a lamp: 1 where a ray to it was cast and hit nothing, else 0.

    Args:
        reach: Lengths of the rays, as from `rays_to_lamp`, (N,).
        blocked: Whether they hit something, (N,).
        which: Index of the lamp.
        seen: Output, row `which` of (L, N).
    """
    i = wp.tid()
    seen[which, i] = wp.where(reach[i] > 0.0 and blocked[i] == wp.uint8(0), 1.0, 0.0)


@wp.kernel(enable_backward=False)
def count_beside(
    reach: wp.array[wp.float32],
    blocked: wp.array[wp.uint8],
    width: wp.int32,
    radius: wp.int32,
    counts: wp.array[wp.int32],
):
    """Count rays up to `radius` pixels to the left and right of each pixel.

    Args:
        reach: Lengths of the rays, as from `rays_to_lamp`, (N,).
        blocked: Whether they hit something, (N,).
        width: Width of the image [px].
        radius: Radius of the window [px].
        counts: Output: number of rays that were cast plus 256 times the number that hit nothing, (N,).
    """
    i = wp.tid()
    x = i % width
    total = wp.int32(0)
    for k in range(i - wp.min(radius, x), i + wp.min(radius, width - 1 - x) + 1):
        if reach[k] > 0.0:
            total += wp.where(blocked[k] == wp.uint8(0), 257, 1)
    counts[i] = total


@wp.kernel(enable_backward=False)
def seen_blurred(
    reach: wp.array[wp.float32],
    counts: wp.array[wp.int32],
    width: wp.int32,
    height: wp.int32,
    radius: wp.int32,
    which: wp.int32,
    seen: wp.array2d[wp.float32],
):
    """Visibility of a lamp: share of the rays in a window about each pixel that hit nothing; 0 where none was cast.

    Args:
        reach: Lengths of the rays, as from `rays_to_lamp`, (N,).
        counts: Counts along the rows, as from `count_beside`, (N,).
        width: Width of the image [px].
        height: Height of the image [px].
        radius: Radius of the window [px].
        which: Index of the lamp.
        seen: Output, row `which` of (L, N).
    """
    i = wp.tid()
    if reach[i] <= 0.0:
        seen[which, i] = 0.0
        return
    y = i // width
    total = wp.int32(0)
    for row in range(wp.max(y - radius, 0), wp.min(y + radius, height - 1) + 1):
        total += counts[i + (row - y) * width]
    seen[which, i] = wp.float32(total >> 8) / wp.float32(total & 255)

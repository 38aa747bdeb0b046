"""Surroundings of a scene: light from all directions, baked into octahedral maps, or a flat background image."""

from __future__ import annotations

import warp as wp

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

"""A camera's pixels: its rays, outlines, and linear colours as 8-bit sRGB."""

from __future__ import annotations

import warp as wp

METERED = 1 << 20
"""Integer that stands for a brightness of 1 in `meter`: integers have the same sum in any order."""
_METERED = wp.constant(float(METERED))
CURVE = 4096
"""Entries of the sRGB table."""
_LAST = wp.constant(float(CURVE - 1))


@wp.kernel(enable_backward=False)
def pixel_rays(
    width: wp.int32,
    x0: wp.int32,
    y0: wp.int32,
    fx: wp.float64,
    fy: wp.float64,
    cx: wp.float64,
    cy: wp.float64,
    rays: wp.array2d[wp.float32],
):
    """Rays through the pixel centres of a region, row by row.

    Args:
        width: Width of the region [px].
        x0: Left column of the region.
        y0: Upper row of the region.
        fx: Focal length along x [px].
        fy: Focal length along y [px].
        cx: Column of the principal point [px].
        cy: Row of the principal point [px].
        rays: Output: directions with z = 1, camera frame, (3, N).
    """
    i = wp.tid()
    rays[0, i] = wp.float32((wp.float64(x0 + i % width) - cx) / fx)
    rays[1, i] = wp.float32((wp.float64(y0 + i // width) - cy) / fy)
    rays[2, i] = 1.0


@wp.kernel(enable_backward=False)
def rays_beside(
    pixels: wp.array[wp.int32],
    width: wp.int32,
    fx: wp.float64,
    fy: wp.float64,
    cx: wp.float64,
    cy: wp.float64,
    shifts: wp.array[wp.vec2],
    rays: wp.array2d[wp.float32],
):
    """Further rays through P pixels: a whole set for each of S shifts from the pixel centres.

    Args:
        pixels: Flat indices of the pixels, (P,).
        width: Width of the image [px].
        fx: Focal length along x [px].
        fy: Focal length along y [px].
        cx: Column of the principal point [px].
        cy: Row of the principal point [px].
        shifts: The shifts (x, y), (S,) [px].
        rays: Output: directions with z = 1, camera frame, (3, S * P).
    """
    i = wp.tid()
    pixel = pixels[i % pixels.shape[0]]
    shift = shifts[i // pixels.shape[0]]
    rays[0, i] = wp.float32((wp.float64(pixel % width) + wp.float64(shift[0]) - cx) / fx)
    rays[1, i] = wp.float32((wp.float64(pixel // width) + wp.float64(shift[1]) - cy) / fy)
    rays[2, i] = 1.0


@wp.func
def steps(a: wp.int32, b: wp.int32, found: wp.array2d[wp.float32], ids: wp.array2d[wp.int32]) -> wp.bool:
    """Whether two pixels show different bodies, or depths that differ by 2 %.

    Args:
        a: Flat index of a pixel.
        b: Flat index of the other pixel.
        found: `Found.values` of the pixels' rays, (6, N).
        ids: `Found.ids` of the pixels' rays, (2, N).
    """
    if ids[1, a] != ids[1, b]:
        return True
    if ids[1, a] < 0:
        return False
    return wp.abs(found[0, a] - found[0, b]) > 0.02 * wp.min(found[0, a], found[0, b])


@wp.kernel(enable_backward=False)
def outlines(
    found: wp.array2d[wp.float32],
    ids: wp.array2d[wp.int32],
    width: wp.int32,
    height: wp.int32,
    marks: wp.array[wp.uint8],
):
    """Mark the pixels beside which another body or a step in depth begins.

    Args:
        found: `Found.values` of the pixels' rays, (6, N).
        ids: `Found.ids` of the pixels' rays, (2, N).
        width: Width of the image [px].
        height: Height of the image [px].
        marks: Output: 1 at these pixels, else 0, (N,).
    """
    i = wp.tid()
    x = i % width
    y = i // width
    on = wp.bool(False)
    if x > 0:
        on = on or steps(i, i - 1, found, ids)
    if x < width - 1:
        on = on or steps(i, i + 1, found, ids)
    if y > 0:
        on = on or steps(i, i - width, found, ids)
    if y < height - 1:
        on = on or steps(i, i + width, found, ids)
    marks[i] = wp.where(on, wp.uint8(1), wp.uint8(0))


@wp.kernel(enable_backward=False)
def mix_in(pixels: wp.array[wp.int32], more: wp.array[wp.vec3], sets: wp.int32, colors: wp.array[wp.vec3]):
    """Average the colours of P pixels with those of further rays through them.

    Args:
        pixels: Flat indices of the pixels, (P,).
        more: Colours of the further rays, linear RGB, (sets * P,).
        sets: Number of further rays per pixel.
        colors: Colours of all pixels, linear RGB, (N,); changed in place.
    """
    i = wp.tid()
    total = colors[pixels[i]]
    for k in range(sets):
        total += more[k * pixels.shape[0] + i]
    colors[pixels[i]] = total / wp.float32(1 + sets)


@wp.kernel(enable_backward=False)
def meter(colors: wp.array[wp.vec3], total: wp.array[wp.int64]):
    """Add up the brightness of all channels, each at most 1.

    Args:
        colors: Colours, linear RGB, (N,).
        total: Output: the sum in units of 1 / METERED, (1,).
    """
    c = colors[wp.tid()]
    bright = wp.min(c[0], 1.0) + wp.min(c[1], 1.0) + wp.min(c[2], 1.0)
    wp.atomic_add(total, 0, wp.int64(bright * _METERED))


@wp.kernel(enable_backward=False)
def adapt(
    total: wp.array[wp.int64],
    values: wp.float32,
    wanted: wp.float32,
    share: wp.float32,
    exposure: wp.array[wp.float32],
):
    """Bring the exposure nearer to the one that gives the wanted mean brightness.

    Args:
        total: Sum of the brightness, as `meter` gives it, (1,).
        values: Number of values in the sum.
        wanted: Wanted mean.
        share: Exponent of the factor on the exposure: 0 keeps it, 1 corrects it fully.
        exposure: The exposure, (1,); changed in place.
    """
    mean = wp.float32(wp.float64(total[0]) / (wp.float64(_METERED) * wp.float64(values)))
    exposure[0] = exposure[0] * wp.clamp(wp.pow(wanted / wp.max(mean, 1e-3), share), 0.4, 6.0)


@wp.kernel(enable_backward=False)
def to_srgb(
    colors: wp.array[wp.vec3],
    exposure: wp.array[wp.float32],
    curve: wp.array[wp.uint8],
    rgb: wp.array2d[wp.uint8],
):
    """Convert linear RGB to 8-bit sRGB; highlights are rolled off softly above 0.8.

    Args:
        colors: Colours, linear RGB, (N,).
        exposure: Factor on the colours, (1,).
        curve: The sRGB curve, (CURVE,).
        rgb: Output: sRGB, (N, 3).
    """
    i = wp.tid()
    color = colors[i] * exposure[0]
    for k in range(3):
        x = wp.max(color[k], 0.0)
        if x > 0.8:
            x = 1.0 - 0.2 * wp.exp(-(x - 0.8) / 0.2)
        rgb[i, k] = curve[wp.int32(x * _LAST)]

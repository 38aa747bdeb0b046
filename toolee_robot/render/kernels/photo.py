"""Effects of a colour camera on an ideal image, see `render.sensors.color_camera`.

Images of N pixels: 8-bit values lie in memory pixel after pixel, (N, 3); the float channels in between one after the
other, (3, N).
"""

from __future__ import annotations

import warp as wp

from toolee_robot.render.kernels.filters import normals


@wp.kernel(enable_backward=False)
def through_curve(rgb: wp.array[wp.uint8], curve: wp.array[wp.float32], out: wp.array[wp.float32]):
    """Map each channel through its own curve.

    Args:
        rgb: 8-bit image, (N, 3), flat.
        curve: The curves, (256, 3), flat.
        out: Output: float image, (3, N), flat.
    """
    i = wp.tid()
    count = rgb.shape[0] // 3
    for c in range(3):
        out[c * count + i] = curve[3 * wp.int32(rgb[3 * i + c]) + c]


@wp.kernel(enable_backward=False)
def smear(
    image: wp.array[wp.float32],
    width: wp.int32,
    height: wp.int32,
    shifts: wp.array2d[wp.int32],
    out: wp.array[wp.float32],
):
    """Mean of shifted copies: motion blur, for which whole pixels are enough.

    Args:
        image: Float image, (3, N), flat.
        width: Width [px].
        height: Height [px].
        shifts: Shifts (rows, columns), (S, 2) [px].
        out: Output: the mean, (3, N), flat.
    """
    i = wp.tid()
    x = i % width
    y = (i // width) % height
    plane = i - y * width - x
    total = wp.float32(0.0)
    for k in range(shifts.shape[0]):
        row = wp.clamp(y + shifts[k, 0], 0, height - 1)
        column = wp.clamp(x + shifts[k, 1], 0, width - 1)
        total += image[plane + row * width + column]
    out[i] = total / wp.float32(shifts.shape[0])


@wp.kernel(enable_backward=False)
def expose(
    image: wp.array[wp.float32],
    width: wp.int32,
    vignette: wp.float32,
    grain: wp.float32,
    seed: wp.int32,
    table: wp.array[wp.float32],
    rgb: wp.array[wp.uint8],
):
    """Convert to 8 bit with vignetting and grain.

    Args:
        image: Float image, (3, N), flat.
        width: Width [px].
        vignette: Darkening in the corners, a share.
        grain: Standard deviation of the noise [8-bit steps].
        seed: Seed of the noise.
        table: Quantiles of the normal distribution, see `filters.normals`.
        rgb: Output: 8-bit image, (N, 3), flat.
    """
    i = wp.tid()
    count = rgb.shape[0] // 3
    v = wp.float32(i // width) / wp.float32(count // width) * 2.0 - 1.0
    u = wp.float32(i % width) / wp.float32(width) * 2.0 - 1.0
    light = 1.0 - vignette * (u * u + v * v) / 2.0
    first = normals(seed, 2 * i, table)
    second = normals(seed, 2 * i + 1, table)
    noise = wp.vec3(first[0], first[1], second[0])
    for c in range(3):
        value = image[c * count + i] * light + grain * noise[c]
        rgb[3 * i + c] = wp.uint8(wp.clamp(wp.rint(value), 0.0, 255.0))

"""Gaussian blur and white noise of images (C, H, W) that lie in memory row after row.

The images are flat arrays: one index finds a value sooner than three.
"""

from __future__ import annotations

import warp as wp

NORMALS = 1 << 16
"""Entries of the table of normal numbers: quantiles at the middles of so many equal shares."""
_LOW = wp.constant(wp.uint32(NORMALS - 1))
_SHIFT = wp.constant(wp.uint32(16))


@wp.func
def normals(seed: wp.int32, number: wp.int32, table: wp.array[wp.float32]) -> wp.vec2:
    """Two independent standard normal numbers; one hash looks both up in a table.

    Args:
        seed: Seed of the sequence of pairs.
        number: Index of the pair in the sequence.
        table: Quantiles of the normal distribution, (NORMALS,).

    Returns:
        The pair.
    """
    bits = wp.randu(wp.rand_init(seed, number))
    return wp.vec2(table[wp.int32(bits & _LOW)], table[wp.int32(bits >> _SHIFT)])


@wp.func
def reflected(i: wp.int32, n: wp.int32) -> wp.int32:
    """Index of the pixel that stands for one beyond the border: the image is mirrored, the outermost pixel occurs once.

    Args:
        i: Index, which may lie beyond the border.
        n: Number of pixels along the axis.

    Returns:
        The index, in [0, n).
    """
    k = wp.abs(i)
    return wp.clamp(wp.min(k, 2 * (n - 1) - k), 0, n - 1)


@wp.kernel(enable_backward=False)
def blur(
    image: wp.array[wp.float32],
    weights: wp.array[wp.float32],
    stride: wp.int32,
    length: wp.int32,
    out: wp.array[wp.float32],
):
    """Blur along one axis; borders are reflected.

    Args:
        image: The flat image.
        weights: Weights of a pixel and of those 1 .. R beside it, (R + 1,).
        stride: Distance in memory of two neighbours along the axis.
        length: Number of pixels along the axis.
        out: Output: the blurred flat image.
    """
    i = wp.tid()
    place = (i // stride) % length
    radius = weights.shape[0] - 1
    total = weights[0] * image[i]
    if place >= radius and place < length - radius:
        for k in range(1, radius + 1):
            total += weights[k] * (image[i - k * stride] + image[i + k * stride])
    else:
        first = i - place * stride
        for k in range(1, radius + 1):
            before = first + reflected(place - k, length) * stride
            after = first + reflected(place + k, length) * stride
            total += weights[k] * (image[before] + image[after])
    out[i] = total


@wp.kernel(enable_backward=False)
def white(seed: wp.int32, table: wp.array[wp.float32], out: wp.array[wp.float32]):
    """Independent standard normal numbers, two per thread; equal seeds give equal ones on every device.

    Args:
        seed: The seed.
        table: Quantiles of the normal distribution, see `normals`.
        out: Output: the numbers, (N,).
    """
    i = wp.tid()
    pair = normals(seed, i, table)
    out[2 * i] = pair[0]
    if 2 * i + 1 < out.shape[0]:
        out[2 * i + 1] = pair[1]

"""A blur and white noise. Images (C, H, W) lie in memory row after row: one index finds its value sooner than three."""

from __future__ import annotations

import warp as wp

NORMALS = 1 << 16
"""Entries of the table of normal numbers: quantiles at the middles of so many equal shares."""
_LOW = wp.constant(wp.uint32(NORMALS - 1))
_SHIFT = wp.constant(wp.uint32(16))


@wp.func
def normals(seed: wp.int32, number: wp.int32, table: wp.array[wp.float32]) -> wp.vec2:
    """Two independent standard normal numbers, the pair of that number: one hash looks both up in the table."""
    bits = wp.randu(wp.rand_init(seed, number))
    return wp.vec2(table[wp.int32(bits & _LOW)], table[wp.int32(bits >> _SHIFT)])


@wp.func
def reflected(i: wp.int32, n: wp.int32) -> wp.int32:
    """Beyond the border the image is seen in a mirror, its outermost pixels once."""
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
    """Along the axis of that stride and length. weights (R + 1,): of a pixel and of those 1 .. R beside it."""
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
    """Independent standard normal numbers, two by each thread; equal seeds give equal ones, whatever computes them."""
    i = wp.tid()
    pair = normals(seed, i, table)
    out[2 * i] = pair[0]
    if 2 * i + 1 < out.shape[0]:
        out[2 * i + 1] = pair[1]

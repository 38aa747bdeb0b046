"""Filters, readings of a depth camera's pixels, and effects of a colour camera; see `render.depth_sensors`.

Images are flat arrays, (C, H, W) row after row: one index finds a value sooner than three. 8-bit values of a colour
camera's N pixels lie in memory pixel after pixel, (N, 3); the float channels in between one after the other, (3, N).
"""

from __future__ import annotations

import warp as wp

from toolee_robot import depth_noise

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


_HALF_PI = wp.constant(1.5707963)
_A0, _A1, _A2, _A3 = (wp.constant(coefficient) for coefficient in depth_noise.AXIAL_MM)
_STEEPEST = wp.constant(depth_noise.STEEPEST)
_GRAZING_WIDTH = wp.constant(depth_noise.GRAZING_WIDTH)
_NEAREST = wp.constant(depth_noise.NEAREST)
_NOTHING = wp.constant(depth_noise.NOTHING)
_OUT_OF_PHASE = wp.constant(depth_noise.OUT_OF_PHASE)


@wp.struct
class Sensor:
    """`DepthNoise` without its lateral jitter."""

    axial: wp.float32
    correlation: wp.float32
    mixed: wp.float32
    edge_dropout: wp.float32
    edge_step: wp.float32
    shiny_dropout: wp.float32
    grazing: wp.float32
    random_dropout: wp.float32
    bias: wp.float32
    scale: wp.float32
    minimum: wp.float32
    maximum: wp.float32
    quantum: wp.float32


@wp.func
def axial_sigma(z: wp.float32, incidence: wp.float32) -> wp.float32:
    """Standard deviation of a depth, see `depth_noise.AXIAL_MM`.

    Args:
        z: Depth [m].
        incidence: Angle between the ray and the surface's normal [rad].

    Returns:
        The standard deviation [m].
    """
    theta = wp.min(incidence, _STEEPEST)
    slant = theta / (_HALF_PI - theta)
    return 1e-3 * (_A0 + _A1 * z + _A2 * z * z + _A3 * z * wp.sqrt(z) * slant * slant)


@wp.kernel(enable_backward=False)
def look_beside(
    depth: wp.array[wp.float32],
    width: wp.int32,
    spread: wp.float32,
    edge_step: wp.float32,
    seed: wp.int32,
    table: wp.array[wp.float32],
    out: wp.array[wp.float32],
):
    """Lateral noise: each pixel takes the depth up to a few pixels beside it.

    The deviation in pixels is spread / depth. A pixel that would jump over a small step keeps its value: only outlines
    fray, not slopes, whose error is the axial one.

    Args:
        depth: True depth, (N,) [m].
        width: Width of the image [px].
        spread: Standard deviation of the shift at a depth of 1 m [px].
        edge_step: Smallest step in depth that counts as an outline [m].
        seed: Seed of the noise.
        table: Quantiles of the normal distribution, see `filters.normals`.
        out: Output: the depth with lateral noise, (N,) [m].
    """
    i = wp.tid()
    own = depth[i]
    jump = normals(seed, i, table) * (spread / wp.max(own, _NEAREST))
    row = wp.clamp(i // width + wp.int32(wp.rint(jump[0])), 0, depth.shape[0] // width - 1)
    column = wp.clamp(i % width + wp.int32(wp.rint(jump[1])), 0, width - 1)
    other = depth[row * width + column]
    out[i] = wp.where(own > 0.0 and wp.abs(other - own) > edge_step, other, own)


@wp.kernel(enable_backward=False)
def read(
    depth: wp.array[wp.float32],
    seen: wp.array[wp.float32],
    cos_incidence: wp.array[wp.float32],
    shininess: wp.array[wp.float32],
    common: wp.array[wp.float32],
    width: wp.int32,
    s: Sensor,
    seed: wp.int32,
    table: wp.array[wp.float32],
    out: wp.array[wp.float32],
):
    """Readings of the sensor.

    Args:
        depth: True depth, (N,) [m].
        seen: Depth with lateral noise, as from `look_beside`, (N,) [m].
        cos_incidence: Cosine of the angle of incidence, (N,).
        shininess: Shininess in [0, 1], (N,).
        common: Noise of unit variance that neighbours share, (N,); or empty.
        width: Width of the image [px].
        s: Parameters of the sensor.
        seed: Seed of the noise.
        table: Quantiles of the normal distribution, see `filters.normals`.
        out: Output: readings, (N,) [m]; 0 where there is none.
    """
    i = wp.tid()
    out[i] = 0.0
    z = seen[i]
    if depth[i] <= 0.0 or z <= 0.0:
        return
    state = wp.rand_init(seed, 2 * i)
    cos = wp.clamp(cos_incidence[i], 0.0, 1.0)
    incidence = wp.acos(cos)
    # What a surface gives back despite its shine, and at its slant, and by luck.
    kept = 1.0 - s.random_dropout
    kept *= 1.0 - s.shiny_dropout * shininess[i] * wp.sqrt(1.0 - cos * cos)
    if s.grazing < _HALF_PI:
        kept /= 1.0 + wp.exp(wp.clamp((incidence - s.grazing) / _GRAZING_WIDTH, -30.0, 30.0))
    if wp.randf(state) >= kept:
        return

    # The jitter may pull in a neighbour whose incidence is another: at edges the difference does not matter.
    value = z * (1.0 + s.scale) + s.bias
    if s.axial > 0.0:
        noise = wp.sqrt(1.0 - s.correlation) * normals(seed, 2 * i + 1, table)[0]
        if common.shape[0] > 0:
            noise += wp.sqrt(s.correlation) * common[i]
        value += s.axial * axial_sigma(z, incidence) * noise

    x = i % width
    y = i // width
    low = float(z)
    high = float(z)
    for row in range(wp.max(y - 1, 0), wp.min(y + 2, depth.shape[0] // width)):
        for column in range(wp.max(x - 1, 0), wp.min(x + 2, width)):
            beside = seen[row * width + column]
            if beside <= 0.0:
                beside = _NOTHING
            low = wp.min(low, beside)
            high = wp.max(high, beside)
    if high - low > s.edge_step:
        chance = wp.randf(state)
        weight = wp.randf(state)
        # Mixtures gather near the two surfaces: pull the weight towards the nearer end.
        weight = wp.where(weight < 0.5, 2.0 * weight * weight, 1.0 - 2.0 * (1.0 - weight) * (1.0 - weight))
        if chance < s.mixed and weight > 0.5:
            value = wp.where(high - low > _OUT_OF_PHASE, 0.0, low + weight * (high - low))
        if wp.randf(state) < s.edge_dropout:
            value = 0.0

    if value < s.minimum or value > s.maximum:
        return
    if s.quantum > 0.0:
        value = wp.rint(value / s.quantum) * s.quantum
    out[i] = value


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

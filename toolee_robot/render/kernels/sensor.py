"""Readings of a depth camera's pixels; see `render.sensors.depth_camera`."""

from __future__ import annotations

import warp as wp

from toolee_robot import depth_noise
from toolee_robot.render.kernels.filters import normals

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

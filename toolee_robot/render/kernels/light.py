"""Light at the points that rays hit: normals and albedo, lamps, reflected light."""

from __future__ import annotations

import warp as wp

from toolee_robot.render.kernels.surroundings import SKY_LEVELS, sky
from toolee_robot.render.kernels.texture import Surface, albedo

_LAST = wp.constant(SKY_LEVELS - 1)
_PI = wp.constant(3.14159265)


@wp.struct
class Lamp:
    """A lamp in the camera frame; see `scene.Light`.

    Attributes:
        place: Unit direction to a distant lamp, else its position [m].
        color: Linear RGB.
        far: 1 for a distant lamp, else 0.
        softness: As in `scene.Light`.
    """

    place: wp.vec3
    color: wp.vec3
    far: wp.int32
    softness: wp.float32


@wp.struct
class Towards:
    """The way from a point to a lamp.

    Attributes:
        direction: Unit direction.
        distance: Distance [m]; 1000 to a far lamp.
        power: Factor on the lamp's light from the distance.
    """

    direction: wp.vec3
    distance: wp.float32
    power: wp.float32


@wp.func
def column(rows: wp.array2d[wp.float32], i: wp.int32) -> wp.vec3:
    """Column of an array as a vector.

    Args:
        rows: The array, (3, N).
        i: Index of the column.

    Returns:
        The vector.
    """
    return wp.vec3(rows[0, i], rows[1, i], rows[2, i])


@wp.func
def towards(lamp: Lamp, point: wp.vec3) -> Towards:
    """The way from a point to a lamp.

    Args:
        lamp: The lamp.
        point: The point, camera frame [m].

    Returns:
        Direction, distance and power.
    """
    way = Towards()
    if lamp.far != 0:
        way.direction = lamp.place
        way.distance = 1e3
        way.power = 1.0
    else:
        to_lamp = lamp.place - point
        way.distance = wp.length(to_lamp)
        way.direction = to_lamp / way.distance
        nearest = wp.max(way.distance, 0.05)
        way.power = 1.0 / (nearest * nearest)
    return way


@wp.kernel(enable_backward=False)
def surfaces_hit(
    rays: wp.array2d[wp.float32],
    found: wp.array2d[wp.float32],
    ids: wp.array2d[wp.int32],
    first_face: wp.array[wp.int32],
    corner_normals: wp.array[wp.vec3],
    surfaces: wp.array[Surface],
    table: wp.array[wp.float32],
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    colors: wp.array[wp.vec3],
    cos_incidence: wp.array[wp.float32],
    shininess: wp.array[wp.float32],
):
    """Surface properties where rays hit.

    Where nothing is hit, cos_incidence and shininess are 0 and the other outputs undefined.

    Args:
        rays: Directions, camera frame, (3, N).
        found: `Found.values` of the rays, (6, N).
        ids: `Found.ids` of the rays, (2, N).
        first_face: Index of the first face of each body, (B,).
        corner_normals: Normals at the corners of all faces, body frames, (3 * F,).
        surfaces: Pose and material of each body, (B,).
        table: Noise table of the textures.
        points: Output: points, camera frame, (N,) [m].
        normals: Output: unit normals towards the camera, (N,).
        colors: Output: albedo, linear RGB, (N,).
        cos_incidence: Output: cosine of the angle between normal and ray, (N,).
        shininess: Output: shininess in [0, 1], (N,).
    """
    i = wp.tid()
    body = ids[1, i]
    if body < 0:
        cos_incidence[i] = 0.0
        shininess[i] = 0.0
        return
    s = surfaces[body]
    ray = column(rays, i)
    corner = 3 * (first_face[body] + ids[0, i])
    u = found[4, i]
    v = found[5, i]
    mixed = corner_normals[corner] * (1.0 - u - v) + corner_normals[corner + 1] * u + corner_normals[corner + 2] * v
    normal = wp.normalize(s.R * mixed)
    # Open or badly wound meshes show their backs: shade both sides alike.
    geometric = wp.vec3(found[1, i], found[2, i], found[3, i])
    if wp.dot(normal, geometric) * wp.dot(geometric, ray) > 0.0:
        normal = -normal
    point = ray * found[0, i]
    points[i] = point
    normals[i] = normal
    colors[i] = albedo(s, wp.transpose(s.R) * (point - s.p), table)
    cos_incidence[i] = wp.clamp(-wp.dot(normal, wp.normalize(ray)), 0.0, 1.0)
    shininess[i] = (1.0 - s.roughness) * (0.1 + 0.9 * s.metallic)


@wp.kernel(enable_backward=False)
def shade(
    rays: wp.array2d[wp.float32],
    ids: wp.array2d[wp.int32],
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    surfaces: wp.array[Surface],
    lamps: wp.array[Lamp],
    seen: wp.array2d[wp.float32],
    maps: wp.array[wp.vec3],
    R_world_camera: wp.mat33,
    background: wp.array[wp.vec3],
    pixels: wp.array[wp.int32],
    colors: wp.array[wp.vec3],
):
    """Colour that comes back along each ray from surroundings and lamps, Lambert plus GGX.

    GGX: Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces".

    Args:
        rays: Directions, camera frame, (3, N).
        ids: `Found.ids` of the rays, (2, N).
        points: Hits, camera frame, (N,) [m].
        normals: Unit normals there, (N,).
        surfaces: Pose and material of each body, (B,).
        lamps: The lamps, (L,).
        seen: Visible share of each lamp, (L, N).
        maps: Environment maps, see `surroundings.sky`.
        R_world_camera: Rotation of the camera in the world.
        background: Background of every pixel, linear RGB; empty for the surroundings themselves.
        pixels: Flat indices of the rays' pixels; empty where ray i belongs to pixel i.
        colors: Albedo, changed in place to linear RGB, (N,).
    """
    i = wp.tid()
    body = ids[1, i]
    v = -wp.normalize(column(rays, i))
    if body < 0:
        if background.shape[0] > 0:
            pixel = i
            if pixels.shape[0] > 0:
                pixel = pixels[i % pixels.shape[0]]
            colors[i] = background[pixel]
        else:
            colors[i] = sky(R_world_camera * -v, 0, maps)
        return
    roughness = surfaces[body].roughness
    metallic = surfaces[body].metallic
    n = normals[i]
    base = colors[i]
    cos = wp.dot(n, v)
    n_v = wp.clamp(cos, 1e-3, 1.0)
    f0 = wp.vec3(0.04 * (1.0 - metallic)) + base * metallic
    diffuse = base * (1.0 - metallic)
    mirror = 2.0 * n_v * n - v
    away = 1.0 - n_v
    glancing = away * away * away * away * away * (1.0 - roughness)
    level = wp.clamp(wp.int32(roughness * wp.float32(_LAST) + 0.5), 0, _LAST)
    color = wp.cw_mul(diffuse, sky(R_world_camera * n, _LAST, maps))
    color += wp.cw_mul(f0 + (wp.vec3(1.0) - f0) * glancing, sky(R_world_camera * mirror, level, maps))
    alpha = wp.max(roughness, 0.12) * wp.max(roughness, 0.12)
    a2 = alpha * alpha
    k = (roughness + 1.0) * (roughness + 1.0) / 8.0
    masked = 4.0 * (n_v * (1.0 - k) + k)
    for j in range(lamps.shape[0]):
        way = towards(lamps[j], points[i])
        l_n = wp.dot(way.direction, n)
        l_v = wp.dot(way.direction, v)
        n_l = wp.clamp(l_n, 0.0, 1.0)
        # The half vector's cosine without the vector.
        n_h = wp.clamp((l_n + cos) / wp.sqrt(wp.max(2.0 + 2.0 * l_v, 1e-12)), 0.0, 1.0)
        spread = n_h * n_h * (a2 - 1.0) + 1.0
        gloss = a2 / (_PI * spread * spread * (n_l * (1.0 - k) + k) * masked)
        reflected = diffuse + f0 * wp.min(_PI * gloss, 40.0 * _PI)
        color += wp.cw_mul(reflected, lamps[j].color) * (n_l * way.power * seen[j, i])
    colors[i] = color

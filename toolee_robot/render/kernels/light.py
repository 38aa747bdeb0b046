"""Light at the points that rays hit: normals and albedo, lamps, reflected light."""

from __future__ import annotations

import warp as wp

from toolee_robot.render.kernels.surroundings import SKY_LEVELS, Surface, albedo, sky

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

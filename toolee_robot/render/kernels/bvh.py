"""Ray tracing in Warp's bounding volume hierarchies: one of a scene's loose meshes, and one for each lasting mesh."""

from __future__ import annotations

import warp as wp

from toolee_robot.render.kernels.light import column

_FAR = wp.constant(wp.float32(1e6))


@wp.struct
class Instance:
    """A lasting mesh in a scene.

    Attributes:
        tree: Id of its `wp.Mesh`, body frame.
        R: Rotation of the body frame in the camera frame.
        p: Position of the body frame in the camera frame [m].
        centre: Centre of a sphere around the mesh, camera frame [m].
        radius: Radius of the sphere [m].
        body: Index of the mesh in the scene.
    """

    tree: wp.uint64
    R: wp.mat33
    p: wp.vec3
    centre: wp.vec3
    radius: wp.float32
    body: wp.int32


@wp.func
def near(origin: wp.vec3, direction: wp.vec3, reach: wp.float32, instance: Instance) -> wp.bool:
    """Whether a ray passes through the sphere around an instance.

    Args:
        origin: Origin of the ray, camera frame [m].
        direction: Direction of the ray, camera frame.
        reach: Length of the ray in lengths of its direction.
        instance: The instance.
    """
    to_centre = instance.centre - origin
    along = wp.clamp(wp.dot(to_centre, direction) / wp.dot(direction, direction), 0.0, reach)
    apart = to_centre - along * direction
    return wp.dot(apart, apart) <= instance.radius * instance.radius


@wp.kernel(enable_backward=False)
def closest(
    loose: wp.uint64,
    first_face: wp.array[wp.int32],
    bodies: wp.array[wp.int32],
    instances: wp.array[Instance],
    rays: wp.array2d[wp.float32],
    found: wp.array2d[wp.float32],
    ids: wp.array2d[wp.int32],
):
    """Find the first hits of rays from the origin; outputs as in `rays.Found`.

    Args:
        loose: Id of the tree of all loose meshes, camera frame; 0 for none.
        first_face: Index in that tree of the first face of each loose mesh, (B + 1,).
        bodies: Indices of the loose meshes in the scene, (B,).
        instances: The lasting meshes.
        rays: Directions, camera frame, (3, N).
        found: Output `Found.values`, (6, N).
        ids: Output `Found.ids`, (2, N).
    """
    i = wp.tid()
    ray = column(rays, i)
    reach = wp.float32(_FAR)
    body = wp.int32(-1)
    face = wp.int32(0)
    u = wp.float32(0.0)
    v = wp.float32(0.0)
    normal = wp.vec3(0.0)
    if loose != wp.uint64(0):
        query = wp.mesh_query_ray(loose, wp.vec3(0.0), ray, reach)
        if query.result:
            reach = query.t
            u = query.u
            v = query.v
            normal = query.normal
            # The last mesh that begins at the face or before it.
            low = wp.int32(0)
            high = first_face.shape[0] - 1
            while high - low > 1:
                middle = (low + high) // 2
                if first_face[middle] <= query.face:
                    low = middle
                else:
                    high = middle
            body = bodies[low]
            face = query.face - first_face[low]
    for k in range(instances.shape[0]):
        instance = instances[k]
        if near(wp.vec3(0.0), ray, reach, instance):
            to_body = wp.transpose(instance.R)
            hit = wp.mesh_query_ray(instance.tree, -(to_body * instance.p), to_body * ray, reach)
            if hit.result:
                reach = hit.t
                u = hit.u
                v = hit.v
                normal = instance.R * hit.normal
                body = instance.body
                face = hit.face
    ids[0, i] = face
    ids[1, i] = body
    found[0, i] = wp.where(body >= 0, reach, 0.0)
    for k in range(3):
        found[1 + k, i] = normal[k]
    # Warp weighs the first two corners.
    found[4, i] = v
    found[5, i] = 1.0 - u - v


@wp.kernel(enable_backward=False)
def blocked(
    loose: wp.uint64,
    instances: wp.array[Instance],
    origins: wp.array2d[wp.float32],
    directions: wp.array2d[wp.float32],
    reach: wp.array[wp.float32],
    out: wp.array[wp.uint8],
):
    """Check whether anything lies on rays; one thread per ray.

    Args:
        loose: Id of the tree of all loose meshes, camera frame; 0 for none.
        instances: The lasting meshes.
        origins: Origins, camera frame, (3, N) [m].
        directions: Directions, camera frame, (3, N).
        reach: Lengths of the rays in lengths of their directions, (N,); a ray without a positive one is not cast.
        out: Output: 1 where something is hit, else 0, (N,).
    """
    i = wp.tid()
    out[i] = wp.uint8(0)
    if reach[i] <= 0.0:
        return
    origin = column(origins, i)
    direction = column(directions, i)
    if loose != wp.uint64(0) and wp.mesh_query_ray_anyhit(loose, origin, direction, reach[i]):
        out[i] = wp.uint8(1)
        return
    for k in range(instances.shape[0]):
        instance = instances[k]
        if near(origin, direction, reach[i], instance):
            to_body = wp.transpose(instance.R)
            start = to_body * (origin - instance.p)
            if wp.mesh_query_ray_anyhit(instance.tree, start, to_body * direction, reach[i]):
                out[i] = wp.uint8(1)
                return

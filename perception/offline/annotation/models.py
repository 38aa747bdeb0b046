"""Models of what is clicked: a shaft's axis with its tip; and what lies on a plane: face, ring, open jaw, claw.

The plane is the surface that is seen. Its parameters are two tilts against the normal of the start, the depth at a
pixel, and the depths' common error; then come what the caliper measures, and the model's own points.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from toolee_robot.errors import UserError
from toolee_robot.frames import Array, angle_between, cross, frame_from_axes
from toolee_robot.perception.offline.annotation.clicks import Role, Shape
from toolee_robot.perception.offline.annotation.fit import Fit, Rows
from toolee_robot.perception.offline.annotation.measurements import (
    CALIPER,
    CLICK,
    Measurement,
    Measurements,
    depth_sigma,
    noise_factor,
)

INSIDE, INSIDE_SIGMA = 0.85, 0.15
"""How far the axis lies behind the depth that is measured about a click, as a share of the radius: 1 on the shaft's
front line, less over its width."""
END_ON = np.deg2rad(10.0)
"""Angle between shaft and ray below which the shaft is seen end-on [rad]."""
THINNEST = 4.0
"""Width of a shaft below which its depth is not told from that of what lies behind [px]."""
_AXIS_Z, _AXIS_BIAS, _RADIUS, _INSIDE = range(2, 6)
_AXIS_TILT = [6, 7]
"""Places of the parameters; before them are the two of the pixel."""


class AxisModel:
    """The axis of a shaft and its tip.

    Args:
        measured: The clicks.

    Attributes:
        rows: What the residuals are.
        free_spin: True: a shaft is round.

    Raises:
        UserError: The shaft's clicks are one point, or it points at the camera.
    """

    free_spin = True

    def __init__(self, measured: Measurements) -> None:
        self._m = measured
        self._shaft, self._tip = measured.of(Role.SHAFT), measured.of(Role.TIP)
        points = np.stack([measured.point(m) for m in self._shaft])
        tip = np.mean([m.pixel for m in self._tip], axis=0)
        away = np.linalg.norm([m.pixel - tip for m in self._shaft], axis=1)
        near, far = points[np.argmin(away)], points[np.argmax(away)]
        if np.linalg.norm(far - near) < 0.005:
            raise UserError("the clicks on the shaft are one point: spread them along it", code="user.clicks_missing")
        self._direction = (near - far) / np.linalg.norm(near - far)
        sight = angle_between(self._direction, measured.rays(tip))
        if min(sight, np.pi - sight) < END_ON:
            raise UserError(
                "the shaft points at the camera, so its axis does not show: leave this end out",
                code="user.too_oblique",
            )
        pixels = self._diameter * measured.camera.fx / float(np.median(points[:, 2]))
        if pixels < THINNEST:
            raise UserError(
                f"the shaft is {pixels:.1f} pixels wide, too thin for this camera's depth, which mixes it with the "
                f"background. Photograph it from nearer, so that it has {THINNEST:g}",
                code="user.too_thin",
            )
        self._across = np.linalg.svd(self._direction[None])[2][1:]
        ray = measured.rays(tip)
        # The tip's depth: where its ray passes nearest to the line through the shaft's clicks.
        A = np.stack([ray, -self._direction], 1)
        z = float(np.linalg.lstsq(A, near, rcond=None)[0][0])
        self._begin = np.array([*tip, z, 0.0, 0.5 * self._diameter, INSIDE, 0.0, 0.0])
        owner, sigma, in_pixels = [-1, -1, -1], [measured.bias, INSIDE_SIGMA, CALIPER], [False] * 3
        for m in self._tip:
            owner += [m.number] * 2
            sigma += [CLICK] * 2
            in_pixels += [True] * 2
        incidence = np.pi / 2 - min(sight, np.pi - sight)
        noise = noise_factor([m.depth for m in self._shaft if m.depth is not None], incidence)
        for m in self._shaft:
            assert m.depth is not None
            owner += [m.number] * 2
            sigma += [CLICK, depth_sigma(m.depth, incidence, m.share, noise)]
            in_pixels += [True, False]
        self.rows = Rows(np.array(owner), np.array(sigma), np.array(in_pixels))

    @property
    def _diameter(self) -> float:
        assert self._m.caliper is not None  # the protocol asks for it
        return self._m.caliper

    def start(self) -> Array:
        """Parameters to begin with."""
        return self._begin.copy()

    def residuals(self, parameters: Array) -> Array:
        """Residuals, in the order of `rows`."""
        p, m = parameters, self._m
        tip, d = m.rays(p[:2]) * p[_AXIS_Z], self._axis(p)
        found = [p[_AXIS_BIAS], p[_INSIDE] - INSIDE, 2 * p[_RADIUS] - self._diameter]
        for click in self._tip:
            found += [*(p[:2] - click.pixel)]
        # The axis's image: its direction is that of a point a little behind the tip.
        back = m.camera.project(tip - 0.02 * d) - p[:2]
        normal = np.array([-back[1], back[0]]) / np.linalg.norm(back)
        for click in self._shaft:
            assert click.depth is not None
            ray = m.rays(click.depth.pixel)
            # The point of the axis that the ray passes nearest to, and the surface before it.
            (z, _), *_ = np.linalg.lstsq(np.stack([ray, d], 1), tip, rcond=None)
            sine = np.linalg.norm(np.cross(ray / np.linalg.norm(ray), d))
            surface = z - p[_INSIDE] * p[_RADIUS] / sine / np.linalg.norm(ray)
            found += [normal @ (click.pixel - p[:2]), surface + p[_AXIS_BIAS] - click.depth.z]
        return np.array(found)

    def pose(self, parameters: Array) -> Array:
        """X_camera_ee, (4, 4)."""
        tip = self._m.rays(parameters[:2]) * parameters[_AXIS_Z]
        return frame_from_axes(z=self._axis(parameters), x=self._across[0], p=tip)

    def _axis(self, p: Array) -> Array:
        d = self._direction + self._across.T @ p[_AXIS_TILT]
        return d / np.linalg.norm(d)


STEEPEST = np.deg2rad(80.0)
"""Angle between ray and normal beyond which a plane's tilt and edge are not told from a photograph [rad]."""
HANDLE = 0.005
"""Standard deviation of a click on the handle about the handle's axis [m]."""
_PROBE = 0.01
"""Distance at which the circle's slope in the image is measured [px]."""
_A, _B, _Z, _BIAS, _SIZE = range(5)
_PLANE = 5
"""Number of the parameters that all models have."""


class PlaneModel:
    """A plane, what the caliper measured, points on the plane or near it, a circle, and the handle.

    Args:
        shape: FACE, RING, OPEN_JAW or CLAW.
        measured: The clicks.

    Attributes:
        rows: What the residuals are.
        free_spin: Whether the handle is not clicked.

    Raises:
        UserError: The surface is seen too obliquely, or its clicks lie on one line.
    """

    def __init__(self, shape: Shape, measured: Measurements) -> None:
        self._shape, self._m = shape, measured
        self._surface, self._rim = measured.of(Role.SURFACE), measured.of(Role.RIM)
        self._points = [r for r in (Role.THROAT, Role.END_A, Role.END_B) if measured.of(r)]
        self._deep = shape is Shape.CLAW
        self._handle = measured.of(Role.HANDLE)
        if self._rim:
            pixels = np.stack([m.pixel for m in self._rim])
            self._probes = np.stack([pixels, *(pixels + s * _PROBE * e for s in (1, -1) for e in np.eye(2))])
        self.free_spin = not self._handle
        self._normal, through = _first_plane(np.stack([measured.point(m) for m in self._surface]))
        self._across = np.linalg.svd(self._normal[None])[2][1:]
        self._reference = measured.camera.project(through)
        self._depth = float(through[2])
        middle = self._incidence(self._surface[0])
        self._noise = noise_factor([m.depth for m in self._surface if m.depth is not None], middle)
        self.rows = self._rows()

    def start(self) -> Array:
        """Parameters to begin with."""
        size = self._m.caliper
        if self._shape is Shape.FACE:
            size = None if size is None else 0.5 * size
        begin = [0.0, 0.0, self._depth, 0.0, 0.0 if size is None else size]
        if self._rim:
            pixels = np.stack([m.pixel for m in self._rim])
            centre = 0.5 * (np.median(pixels, axis=0) + pixels.mean(axis=0))
            on_plane = self._on_plane(np.array([*begin, *centre]), np.vstack([pixels, centre]))
            radius = float(np.median(np.linalg.norm(on_plane[:-1] - on_plane[-1], axis=1)))
            if self._shape is Shape.FACE and size is None:
                begin[_SIZE] = radius
            begin += [*centre]
            begin += [radius] if self._shape is Shape.RING else []
        for role in self._points:
            clicks = self._m.of(role)
            begin += [*np.mean([m.pixel for m in clicks], axis=0)]
            if self._deep:
                begin.append(float(np.median([m.depth.z for m in clicks if m.depth is not None])))
        for m in self._handle[:1]:
            assert m.depth is not None
            begin += [*m.pixel, m.depth.z]
        return np.array(begin)

    def residuals(self, parameters: Array) -> Array:
        """Residuals, in the order of `rows`."""
        p, found = parameters, [parameters[_BIAS : _BIAS + 1]]
        pixels = np.stack([m.depth.pixel for m in self._surface if m.depth is not None])
        z = np.array([m.depth.z for m in self._surface if m.depth is not None])
        found.append(self._on_plane(p, pixels)[:, 2] + p[_BIAS] - z)
        if self._m.caliper is not None:
            size = 2.0 * p[_SIZE] if self._shape is Shape.FACE else p[_SIZE]
            found.append(np.array([size - self._m.caliper]))
        if self._rim:
            found.append(self._rim_residuals(p))
        for k, role in enumerate(self._points):
            at = self._point_at(k)
            for m in self._m.of(role):
                found.append(p[at : at + 2] - m.pixel)
                if self._deep and m.depth is not None:
                    # An edge's depth is that of pixels beside it, on a surface about parallel to the plane.
                    beside = self._on_plane(p, m.depth.pixel)[2] / self._on_plane(p, p[at : at + 2])[2]
                    found.append(np.array([p[at + 2] * beside + p[_BIAS] - m.depth.z]))
        for m in self._handle:
            assert m.depth is not None
            found += [p[-3:-1] - m.pixel, np.array([p[-1] + p[_BIAS] - m.depth.z])]
        return np.concatenate(found)

    def pose(self, parameters: Array) -> Array:
        """X_camera_ee, (4, 4)."""
        p = parameters
        z = self._plane_normal(p)
        if self._shape in (Shape.FACE, Shape.RING):
            origin, x = self._on_plane(p, p[_PLANE : _PLANE + 2]), self._across[0]
        else:
            throat, a, b = self._three_points(p)
            middle = 0.5 * (a + b)
            x = middle - throat
            if self._shape is Shape.CLAW:
                origin = 0.5 * (throat + middle)
                origin = origin - z * (z @ (origin - self._on_plane(p, self._reference)))
            else:
                along = x / np.linalg.norm(x)
                origin = throat + 0.5 * along * min(along @ (a - throat), along @ (b - throat))
        if self._shape is not Shape.FACE:
            origin = origin - 0.5 * p[_SIZE] * z
        if self._handle:
            handle = self._m.rays(p[-3:-1]) * p[-1]
            if self._shape is Shape.CLAW:
                z = -z if z @ (handle - origin) > 0 else z
            else:
                x = handle - origin
        return frame_from_axes(z=z, x=x, p=origin)

    def diameter(self, found: Fit) -> tuple[float, float]:
        """Diameter of a face, and its standard deviation [m]."""
        return 2.0 * float(found.parameters[_SIZE]), 2.0 * float(found.parameter_sigma[_SIZE])

    def circle(self, parameters: Array, steps: int = 48) -> Array | None:
        """The fitted circle.

        Args:
            parameters: The fitted parameters, (P,).
            steps: Number of points.

        Returns:
            Its points, (steps, 3) [m], camera frame; None where the model has none.
        """
        if not self._rim:
            return None
        p = parameters
        n, centre = self._plane_normal(p), self._on_plane(p, p[_PLANE : _PLANE + 2])
        e = self._across[0] - n * (n @ self._across[0])
        e /= np.linalg.norm(e)
        t = np.linspace(0.0, 2 * np.pi, steps, endpoint=False)[:, None]
        return centre + self._radius(p) * (np.cos(t) * e + np.sin(t) * cross(n, e))

    def _rows(self) -> Rows:
        owner, sigma, pixels = [-1], [self._m.bias], [False]

        def add(click: int, s: float, in_pixels: bool = False) -> None:
            owner.append(click)
            sigma.append(s)
            pixels.append(in_pixels)

        for m in self._surface:
            add(m.number, self._depth_sigma(m, self._incidence(m)))
        if self._m.caliper is not None:
            add(-1, CALIPER)
        for m in self._rim:
            add(m.number, CLICK, True)
        for role in self._points:
            for m in self._m.of(role):
                add(m.number, CLICK, True)
                add(m.number, CLICK, True)
                if self._deep:
                    add(m.number, self._depth_sigma(m, self._incidence(m)))
        for m in self._handle:
            assert m.depth is not None
            across = float(np.hypot(CLICK, HANDLE * self._m.camera.fx / m.depth.z))
            add(m.number, across, True)
            add(m.number, across, True)
            add(m.number, float(np.hypot(self._depth_sigma(m, 0.0), HANDLE)))
        return Rows(np.array(owner), np.array(sigma), np.array(pixels))

    def _incidence(self, m: Measurement) -> float:
        angle = angle_between(self._normal, -self._m.rays(m.pixel))
        if angle > STEEPEST:
            raise UserError(
                f"the surface is seen at {np.rad2deg(angle):.0f} degrees from its normal, too flat for a pose. "
                "Leave this end effector out, or undo a wrong click on the surface",
                code="user.too_oblique",
            )
        return angle

    def _depth_sigma(self, m: Measurement, incidence: float) -> float:
        assert m.depth is not None
        return depth_sigma(m.depth, incidence, m.share, self._noise)

    def _plane_normal(self, p: Array) -> Array:
        n = self._normal + self._across.T @ p[[_A, _B]]
        return n / np.linalg.norm(n)

    def _on_plane(self, p: Array, pixels: Array) -> Array:
        """Where rays through pixels (..., 2) meet the plane, (..., 3) [m]."""
        n, rays = self._plane_normal(p), self._m.rays(pixels)
        return rays * ((n @ self._m.rays(self._reference)) * p[_Z] / (rays @ n))[..., None]

    def _radius(self, p: Array) -> float:
        return float(p[_SIZE] if self._shape is Shape.FACE else p[_PLANE + 2])

    def _rim_residuals(self, p: Array) -> Array:
        """Distances of the rim's clicks from the projected circle [px], to the first order (Sampson)."""
        centre = self._on_plane(p, p[_PLANE : _PLANE + 2])
        distances = np.linalg.norm(self._on_plane(p, self._probes) - centre, axis=-1)
        slopes = (distances[1:3] - distances[3:]) / (2 * _PROBE)
        return (distances[0] - self._radius(p)) / np.maximum(np.hypot(*slopes), 1e-9)

    def _point_at(self, k: int) -> int:
        return _PLANE + k * (3 if self._deep else 2)

    def _three_points(self, p: Array) -> list[Array]:
        found = []
        for k in range(3):
            at = self._point_at(k)
            pixel = p[at : at + 2]
            found.append(self._m.rays(pixel) * p[at + 2] if self._deep else self._on_plane(p, pixel))
        return found


def _first_plane(points: Array) -> tuple[Array, Array]:
    """Normal towards the camera (3,), and a point (3,) [m], of the plane through three points that suits most."""
    best, found = np.inf, None
    for three in combinations(points, 3):
        n = cross(three[1] - three[0], three[2] - three[0])
        size = float(np.linalg.norm(n))
        longest = max(float(np.linalg.norm(three[i] - three[i - 1])) for i in range(3))
        if size < 0.05 * longest**2:
            continue
        n /= size
        spread = float(np.median(np.abs((points - three[0]) @ n)) + 1e-3 * 1e-3 / np.sqrt(size))
        if spread < best:
            best, found = spread, (n, np.mean(three, axis=0))
    if found is None:
        raise UserError("the clicks on the surface lie on one line: spread them", code="user.clicks_missing")
    n, through = found
    return (n if n @ through < 0 else -n), through

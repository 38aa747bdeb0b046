"""Model of a screwdriver's tip: a shaft's axis, and the point on it where the tip ends."""

from __future__ import annotations

import numpy as np

from toolee_robot.errors import UserError
from toolee_robot.frames import Array, angle_between, frame_from_axes
from toolee_robot.perception.offline.annotation.clicks import Role
from toolee_robot.perception.offline.annotation.fit import Rows
from toolee_robot.perception.offline.annotation.measurements import (
    CALIPER,
    CLICK,
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
_U, _V, _Z, _BIAS, _RADIUS, _INSIDE, _A, _B = range(8)


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
                "the shaft points at the camera, so that its axis does not show: leave this end out",
                code="user.too_oblique",
            )
        pixels = self._diameter * measured.camera.fx / float(np.median(points[:, 2]))
        if pixels < THINNEST:
            raise UserError(
                f"the shaft is {pixels:.1f} pixels wide, too thin for this camera's depth, which is mixed with what "
                f"lies behind: photograph it from nearer, so that it has {THINNEST:g}",
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
        tip, d = m.rays(p[:2]) * p[_Z], self._axis(p)
        found = [p[_BIAS], p[_INSIDE] - INSIDE, 2 * p[_RADIUS] - self._diameter]
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
            found += [normal @ (click.pixel - p[:2]), surface + p[_BIAS] - click.depth.z]
        return np.array(found)

    def pose(self, parameters: Array) -> Array:
        """X_camera_ee, (4, 4)."""
        tip = self._m.rays(parameters[:2]) * parameters[_Z]
        return frame_from_axes(z=self._axis(parameters), x=self._across[0], p=tip)

    def _axis(self, p: Array) -> Array:
        d = self._direction + self._across.T @ p[[_A, _B]]
        return d / np.linalg.norm(d)

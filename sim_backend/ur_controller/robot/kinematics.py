"""Forward and inverse kinematics of the UR family from its DH parameters, in the controller's own base frame.

The controller's base is `base` rotated by pi about z. Closed forms: Hawkins, "Analytic Inverse Kinematics for
the Universal Robots UR-5/UR-10 Arms" (2013), in the three-parallel-axes form: shoulder, wrist, then the planar elbow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import acos, asin, atan2, cos, hypot, pi, sin

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel
from toolee_robot.sim_backend.ur_controller.robot.poses import Vector

WRIST_SINGULAR = 1e-9  # |sin q5| below which axes 4 and 6 count as parallel
STRETCH = 1e-9  # rounding error by which a cosine may exceed 1


@dataclass(frozen=True)
class Chain:
    """Geometry of the arm in one configuration, in the controller's base.

    Attributes:
        axes: Unit vectors of the joint axes, (6, 3).
        origins: A point on each axis, then the flange's origin, (7, 3) [m].
        X_base_flange: Pose of the flange, 4x4.
    """

    axes: Array
    origins: Array
    X_base_flange: Array

    @cached_property
    def flange_jacobian(self) -> Array:
        """Jacobian of the flange's origin, see `jacobian`."""
        return self.jacobian(self.origins[6])

    def jacobian(self, tip: Array) -> Array:
        """Jacobian of a point that is fixed to the flange.

        Args:
            tip: The point, (3,) [m].

        Returns:
            Matrix (6, 6) from joint velocities to linear, then angular velocity.
        """
        arm = tip - self.origins[:6]
        J = np.empty((6, 6))
        a, r = self.axes, arm
        J[0] = a[:, 1] * r[:, 2] - a[:, 2] * r[:, 1]
        J[1] = a[:, 2] * r[:, 0] - a[:, 0] * r[:, 2]
        J[2] = a[:, 0] * r[:, 1] - a[:, 1] * r[:, 0]
        J[3:] = a.T
        return J


def chain(model: ControllerModel, q: Vector) -> Chain:
    """Forward kinematics of all links.

    Args:
        model: The robot's model.
        q: Joint positions, (6,) [rad].

    Returns:
        The geometry of the arm.
    """
    _, a2, a3 = model.a[:3]
    d1, d4, d5, d6 = model.d[0], model.d[3], model.d[4], model.d[5]
    q1, q2, q3, q4, q5, q6 = (float(angle) for angle in q)
    s1, c1 = sin(q1), cos(q1)
    s2, c2 = sin(q2), cos(q2)
    s23, c23 = sin(q2 + q3), cos(q2 + q3)
    s234, c234 = sin(q2 + q3 + q4), cos(q2 + q3 + q4)
    s5, c5, s6, c6 = sin(q5), cos(q5), sin(q6), cos(q6)
    # z1: axes 2, 3 and 4; z4: axis 5; z5: axis 6. x4 and y4 = z1 span frame 4 with z4.
    z4 = (c1 * s234, s1 * s234, -c234)
    x4 = (c1 * c234, s1 * c234, s234)
    z5 = (-s5 * x4[0] + c5 * s1, -s5 * x4[1] - c5 * c1, -s5 * x4[2])
    x5 = (c5 * x4[0] + s5 * s1, c5 * x4[1] - s5 * c1, c5 * x4[2])
    p2 = (a2 * c1 * c2, a2 * s1 * c2, d1 + a2 * s2)
    p3 = (p2[0] + a3 * c1 * c23, p2[1] + a3 * s1 * c23, p2[2] + a3 * s23)
    p4 = (p3[0] + d4 * s1, p3[1] - d4 * c1, p3[2])
    p5 = (p4[0] + d5 * z4[0], p4[1] + d5 * z4[1], p4[2] + d5 * z4[2])
    p6 = (p5[0] + d6 * z5[0], p5[1] + d6 * z5[1], p5[2] + d6 * z5[2])
    X = np.array(
        [
            [c6 * x5[0] - s6 * z4[0], -s6 * x5[0] - c6 * z4[0], z5[0], p6[0]],
            [c6 * x5[1] - s6 * z4[1], -s6 * x5[1] - c6 * z4[1], z5[1], p6[1]],
            [c6 * x5[2] - s6 * z4[2], -s6 * x5[2] - c6 * z4[2], z5[2], p6[2]],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    z1 = (s1, -c1, 0.0)
    axes = np.array([(0.0, 0.0, 1.0), z1, z1, z1, z4, z5])
    return Chain(axes, np.array([(0.0, 0.0, 0.0), (0.0, 0.0, d1), p2, p3, p4, p5, p6]), X)


def forward(model: ControllerModel, q: Vector) -> Array:
    """Forward kinematics.

    Args:
        model: Model of the controller's arm.
        q: Joint positions, (6,) [rad].

    Returns:
        X_base_flange, (4, 4).
    """
    return chain(model, q).X_base_flange


def inverse_all(model: ControllerModel, X_base_flange: Array, near: Vector) -> list[list[float]]:
    """All solutions of the inverse kinematics, up to eight.

    If axes 4 and 6 are parallel, the last joint stays at `near`.

    Args:
        model: The robot's model.
        X_base_flange: Pose of the flange, 4x4.
        near: Reference joint positions, (6,) [rad].

    Returns:
        Joint positions, (6,) [rad] each; every angle is the full turn nearest to `near` within the limits.
    """
    _, a2, a3 = model.a[:3]
    d1, d4, d5, d6 = model.d[0], model.d[3], model.d[4], model.d[5]
    x6, y6, z6, p6 = (X_base_flange[:3, i].tolist() for i in range(4))
    px, py, pz = p6[0] - d6 * z6[0], p6[1] - d6 * z6[1], p6[2] - d6 * z6[2]
    radius = hypot(px, py)
    if radius * (1 + STRETCH) < d4:
        return []
    found = []
    offset = asin(min(d4 / radius, 1.0))
    for q1 in (atan2(py, px) + offset, atan2(py, px) + pi - offset):
        s1, c1 = sin(q1), cos(q1)
        x6_z1, y6_z1, z6_z1 = (v[0] * s1 - v[1] * c1 for v in (x6, y6, z6))
        s5 = hypot(x6_z1, y6_z1)
        for sign in (1.0, -1.0):
            q5 = atan2(sign * s5, z6_z1)
            q6 = atan2(-sign * y6_z1, sign * x6_z1) if s5 > WRIST_SINGULAR else float(near[5])
            s6, c6 = sin(q6), cos(q6)
            z4 = [-s6 * x - c6 * y for x, y in zip(x6, y6, strict=True)]
            q234 = atan2(z4[0] * c1 + z4[1] * s1, -z4[2])
            x = (px - d5 * z4[0]) * c1 + (py - d5 * z4[1]) * s1
            y = pz - d5 * z4[2] - d1
            c3 = (x * x + y * y - a2 * a2 - a3 * a3) / (2 * a2 * a3)
            if abs(c3) > 1.0 + STRETCH:
                continue
            bend = acos(max(-1.0, min(1.0, c3)))
            for q3 in (bend, -bend):
                q2 = atan2(y, x) - atan2(a3 * sin(q3), a2 + a3 * cos(q3))
                q = _near_turn(model, [q1, q2, q3, q234 - q2 - q3, q5, q6], near)
                if q is not None:
                    found.append(q)
    return found


def inverse(model: ControllerModel, X_base_flange: Array, near: Vector) -> list[float] | None:
    """The solution of the inverse kinematics that is nearest to a reference.

    Args:
        model: The robot's model.
        X_base_flange: Pose of the flange, 4x4.
        near: Reference joint positions, (6,) [rad].

    Returns:
        Joint positions, (6,) [rad], or None out of reach.
    """
    found = inverse_all(model, X_base_flange, near)
    if not found:
        return None
    return min(found, key=lambda q: sum((a - b) ** 2 for a, b in zip(q, near, strict=True)))


def _near_turn(model: ControllerModel, q: list[float], near: Vector) -> list[float] | None:
    turned = []
    for angle, reference, limit in zip(q, near, model.position, strict=True):
        angle += 2 * pi * round((float(reference) - angle) / (2 * pi))
        if angle > limit:
            angle -= 2 * pi
        elif angle < -limit:
            angle += 2 * pi
        if abs(angle) > limit:
            return None
        turned.append(angle)
    return turned

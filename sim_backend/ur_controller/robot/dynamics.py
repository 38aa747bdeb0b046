"""Rigid-body dynamics of the arm's set-point: joint torques, momentum.

Masses and centres of mass of the links: Universal Robots, "DH parameters for calculations of kinematics and dynamics",
in the links' Denavit-Hartenberg frames. The links are point masses there: the same page gives these arms no inertia
matrices. Rotors, gears and friction are not known and left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

import numpy as np

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.robot.kinematics import Chain, chain
from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel
from toolee_robot.types import ArmModel

UPRIGHT = np.array([0.0, 0.0, 9.82])
"""Acceleration of an upright base that is equivalent to gravity, as the controller has it, (3,) [m/s^2]."""


_NEXT, _LAST = np.array((1, 2, 0)), np.array((2, 0, 1))
# A link's centre is its frame's origin and two steps along axes of that frame [m], (6, 1) each.
_COM = np.array(ARM_DATA[ArmModel.UR10].link_center_of_mass)  # and of the UR10e
_FIRST = np.array([[_COM[0, 0]], [_COM[1, 0]], [_COM[2, 0]], [_COM[3, 1]], [_COM[4, 2]], [_COM[5, 2]]])
_SECOND = np.array([[_COM[0, 2]], [_COM[1, 2]], [_COM[2, 2]], [_COM[3, 2]], [-_COM[4, 1]], [0.0]])


@dataclass(frozen=True)
class Dynamics:
    """Result of one tick.

    Attributes:
        torques: Joint torques of the set-point's motion, gravity included, (6,) [Nm].
        acceleration: The part that accelerates the arm, (6,) [Nm].
        momentum: Momentum of arm and payload, (3,) [kg m/s], base axes.
        links: Geometry of the arm at the set-point.
    """

    torques: Array
    acceleration: Array
    momentum: Array
    links: Chain


class ArmDynamics:
    """Dynamics of a set-point from one tick to the next.

    Args:
        model: The robot's model.
    """

    def __init__(self, model: ControllerModel) -> None:
        self._masses = np.array([*ARM_DATA[ArmModel(model.name)].link_mass, 0.0])
        self._poses: Array | None = None  # of the flange, in this tick, the last, and the one before
        self._links = np.empty(0)  # centres of the links, likewise

    def step(self, model: ControllerModel, q: Array, payload: float, cog: Array, gravity: Array, dt: float) -> Dynamics:
        """Advance by one tick.

        Args:
            model: The robot's model, with its DH parameters.
            q: Set-point, (6,) [rad].
            payload: Mass at the flange [kg].
            cog: Its centre of gravity, flange frame, (3,) [m].
            gravity: Acceleration of the base that is equivalent to gravity, (3,) [m/s^2].
            dt: Length of the tick [s].

        Returns:
            Torques and momentum.
        """
        links = chain(model, q)
        masses = self._masses
        masses[6] = payload
        fresh = self._poses is None
        if self._poses is None:
            self._poses, self._links = np.empty((3, 4, 4)), np.empty((3, 6, 3))
        self._poses[1:], self._links[1:] = self._poses[:-1].copy(), self._links[:-1].copy()
        self._poses[0], self._links[0] = links.X_base_flange, _centres(q, links)
        if fresh:
            self._poses[1:], self._links[1:] = self._poses[0], self._links[0]
        centres = np.empty((3, 7, 3))
        centres[:, :6] = self._links
        # A payload that is set anew has not moved there: its present centre is taken in all three ticks.
        centres[:, 6] = self._poses[:, :3, :3] @ cog + self._poses[:, :3, 3]
        momentum = masses.dot(centres[0] - centres[1]) / dt
        forces = np.empty((2, 7, 3))
        forces[0] = masses[:, None] * (centres[0] - 2.0 * centres[1] + centres[2]) / (dt * dt)
        forces[1] = masses[:, None] * gravity
        moving, static = _torques(links, centres[0], forces)
        return Dynamics(static + moving, moving, momentum, links)


def _centres(q: Array, links: Chain) -> Array:
    """Centres of mass of the six links in the base, (6, 3) [m]."""
    q1, a2, q3 = (float(angle) for angle in q[:3])
    s1, c1, a3 = sin(q1), cos(q1), a2 + q3
    z1, z4, z5 = links.axes[1], links.axes[4], links.axes[5]
    x1 = (c1, s1, 0.0)
    x2 = (c1 * cos(a2), s1 * cos(a2), sin(a2))
    x3 = (c1 * cos(a3), s1 * cos(a3), sin(a3))
    # y of frame 4 is z1, of frame 5 it is -z4.
    first, second = np.array((x1, x2, x3, z1, z5, z5)), np.array((z1, z1, z1, z4, z4, z5))
    return links.origins[1:] + _FIRST * first + _SECOND * second


def _torques(links: Chain, centres: Array, forces: Array) -> Array:
    """Torques of the joints that exert forces (n, 7, 3) [N] on the masses; joint i carries those from i on. (n, 6)."""
    both = np.concatenate((forces, cross_rows(centres, forces)), axis=-1)
    carried = both[:, ::-1].cumsum(axis=1)[:, :0:-1]
    torque = carried[..., 3:] - cross_rows(links.origins[:6], carried[..., :3])
    return np.asarray((torque * links.axes).sum(axis=-1))


def cross_rows(a: Array, b: Array) -> Array:
    """Cross products of rows; numpy's own is slow for so few.

    Args:
        a: Left factors, (..., 3).
        b: Right factors, (..., 3).

    Returns:
        The products, (..., 3).
    """
    # `take` copies the same elements as an index does, in half of the time.
    return a.take(_NEXT, -1) * b.take(_LAST, -1) - a.take(_LAST, -1) * b.take(_NEXT, -1)

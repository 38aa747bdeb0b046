"""The interface between the controller stand-in and the physics that it controls."""

from __future__ import annotations

from typing import Protocol

from toolee_robot.frames import Array


class Plant(Protocol):
    """Six joints that follow set-points.

    Attributes:
        external_force: Additional wrench at the flange's origin, (6,) [N, Nm], axes of the controller's base; for
            faults and for pushing the arm by hand.
    """

    external_force: Array

    @property
    def q(self) -> Array:
        """Measured joint positions, (6,) [rad]."""

    @property
    def qd(self) -> Array:
        """Measured joint velocities, (6,) [rad/s]."""

    @property
    def wrench(self) -> Array:
        """Wrench of the environment at the flange's origin, (6,) [N, Nm], axes of the controller's base.

        Compensated for the payload's weight and inertia.
        """

    def command(self, q: Array, qd: Array) -> None:
        """Set the set-point that is due at the end of the next `step`.

        Args:
            q: Joint positions, (6,) [rad].
            qd: Joint velocities, (6,) [rad/s].
        """

    def step(self, dt: float) -> None:
        """Advance by dt [s]."""

    def set_payload(self, mass: float, cog: Array) -> None:
        """Set the payload to compensate.

        Args:
            mass: Mass [kg].
            cog: Centre of gravity, flange frame, (3,) [m].
        """

"""What moves when the controller commands: the contract between the controller stand-in and the physics behind it."""

from __future__ import annotations

from typing import Protocol

from toolee_robot.frames import Array


class Plant(Protocol):
    """Six joints that follow set-points.

    q [rad], qd [rad/s], both (6,): measured. wrench (6,) [N, Nm]: what the environment puts on the flange, at the
    flange's origin, in the axes of the controller's base, payload's weight and inertia compensated.
    external_force (6,) [N, Nm], same point and axes: an extra wrench for faults and for pushing the arm by hand.
    """

    external_force: Array

    @property
    def q(self) -> Array: ...

    @property
    def qd(self) -> Array: ...

    @property
    def wrench(self) -> Array: ...

    def command(self, q: Array, qd: Array) -> None:
        """Set-point (6,) [rad], [rad/s], due at the end of the next `step`."""

    def step(self, dt: float) -> None:
        """Let dt [s] pass."""

    def set_payload(self, mass: float, cog: Array) -> None:
        """What the controller believes hangs at the flange: mass [kg], centre of gravity (3,) [m] in the flange."""

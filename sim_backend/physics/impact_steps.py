"""Step settings of the physics engine: what a strike needs, and only while it lasts.

A strike lasts 2 to 5 ms and moves the nail by 2 mm. Measured against the energy balance (free heads of 0.4 to 1 kg at 1
to 4 m/s, tests/sim_backend/physics/test_nail.py): at 1/4000 s with 100 iterations the nail goes 1 to 15 % short
(first-order integration of the braking); at 1/240 s it goes 16 to 98 % short. The engine's push-out of penetrations
(contactERP, 0.2 by default) would add up to 15 % of energy to eccentric strikes: it is off in the window.
"""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.sim_backend.physics.bullet import pb


@dataclass(frozen=True)
class StepSettings:
    """time_step [s], solver iterations, share of a penetration that one step pushes out."""

    time_step: float
    iterations: int
    contact_erp: float

    def apply(self, client: int) -> None:
        """Make them the engine's."""
        pb.setPhysicsEngineParameter(
            fixedTimeStep=self.time_step,
            numSolverIterations=self.iterations,
            contactERP=self.contact_erp,
            numSubSteps=0,
            physicsClientId=client,
        )


IMPACT = StepSettings(time_step=1 / 4000, iterations=100, contact_erp=0.0)

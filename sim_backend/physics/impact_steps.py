"""Step settings of the physics engine during a strike.

A strike lasts 2 to 5 ms and moves the nail by 2 mm. Compared with the energy balance (free heads of 0.4 to 1 kg at 1 to
4 m/s, tests/sim_backend/physics/test_nail.py), the nail's travel is 0.4 % off at most at 1/4000 s with 100 iterations,
and 4 % at 1/240 s. The engine's correction of penetrations (contactERP, 0.2 by default) would add up to 15 % of energy
to eccentric strikes: it is off.
"""

from __future__ import annotations

from dataclasses import dataclass

from toolee_robot.sim_backend.physics.bullet import pb

RESIDUAL = 1e-10
"""Squared velocity error at which the solver ends its iterations early [rad^2/s^2]. With pybullet's 1e-7 a resting arm
droops by 1e-6 rad."""


@dataclass(frozen=True)
class StepSettings:
    """Settings of the physics engine.

    Attributes:
        time_step: Length of a step [s].
        iterations: Solver iterations per step.
        contact_erp: Fraction of a penetration that is corrected per step.
    """

    time_step: float
    iterations: int
    contact_erp: float

    def apply(self, client: int) -> None:
        """Apply the settings to a physics client."""
        pb.setPhysicsEngineParameter(
            fixedTimeStep=self.time_step,
            numSolverIterations=self.iterations,
            contactERP=self.contact_erp,
            numSubSteps=0,
            solverResidualThreshold=RESIDUAL,
            physicsClientId=client,
        )


IMPACT = StepSettings(time_step=1 / 4000, iterations=100, contact_erp=0.0)

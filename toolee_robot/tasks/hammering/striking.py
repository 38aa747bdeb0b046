"""Single strikes: plan one, execute it, rise from it, and say what it asked of the arm."""

from __future__ import annotations

import numpy as np

from toolee_robot.control.arm_dynamics import StrikeLoad, strike_load
from toolee_robot.control.contact import ContactVerdict
from toolee_robot.control.planning.strike import plan_strike
from toolee_robot.control.records import StrikePlan
from toolee_robot.frames import Array, angle_between, frame_from_axes, inverse
from toolee_robot.hal import MotionReport
from toolee_robot.station import StationConfig
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.outcome import Strike
from toolee_robot.tasks.hammering.nail_gauge import CLEAR

RETRACT_SPEED, RETRACT_SHARE = 0.8, 0.5
"""Largest speed of the way up after a strike, with nobody in reach [m/s], and share of a strike's velocities and
accelerations."""


FACE, DRIVEN = 0.025, 0.002
"""Largest radius of a face, and depth that a strike drives a nail as a rule [m]: where the rim of a face square to a
nail that leans would meet the wood within that depth, the face is square to the wood instead."""
LEANS = 1e-4
"""Angle of a nail's axis to the wood's normal from which it leans [rad]."""
SOFTER, SOFTENINGS = 0.75, 2
"""Speed of the next strike as a share of one that was too hard for the arm, and how often this may be at one nail."""


class Striking:
    """The strikes on one nail, one by one.

    Args:
        motions: The arm and its motions.
        config: Configuration of the station with this nail.

    Attributes:
        done: The strikes that were recorded.
        too_hard: What the last strike asked too much of, if no softer one may follow; else empty.
    """

    def __init__(self, motions: Motions, config: StationConfig) -> None:
        self.done: list[Strike] = []
        self.too_hard = ""
        self._motions, self._config, self._robot = motions, config, motions.robot
        self._speed, self._softened = config.strike.speed, 0

    def plan(self, height: float, held: HeldTool) -> StrikePlan:
        """Plan a strike: along the nail's axis; square to the wood where the face's rim would else meet it.

        Args:
            height: Protrusion of the nail [m].
            held: What the hand holds.

        Returns:
            The plan, from where the arm stands.

        Raises:
            PlanningError: There is none.
        """
        work, X_base_nail = self._config.work, self._config.work.X_base_nail(height)
        rim = FACE * float(np.tan(angle_between(work.nail_axis, work.wood_normal)))
        return self._plan(X_base_nail if height > rim + DRIVEN or not self.leans else self._square(height), held)

    def plan_touch(self, height: float, held: HeldTool) -> StrikePlan:
        """Plan a strike whose line a touch is made on: square to the wood.

        The face's rim then meets the wood no sooner than its middle.

        Args:
            height: Protrusion of the nail [m].
            held: What the hand holds.

        Returns:
            The plan, from where the arm stands.

        Raises:
            PlanningError: There is none.
        """
        return self._plan(self._square(height) if self.leans else self._config.work.X_base_nail(height), held)

    @property
    def leans(self) -> bool:
        """Whether the nail leans by what the station file says."""
        work = self._config.work
        return angle_between(work.nail_axis, work.wood_normal) > LEANS

    def _square(self, height: float) -> Array:
        X_base_nail = self._config.work.X_base_nail(height)
        return frame_from_axes(z=-self._config.work.wood_normal, x=X_base_nail[:3, 0], p=X_base_nail[:3, 3])

    def _plan(self, X_base_nail: Array, held: HeldTool) -> StrikePlan:
        motions = self._motions
        motions.rise_from_among_nails(held)
        state = motions.world(held), motions.q, motions.q_hand, held.X_hand_ee
        plan = plan_strike(self._robot, self._config, *state, X_base_nail, tool=held.payload, speed=self._speed)
        motions.observer.planned(motions.station.clock.now(), plan)
        return plan

    def swing(self, plan: StrikePlan, held: HeldTool) -> tuple[MotionReport, ContactVerdict]:
        """Execute a strike.

        Args:
            plan: The strike.
            held: What the hand holds.

        Returns:
            What was done, and how it met the nail.

        Raises:
            TooleeError: A motion failed, or nobody permits it.
        """
        motions = self._motions
        motions.transfer("to the run-up", plan.approach, held)
        motions.arm.permit_swings(self._config.task.handover_timeout)
        return motions.swing("strike", plan, held)

    def retract(self, plan: StrikePlan, held: HeldTool) -> None:
        """Move straight out along the nail's axis from where a strike ended, to CLEAR over the nail at least.

        The strike may have been stopped above the nail by an obstacle: never down.

        Args:
            plan: The strike.
            held: What the hand holds.

        Raises:
            TooleeError: The motion failed.
        """
        fk = self._robot.arm.fk
        X_base_ee = fk(self._motions.q) @ inverse(fk(plan.q_contact)) @ plan.X_base_ee_contact
        out = self._config.work.nail_axis
        below = float((plan.X_base_ee_contact - X_base_ee)[:3, 3] @ out)
        up = CLEAR + max(below, 0.0)
        self._motions.straight("up", out, up, held, speed=RETRACT_SPEED, share=RETRACT_SHARE)

    def load(self, plan: StrikePlan, report: MotionReport) -> StrikeLoad:
        """Compute what a strike asked of the arm; after one that was too hard the next ones are softer.

        Args:
            plan: The strike.
            report: What was done.

        Returns:
            The load.
        """
        payload = self._motions.payload
        assert payload is not None, "the payload is set when the hand has closed"
        load = strike_load(report, self._robot, self._motions.q_hand, payload, self._config.arm.model)
        if (excess := load.excess(self._config.strike)) and self._softened == SOFTENINGS:
            self.too_hard = excess
        elif excess:
            self._softened, self._speed = self._softened + 1, SOFTER * plan.speed
            self._motions.observer.message(f"{excess}. The next strikes have at most {self._speed:.2f} m/s")
        return load

    def record(
        self, plan: StrikePlan, report: MotionReport, verdict: ContactVerdict, load: StrikeLoad, height: float | None
    ) -> None:
        """Keep a strike, and tell of it.

        Args:
            plan: The strike.
            report: What was done.
            verdict: How it met the nail.
            load: What it asked of the arm.
            height: Protrusion of the nail measured after it [m]; None where it was not.
        """
        force = float(np.max(np.linalg.norm(report.wrenches[:, :3], axis=1)))
        stamp = report.stamps[-1] if report.contact is None else report.contact.stamp
        if report.contact is not None:
            self._motions.observer.contact(stamp, force, plan.X_base_ee_contact)
        X_flange_ee = inverse(self._robot.arm.fk(plan.q_contact)) @ plan.X_base_ee_contact
        faces = (self._robot.arm.fk(report.q_commanded) @ X_flange_ee)[:, :3, 3]
        deepest = float(np.max((faces - plan.X_base_ee_contact[:3, 3]) @ plan.X_base_ee_contact[:3, 2]))
        strike = Strike(
            len(self.done) + 1, float(stamp), plan.speed, deepest, force, verdict.meeting, load=load, protrusion=height
        )
        self.done.append(strike)
        self._motions.observer.strike(strike)

"""The nails of one job, which are driven one after the other with the tool that is held."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from toolee_robot.control.collision_shapes import nail_bodies
from toolee_robot.errors import GripDoubtError, PlanningError
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.look import Look
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.outcome import JobEnded, NailResult, Outcome, Strike
from toolee_robot.tasks.common.watches import MAX_DOUBTS
from toolee_robot.tasks.hammering.nail_driving import NailDriving

LIFT = 0.020
"""Retraction from the work before the tool is looked at again [m]."""
OF_THE_NAIL = frozenset(
    {Outcome.FLUSH, Outcome.BENT, Outcome.STUCK, Outcome.OUT_OF_STRIKES, Outcome.NAIL_MISSED, Outcome.NO_PLAN}
)
"""Outcomes that are about one nail: the next one is driven. All others stop the job: the robot stands, or what it
holds is lost, unknown, or no longer held as it was, or the last strike was too much for the arm."""


class NailSeries:
    """The nails in order, and what became of them.

    Args:
        motions: The arm and its motions; is told which nails are in the way.
        look: Looks at the tool; None for the baseline, which strikes with the nominal pose in the hand.
        names: Names of the nails, in order.
    """

    def __init__(self, motions: Motions, look: Look | None, names: Sequence[str]) -> None:
        self._motions, self._look, self._work = motions, look, motions.config.work
        self._nails = [
            (name, NailDriving(motions, replace(motions.config, work=self._work.only(name)), look)) for name in names
        ]
        self._ended: list[NailResult] = []
        self._begun = False

    @property
    def strikes(self) -> tuple[Strike, ...]:
        """All strikes so far."""
        return tuple(strike for _, driving in self._nails for strike in driving.strikes)

    @property
    def protrusion(self) -> float | None:
        """Height of the head of the nail driven last over the wood as measured last [m]; None before the first."""
        return next((d.protrusion for _, d in reversed(self._nails) if d.protrusion is not None), None)

    @property
    def seconds(self) -> float:
        """Time that the nails have taken so far [s], station clock."""
        return sum(driving.seconds for _, driving in self._nails)

    def drive(self, held: HeldTool, *, lift: bool) -> tuple[Outcome, str]:
        """Drive the nails that have not ended; a nail that is given up does not keep the next one from being driven.

        Args:
            held: What the hand holds.
            lift: Whether it is lifted from the work first.

        Returns:
            Outcome of all, and the reason for a person.

        Raises:
            JobEnded: The job cannot go on.
            TooleeError: A motion or a device failed.
        """
        while len(self._ended) < len(self._nails):
            name, driving = self._nails[len(self._ended)]
            if not self._begun:
                self._motions.observer.nail_started(name, self._work.only(name).nail_protrusion)
            self._begun = True
            self._motions.keep_clear_of(nail_bodies(self._work, self._standing(name)))
            try:
                outcome, reason = self._look_and_strike(driving, held, lift)
            except JobEnded as end:
                outcome, reason = end.outcome, str(end)
            except PlanningError as error:
                outcome, reason = Outcome.NO_PLAN, str(error)
            if outcome not in OF_THE_NAIL:
                raise JobEnded(outcome, reason)
            self._begun, lift, held = False, True, self._motions.held
            self._ended.append(_result(name, outcome, reason, driving))
            self._motions.observer.nail_ended(self._ended[-1])
        if len(self._nails) == 1:
            return outcome, reason
        flush = [nail.name for nail in self._ended if nail.outcome is Outcome.FLUSH]
        others = [nail for nail in self._ended if nail.outcome is not Outcome.FLUSH]
        if not others:
            return Outcome.FLUSH, f"all {len(flush)} nails are flush"
        reasons = "; ".join(f"{nail.name}: {nail.reason}" for nail in others)
        return others[0].outcome or Outcome.STUCK, f"{len(flush)} of {len(self._nails)} nails are flush; {reasons}"

    def _look_and_strike(self, driving: NailDriving, held: HeldTool, lift: bool) -> tuple[Outcome, str]:
        """Look at the tool and drive a nail; a doubt about the grip that passes is answered by a new look."""
        doubts = strikes = 0
        while True:
            try:
                if lift:
                    with suppress(PlanningError):  # a hand that stands far from the work need not be lifted
                        self._motions.rise("up", held, LIFT)
                if self._look is not None:
                    held = self._look(held, self._motions.config.task.views)
                return driving.run(held)
            except GripDoubtError as doubt:
                done = len(driving.strikes)
                doubts = doubts + 1 if done == strikes else 1
                strikes, lift, held = done, True, self._motions.held
                if doubts >= MAX_DOUBTS:
                    raise
                self._motions.observer.message(f"{doubt}; looking again")

    def _standing(self, struck: str) -> list[str]:
        """The nails other than the one that is struck that are not known to be flush."""
        flush = [nail.name for nail in self._ended if nail.outcome is Outcome.FLUSH]
        return [name for name in self._work.names if name not in (struck, *flush)]

    def told(self, reason: str) -> str:
        """Say at which of several nails the job stopped.

        Args:
            reason: Why it stopped.

        Returns:
            The reason with the nail's name, where there are several and one was begun.
        """
        return f"nail {self._nails[len(self._ended)][0]}: {reason}" if len(self._nails) > 1 and self._begun else reason

    def results(self, outcome: Outcome, reason: str) -> tuple[NailResult, ...]:
        """What became of the nails so far.

        Args:
            outcome: How the job ended: so did the nail that was begun and has not ended.
            reason: Why.

        Returns:
            A result for each.
        """
        found = list(self._ended)
        for name, driving in self._nails[len(found) :]:
            begun = self._begun and len(found) == len(self._ended)
            found.append(_result(name, outcome if begun else None, reason if begun else "", driving))
        return tuple(found)


def _result(name: str, outcome: Outcome | None, reason: str, driving: NailDriving) -> NailResult:
    return NailResult(name, outcome, reason, driving.strikes, driving.protrusion, driving.seconds)

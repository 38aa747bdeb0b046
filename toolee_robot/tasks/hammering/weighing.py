"""The arm weighs a tool of which nobody has said what it weighs: at rest, in several orientations of the flange."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from toolee_robot.arm_data import ARM_DATA
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.planning.transfer import plan_transfer
from toolee_robot.control.planning.wrist_turns import plan_wrist_turns
from toolee_robot.control.tool_weight import RestReading, ToolWeight, WeighingPrior, rest_reading, weigh
from toolee_robot.errors import GripDoubtError, PlanningError, WeighingError
from toolee_robot.frames import Array, inverse
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.watches import MAX_DOUBTS
from toolee_robot.tasks.hammering.grasp import Grasp
from toolee_robot.types import ArmModel, Payload, Trajectory

SETTLE = 0.5
"""Time at rest before the wrench is read, so that arm, wrist and tool have stopped swinging [s]."""
READ = 4.0
"""Time over which it is read in each posture, with the empty hand and with the tool [s]."""
SAME_POSTURE = 0.01
"""Difference of the joints' positions that turns no weight by anything that counts [rad]: that of a stop at rest."""
POSTURES = 5
"""Largest number of postures beside that of the handover."""
HAND_SHARE, HAND_PLACE = 0.1, 0.01
"""Standard deviations of what a lab says of its hand: of the mass, as a share of it, and of its centre [m]. Assumed."""
SINCE_EMPTY, PRESSED = (0.9, 0.14), (0.65, 0.1)
"""What presses on the arm since the empty hand was felt, beside the tool, in all postures, and what else does in one
reading [N, Nm]: hand and cables are touched in between, and 3 N in one of the first readings, or in all of those with
the empty hand, must not pass for a certain mass. Assumed."""
CABLE = 0.11
"""The same for each kg of the hand [N/kg]: the more it weighs, the less it shows a pull. Assumed."""
WARM_UP = 600.0
"""Time in which the wrench's error changes by as much as from posture to posture [s]. Assumed, as the simulated arm."""
BESIDE = 0.04
"""Mass times distance of the tool's centre of mass from the handle's axis as the hand nominally holds it, standard
deviation [kg m]: 60 mm of a hammer of 0.66 kg, which the hand may hold tilted."""
LARGEST_SIGMA, LARGEST_SHARE = 0.2, 0.33
"""Standard deviation of a mass above which nothing is struck: in [kg], and as a share of the mass. Tools whose mass was
wrong by 30 % drove 20 of 20 simulated nails (docs/results/job.md)."""
LARGEST_MOMENT = 0.08
"""The same of the tool's moment, mass times centre of mass [kg m]: three of them are 4 % of a wrist joint's 56 Nm."""
HEAVIER = 2.0
"""A weighed tool is taken for heavier by so many standard deviations where its swing is planned."""


class Weighing:
    """Weighs the tool of one job.

    Args:
        motions: The arm and its motions.

    Attributes:
        weight: What was weighed; None before.
    """

    def __init__(self, motions: Motions) -> None:
        self.weight: ToolWeight | None = None
        self._motions, self._config, self._robot = motions, motions.config, motions.robot
        self._clock, self._observer = motions.station.clock, motions.observer
        self._empty: list[RestReading] = []
        self._felt_at, self._readied = -np.inf, 0
        self._qs: list[Array] = []

    def feel_empty_hand(self, grasp: Grasp, expected: HeldTool) -> None:
        """Read what the arm feels with the empty hand: the tool is weighed against it.

        It is felt where the arm stands, and with the wrist turned as the tool will be, where there are ways; the arm
        then stands where it stood.

        Args:
            grasp: Nominal grasp.
            expected: The tool as it will be held, by that.

        Raises:
            DeviceError: The arm does not answer, or takes no payload.
            TooleeError: A motion failed.
        """
        motions, speed = self._motions, self._config.supervisor.handover_speed
        motions.set_payload(self._robot.description.hand_payload(motions.q_hand))
        self._felt_at, self._readied = self._clock.now(), motions.readied
        self._qs, self._empty = [motions.q], [self._reading()]
        closed = self._robot.description.hand_closed
        with_tool = CollisionWorld(self._robot, self._config, closed, expected.X_hand_ee, tool_off=expected.off)
        goals, turns = list[Array](), list[Trajectory]()
        with suppress(PlanningError):  # the reading here is enough
            goals = [turn.q[-1] for turn in self._turns(grasp, POSTURES, with_tool)]
            turns = self._turns(grasp, 0, motions.world(None), goals)
        if turns:
            self._observer.message("stay out of reach: the wrist turns while the arm weighs the empty hand")
        for turn in turns:
            motions.transfer("to feel the empty hand", turn, None, speed)
            self._qs.append(motions.q)
            self._empty.append(self._reading())
        self._to_handover(None)

    def weigh(self, grasp: Grasp, held: HeldTool) -> tuple[Grasp, HeldTool]:
        """Weigh the tool in the hand: the wrist turns slowly, and the arm feels the tool at rest in between.

        Before, the arm compensates the hand alone; with a result, also one that is refused, the tool, too. Without a
        result (`weighing.orientations`, `weighing.not_held`, readings that contradict each other, no motion, a tool
        that the arm cannot carry) it stays told the hand alone. It ends where it last felt the tool, and where it
        refuses, at the place of the handover, or where it stood if there is no way there.

        Args:
            grasp: Nominal grasp, with the mass for which the job was planned.
            held: What the hand holds.

        Returns:
            Both with the tool's mass and centre of mass; for the plan of a strike it is taken for heavier by its
            uncertainty.

        Raises:
            WeighingError: There is no result, or it is too uncertain (`weighing.uncertain`), or more than the job was
                planned for (`weighing.too_heavy`), or there is no safe motion to weigh it (`weighing.no_motion`).
            TooleeError: A device failed, the tool was lost, the hand doubted its grip again and again, or a person is
                near.
        """
        try:
            try:
                weight, count = self._felt_in_spite_of_doubts(grasp, held)
            except PlanningError as error:
                raise WeighingError(
                    f"the tool cannot be weighed where it was handed over: {error}. Clear the space around it, or "
                    "weigh it on scales and write tool.mass and tool.center_of_mass",
                    code="weighing.no_motion",
                ) from error
            p_tool_com = self._told(weight, grasp)
            self._check(weight, grasp.mass)
        except WeighingError as error:
            self._observer.message(str(error))  # a motion or a device may fail on the way back
            with suppress(PlanningError):
                self._to_handover(held)
            raise
        self._observer.message(f"the arm weighs the tool: {in_words(weight)}, in {count} orientations")
        swung = Payload(weight.mass + HEAVIER * weight.mass_sigma, p_tool_com)
        payload = swung.seen_from(inverse(held.X_hand_ee) @ grasp.X_hand_tool)
        told = replace(grasp, mass=weight.mass, p_tool_com=p_tool_com, to_weigh=False)
        return told, replace(held, payload=payload, weighed=True)

    def _felt_in_spite_of_doubts(self, grasp: Grasp, held: HeldTool) -> tuple[ToolWeight, int]:
        """The same as `_felt`; from the beginning where the hand doubted its grip, since the tool may have moved."""
        for _ in range(MAX_DOUBTS - 1):
            try:
                return self._felt(grasp, held)
            except GripDoubtError as doubt:
                self._observer.message(f"{doubt}; weighing again")
        return self._felt(grasp, held)

    def _felt(self, grasp: Grasp, held: HeldTool) -> tuple[ToolWeight, int]:
        """The tool's weight, and in how many orientations it was felt."""
        motions, config = self._motions, self._config
        self._to_handover(held)  # a resumed job stands elsewhere
        felt = [(self._reading(), self._empty[:1])]
        for turn in self._turns(grasp, POSTURES, motions.world(held), self._qs[1:]):
            motions.transfer("to weigh the tool", turn, held, config.supervisor.handover_speed)
            empty = [one for q, one in zip(self._qs, self._empty, strict=True) if _same(turn.q[-1], q)]
            felt.append((self._reading(), empty))
        felt.sort(key=lambda pair: not pair[1])  # the tool may hinder a turn of the empty hand
        empties = [one for _, empty in felt for one in empty]
        return weigh([one for one, _ in felt], empties, config.arm.gravity, self._prior(grasp)), len(felt)

    def _turns(
        self, grasp: Grasp, count: int, world: CollisionWorld, first: Sequence[Array] | None = None
    ) -> list[Trajectory]:
        """Motions to postures in which the tool is felt, or will be; see `plan_wrist_turns`."""
        noise, prior, q = self._empty[0].noise, self._prior(grasp), self._motions.q
        return plan_wrist_turns(self._robot, self._config, world, q, noise, prior, count, first)

    def _told(self, weight: ToolWeight, grasp: Grasp) -> Array:
        """Tell the arm the tool; returns its centre of mass in the nominal tool, (3,) [m]."""
        q_hand = self._motions.q_hand
        X_flange_tool = self._robot.X_flange_hand(q_hand) @ grasp.X_hand_tool
        p_tool_com = (inverse(X_flange_tool) @ np.append(weight.center_of_mass, 1.0))[:3]
        try:
            self._motions.set_payload(self._robot.payload(q_hand, grasp.X_hand_tool, weight.mass, p_tool_com))
        except PlanningError as error:
            raise WeighingError(
                f"the arm weighs the tool: {in_words(weight)}. It cannot carry it: {error}. Use a lighter hammer",
                code="weighing.too_heavy",
            ) from error
        self.weight = weight
        return np.asarray(p_tool_com)

    def _to_handover(self, held: HeldTool | None) -> None:
        motions, config = self._motions, self._config
        assert self._qs, "the empty hand is weighed before the handover"
        if not _same(motions.q, self._qs[0]):
            way = plan_transfer(self._robot, config, motions.world(held), motions.q, self._qs[0])
            motions.transfer("to the handover", way, held, config.supervisor.handover_speed)

    def _reading(self) -> RestReading:
        self._clock.sleep(SETTLE)
        R = self._robot.arm.fk(self._motions.q)[:3, :3]
        return rest_reading(R, self._motions.wrenches(READ))

    def _prior(self, grasp: Grasp) -> WeighingPrior:
        q_hand = self._motions.q_hand
        hand = self._robot.description.hand_payload(q_hand)
        X_flange_tool = self._robot.X_flange_hand(q_hand) @ grasp.X_hand_tool
        return WeighingPrior(
            posture=ARM_DATA[self._config.arm.model].wrench_drift,
            hand_mass=HAND_SHARE * hand.mass,
            hand_moment=hand.mass * np.hypot(HAND_SHARE * hand.center_of_mass, HAND_PLACE),
            time=pull(hand.mass),
            aged=since_empty(
                self._config.arm.model, self._clock.now() - self._felt_at, self._motions.readied != self._readied
            ),
            pressed=PRESSED,
            grip=X_flange_tool[:3, 3],
            handle=X_flange_tool[:3, 2],
            handle_moment=BESIDE,
        )

    def _check(self, weight: ToolWeight, planned: float) -> None:
        """Refuse a weight that is too uncertain, or more than was planned for [kg]."""
        moment = weight.mass * weight.center_sigma
        if weight.mass_sigma > min(LARGEST_SIGMA, LARGEST_SHARE * weight.mass) or moment > LARGEST_MOMENT:
            raise WeighingError(
                f"the arm's weighing is too inexact for a strike: {in_words(weight)}. Keep arm, hand and tool free "
                "of contact and pulling cables. Or weigh the tool on scales, balance it on an edge, and write "
                "tool.mass and tool.center_of_mass",
                code="weighing.uncertain",
            )
        if weight.mass > planned:
            raise WeighingError(
                f"the arm weighs the tool: {in_words(weight)}. The job is planned for at most {planned:.1f} kg. Use "
                "a lighter hammer, or weigh it on scales and write tool.mass and tool.center_of_mass",
                code="weighing.too_heavy",
            )


def _same(q: Array, other: Array) -> bool:
    return bool(np.max(np.abs(q - other)) < SAME_POSTURE)


def pull(hand_mass: float) -> tuple[float, float]:
    """What may press on the arm since the empty hand was felt, by the hand's mass [kg].

    Args:
        hand_mass: Mass of the hand [kg].

    Returns:
        Standard deviation per axis of `base`: force [N] and torque [Nm].
    """
    return float(np.hypot(SINCE_EMPTY[0], CABLE * hand_mass)), SINCE_EMPTY[1]


def since_empty(model: ArmModel, age: float, reset: bool) -> tuple[float, float]:
    """How far the wrench's own error may have changed since the empty hand was felt.

    Args:
        model: Model of the arm.
        age: Time since the first of the readings [s].
        reset: Whether the arm was stopped and reset since, which may have changed the error as a posture does.

    Returns:
        Standard deviation of the change, per axis of the flange: force [N] and torque [Nm].
    """
    share = age / WARM_UP + float(reset)
    force, torque = ARM_DATA[model].wrench_drift
    return share * force, share * torque


def in_words(weight: ToolWeight) -> str:
    """A weight with its standard deviations, for people.

    Args:
        weight: The weight.

    Returns:
        The words.
    """
    return f"{weight.mass:.2f} ± {weight.mass_sigma:.2f} kg, centre of mass known to {weight.center_sigma * 1e3:.0f} mm"

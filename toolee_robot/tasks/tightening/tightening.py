"""Strokes of a wrench at a nut: slide the jaw on, turn, measure the torque, slide off, turn back, until it is tight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.control.planning.transfer import plan_transfer
from toolee_robot.control.planning.turn import Stroke, about, places, plan_turn
from toolee_robot.errors import PlanningError, UnreachableError
from toolee_robot.frames import Array, inverse, rotation_z, transform
from toolee_robot.hal import ContactGuard
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.look import Look
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.outcome import JobEnded, Outcome, Stage
from toolee_robot.tasks.tightening.records import SIXTH, NutWork, Turn

STAND_OFF = 0.028
"""Way of the jaw onto the nut [m]."""
RISE = 0.06
"""Height over the nut from which the jaw comes down beside it [m]."""
SLIDE_SPEED, TURN_SPEED = 0.03, 0.25
"""Of the jaw onto the nut [m/s], and about it [rad/s]."""
SLIDE_GUARD, TURN_GUARD = 22.0, 50.0
"""Force at the flange that ends a slide or a turn [N]."""
WINDOW = 0.12
"""Time over which that force is averaged [s]."""
MEASURE_S, QUICK_S, FEEL_S = 1.5, 0.6, 0.4
"""Time at rest over which the torque is read, near the wanted one and far from it, and a force beside the jaw [s]."""
LEAST_WOUND = 1.0
"""Torque for which a jaw is at least unwound [Nm]."""
SLIPPED_SHARE = 0.4
"""Share of the torque before below which the jaw has slipped off."""
YIELD = 250.0
"""Stiffness of hand and jaw about the nut [Nm/rad], some: so much the jaw is wound up before the nut turns."""
PLAY = float(np.deg2rad(1.7))
"""How far the jaw turns on the nut between its corners to each side [rad], some."""
SIDE_STIFFNESS = 2e4
"""Stiffness of the hand beside the jaw [N/m], some."""
LEAST_SIDE = 6.0
"""Force beside the jaw that is relieved [N]; less is noise."""
ON_SHARE = 0.75
"""Share of the way onto the nut from which on the jaw counts as on it."""
TRIES = 4
"""How often the jaw is slid on, each time moved by what it felt, before the tool is looked at again."""
MAX_STROKES = 10
"""Number of strokes after which the job gives up."""
COARSE_STEP, LEAST_STEP = float(np.deg2rad(31.0)), float(np.deg2rad(1.0))
"""Largest and least turn between two measurements of the torque [rad]. In motion, and over a whole stroke, the wrench
that a CB3 estimates is off by more than the torque that is wanted."""
EASY = 0.35
"""Share of the wanted torque up to which a quick measurement is enough."""
STIFFEST = 4.0
"""Stiffness that a joint may have [Nm/rad], by which the turn to the torque is chosen."""
AT_ONCE = float(np.deg2rad(8.0))
"""Angle within which a nut that was tight before reaches its torque [rad]."""
CLOSE = 0.12
"""Torque below the wanted one that counts as reached [Nm]."""
LOOK_EVERY = 3
"""Number of strokes after which the tool is looked at again."""


@dataclass(eq=False)
class _Place:
    """Where the arm works.

    Attributes:
        X_base_ee: Pose of the jaw on the nut at the begin of a stroke, (4, 4).
        way_on: Way of the jaw onto the nut, (3,) [m].
    """

    X_base_ee: Array
    way_on: Array


class Tightening:
    """Tightens one nut.

    Args:
        motions: The arm and its motions.
        look: Looks at the tool; None for the nominal pose, a baseline.
        work: The nut.
        on_turn: Called after every stroke.

    Attributes:
        turns: The strokes so far.
        torque: Torque as measured last [Nm]; None before the first stroke.
    """

    def __init__(
        self, motions: Motions, look: Look | None, work: NutWork, on_turn: Callable[[Turn], None]
    ) -> None:
        self.turns: list[Turn] = []
        self.torque: float | None = None
        self._motions, self._look, self._work, self._on_turn = motions, look, work, on_turn
        self._aside = np.zeros(3)  # by what the jaw has felt, the nut is so far from where it was measured
        self._on: Array | None = None  # way onto the nut of the jaw that is on it
        self._angle = 0.0  # of the nut since the begin

    def tighten(self, held: HeldTool) -> tuple[Outcome, str]:
        """Tighten the nut.

        Args:
            held: The wrench.

        Returns:
            How it ended, and why.

        Raises:
            JobEnded: The nut is out of reach, or the jaw does not hold it.
            TooleeError: A motion or a device failed.
        """
        motions = self._motions
        if self._look is not None:
            held = self._look(held, motions.config.task.views)
        at_nut, failures = False, 0
        while len(self.turns) < MAX_STROKES:
            if not at_nut:
                with motions.stages(Stage.PLAN):
                    way_on = self._before(held)
                at_nut = True
            if not self._slide_on(held, way_on):
                failures += 1
                if self._look is None or failures > 2:
                    raise JobEnded(Outcome.SLIPPED_OFF, "the jaw does not go onto the nut")
                held, at_nut = self._again(held), False
                continue
            turn, slipped = self._stroke(held)
            self.turns.append(turn)
            self._on_turn(turn)
            self.torque = turn.torque
            motions.observer.message(
                f"stroke {turn.number}: {np.rad2deg(turn.angle):.0f}°, {turn.torque:.1f} Nm"
            )
            if turn.torque >= self._work.torque - CLOSE:
                tight = sum(t.angle for t in self.turns) < AT_ONCE
                words = f"{turn.torque:.1f} Nm after {len(self.turns)} strokes"
                return (Outcome.ALREADY_TIGHT if tight else Outcome.TIGHTENED), words
            way_on = self.leave(held)
            self._angle += turn.angle - max(turn.torque, 0.0) / YIELD - PLAY
            if slipped:
                failures += 1
                if self._look is None or failures > 2:
                    raise JobEnded(Outcome.SLIPPED_OFF, "the jaw slipped off the nut under load")
                held, at_nut = self._again(held), False
                continue
            if self._look is not None and len(self.turns) % LOOK_EVERY == 0:
                held, at_nut = self._again(held), False
                continue
            self._turn("back", -SIXTH, held)
            way_on = _turned(self._work.axis, -SIXTH) @ way_on
        return Outcome.NOT_TIGHT, f"{MAX_STROKES} strokes did not tighten the nut"

    def leave(self, held: HeldTool) -> Array:
        """Slide the jaw off the nut, if it is on it.

        Returns:
            The way onto it again, (3,) [m].
        """
        if self._on is None:
            return np.zeros(3)
        way, self._on = self._on, None
        if self.torque is not None:
            back = max(self.torque, 0.0) / YIELD + PLAY
            self._turn("unwind", -back, held)
            way = _turned(self._work.axis, -back) @ way
        self._motions.straight("off the nut", -way, float(np.linalg.norm(way)), held)
        return way

    def _again(self, held: HeldTool) -> HeldTool:
        assert self._look is not None
        self._motions.rise("up from beside the nut", held, RISE)
        return self._look(held, self._motions.config.task.views_again)

    def _jaw_on(self, heading: float) -> tuple[Array, Array]:
        """Pose of the end effector on the nut, and direction of the way on, for an angle of the jaw to the nut."""
        work = self._work
        X_nut_jaw = transform(rotation_z(heading))  # its x out of the mouth
        X_jaw_ee = transform(rotation_z(-work.jaw_turn) @ np.diag([-1.0, -1.0, 1.0]))
        slot = (work.X_base_nut @ X_nut_jaw)[:3, 0]
        X = work.X_base_nut @ X_nut_jaw @ transform(p=[-work.seat, 0.0, 0.0]) @ X_jaw_ee
        return transform(p=self._aside) @ X, slot

    def _before(self, held: HeldTool) -> Array:
        """Bring the jaw before the nut, from a side where a whole stroke is free: the way on, (3,) [m]."""
        motions, work = self._motions, self._work
        world = motions.world(held)
        strokes = []
        for k in range(6):
            X, slot = self._jaw_on(self._angle + k * SIXTH)
            strokes.append(Stroke(X, STAND_OFF * slot, work.axis, work.point + self._aside, SIXTH + 3 * PLAY, RISE))
        X_flange_ee = motions.robot.X_flange_hand(motions.q_hand) @ held.X_hand_ee
        failure: PlanningError | None = None
        for number, (index, q) in enumerate(places(motions.robot, world, motions.q, X_flange_ee, strokes)):
            if number == 6:
                break
            try:
                way = plan_transfer(motions.robot, motions.config, world, motions.q, q)
            except PlanningError as error:
                failure = error
                continue
            motions.transfer("above the nut", way, held)
            motions.straight("down beside the nut", (0.0, 0.0, -1.0), RISE, held)
            return strokes[index].way_on
        why = "" if failure is None else f": {failure}"
        raise JobEnded(Outcome.OUT_OF_REACH, f"the arm cannot turn the wrench by 60° on the nut{why}")

    def _slide_on(self, held: HeldTool, way_on: Array) -> bool:
        """Slide the jaw onto the nut; where it is blocked, move it aside by what it feels, and try again."""
        motions = self._motions
        with motions.stages(Stage.TOUCH):
            for _ in range(TRIES):
                motions.zero_wrench()
                start, length = self._place(held), float(np.linalg.norm(way_on))
                slot = way_on / length
                across = np.cross(self._work.axis, slot)
                guard = ContactGuard(SLIDE_GUARD, averaging_window=WINDOW)
                blocked = motions.straight("onto the nut", slot, length, held, guard, speed=SLIDE_SPEED)
                gone = float((self._place(held) - start) @ slot)
                side = float(np.mean(motions.forces(FEEL_S), axis=0) @ across)
                aside = float(np.clip(side / SIDE_STIFFNESS, -0.003, 0.003)) if abs(side) > LEAST_SIDE else 0.0
                motions.observer.message(
                    f"slide: {gone * 1e3:.1f} of {length * 1e3:.0f} mm, {side:.1f} N beside, blocked {blocked}"
                )
                if gone >= ON_SHARE * length:
                    self._on = gone * slot
                    self._shift(held, aside * across)
                    if blocked and length - gone > 5e-4:
                        guard = ContactGuard(1.5 * SLIDE_GUARD, averaging_window=WINDOW)
                        motions.straight("on", slot, length - gone, held, guard, speed=SLIDE_SPEED)
                        self._on = float((self._place(held) - start) @ slot) * slot
                    return True
                motions.straight("back", -slot, gone, held)
                if aside == 0.0:
                    return False
                self._shift(held, aside * across)
        return False

    def _shift(self, held: HeldTool, way: Array) -> None:
        length = float(np.linalg.norm(way))
        if length > 1.5e-4:
            self._motions.straight("aside", way / length, length, held, speed=SLIDE_SPEED)
            self._aside = self._aside + way

    def _place(self, held: HeldTool) -> Array:
        return self._motions.X_base_ee(held)[:3, 3]

    def _stroke(self, held: HeldTool) -> tuple[Turn, bool]:
        """Turn the nut by a sixth, or until it is tight: the stroke, and whether the jaw has slipped off."""
        motions, work = self._motions, self._work
        angle, torque, measured, slipped, goal = 0.0, 0.0, 0, False, SIXTH + PLAY
        with motions.stages(Stage.TURN):
            while angle < goal - 1e-3 and not slipped:
                step = (work.torque - torque) / STIFFEST if torque > EASY * work.torque else COARSE_STEP
                angle += self._turn("turn", min(max(step, LEAST_STEP), COARSE_STEP, goal - angle), held, TURN_GUARD)
                before, torque = torque, self._measured(held, torque)
                measured += 1
                motions.observer.message(f"{torque:.1f} Nm after {np.rad2deg(angle):.0f}° of this stroke")
                slipped = torque < SLIPPED_SHARE * before and before > EASY * work.torque
                if torque >= work.torque - CLOSE:
                    break
            assert self._on is not None
            self._on = _turned(work.axis, angle) @ self._on
        return Turn(len(self.turns) + 1, motions.station.clock.now(), angle, torque, measured), slipped

    def _measured(self, held: HeldTool, before: float) -> float:
        """Torque at the nut [Nm]: the difference to that of a jaw which is turned back until it is free of the nut.

        Args:
            held: The wrench.
            before: What was measured last [Nm]: a torque near the wanted one is measured for longer.
        """
        duration = MEASURE_S if before > 0.5 * EASY * self._work.torque else QUICK_S
        loaded = self._raw(duration)
        back = max(before, LEAST_WOUND) / YIELD + PLAY
        self._turn("release", -back, held)
        torque = self._raw(duration) - loaded
        if torque > EASY * self._work.torque and duration < MEASURE_S:
            self._turn("on again", back, held)
            return self._measured(held, torque)
        self._turn("on again", back, held)
        return torque

    def _raw(self, duration: float) -> float:
        """Torque of the work on the flange about the nut's axis, by the arm's wrench at rest [Nm]."""
        motions = self._motions
        wrench = np.mean(motions.wrenches(duration), axis=0)
        arm = motions.robot.arm.fk(motions.q)[:3, 3] - self._work.point - self._aside
        return float((wrench[3:] + np.cross(arm, wrench[:3])) @ self._work.axis)

    def _turn(self, name: str, angle: float, held: HeldTool, force: float | None = None) -> float:
        """Turn the wrench about the nut; returns the angle that it has turned [rad]."""
        motions, work = self._motions, self._work
        guard = None if force is None else ContactGuard(force, ignore_before=0.2, averaging_window=WINDOW)
        X = motions.robot.arm.fk(motions.q)
        turn = plan_turn(
            motions.robot, motions.config, motions.world(held), motions.q, work.axis, work.point + self._aside, angle,
            TURN_SPEED,
        )  # fmt: skip
        motions.execute(name, turn, held, guard, at_work=True)
        R = motions.robot.arm.fk(motions.q)[:3, :3] @ X[:3, :3].T
        return float(Rotation.from_matrix(R).as_rotvec() @ work.axis)


def _turned(axis: Array, angle: float) -> Array:
    return about(axis, np.zeros(3), np.array([angle]))[0, :3, :3]

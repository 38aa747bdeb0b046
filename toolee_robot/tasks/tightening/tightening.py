"""Strokes of a wrench at a nut: slide the jaw on, turn, measure the torque, slide off, turn back, until it is tight."""

from __future__ import annotations

from itertools import islice

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.control.planning.transfer import plan_transfer
from toolee_robot.control.planning.turn import Stroke, places, plan_turn
from toolee_robot.errors import PlanningError
from toolee_robot.frames import Array, rotation_z, transform
from toolee_robot.hal import ContactGuard
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.look import Look
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.outcome import JobEnded, Outcome, Stage
from toolee_robot.tasks.tightening.records import SIXTH, NutWork, Turn

STAND_OFF, RISE = 0.028, 0.06
"""Way of the jaw onto the nut, and height over the nut from which it comes down beside it [m]."""
SLIDE_SPEED, TURN_SPEED = 0.03, 0.25
"""Of the jaw onto the nut [m/s], and about it [rad/s]."""
SLIDE_GUARD, TURN_GUARD = 22.0, 35.0
"""Force at the flange that ends a slide or a turn [N]: a third of what a hand holds across its fingers; 24 N go with
4 Nm, and a CB3's estimate is off by 10 N in motion."""
WINDOW_S = 0.12
"""Time over which that force is averaged [s]."""
MEASURE_S, QUICK_S, FEEL_S = 1.5, 0.6, 0.4
"""Time at rest over which the torque is read, near the wanted one and far from it, and a force beside the jaw [s]."""
TILT_STIFFNESS, JAW_STIFFNESS, LEAST_WOUND = 100.0, 500.0, 1.0
"""Stiffness of the hand against a tilt of the handle, and of jaw and handle [Nm/rad], some; torque for which a jaw is
unwound at least [Nm]."""
RELEASES, UNSURE = 3, float(np.deg2rad(0.35))
"""How often a jaw is released at most to measure a torque, and by how much farther it may have to turn back for it to
be done once more [rad]."""
PLAY = float(np.deg2rad(0.8))
"""How far the jaw turns on the nut between its corners to each side [rad]: 0.3 to 4 degrees by ISO 691 and ISO 4032. If
it is less, a jaw that is turned back presses on the nut the other way."""
SIDE_STIFFNESS, LEAST_SIDE, LARGEST_ASIDE = 2e4, 6.0, 0.003
"""Stiffness of the hand beside the jaw [N/m], some; force there that is relieved [N], less is noise; and how far the
jaw is moved for it at most [m]."""
ON_SHARE, TRIES = 0.75, 4
"""Share of the way onto the nut from which on the jaw counts as on it, and how often it is tried."""
MAX_STROKES, MAX_FAILURES, LOOK_EVERY = 8, 2, 3
"""Number of strokes, and of times that the jaw did not go on or slipped off, after which the job gives up; number of
strokes after which the tool is looked at again."""
LARGEST_STEP, LEAST_STEP = float(np.deg2rad(31.0)), float(np.deg2rad(1.0))
"""Largest and least turn between two measurements of the torque [rad]. In motion, and over a whole stroke, the wrench
that a CB3 estimates is off by more than the torque that is wanted."""
EASY, CLOSE = 0.35, 0.03
"""Share of the wanted torque up to which a quick measurement is enough, and below it within which it is reached."""
STIFFEST = 4.0
"""Stiffness that a joint may have [Nm/rad], by which the turn to the torque is chosen."""
AT_ONCE = float(np.deg2rad(8.0))
"""Angle within which a nut that was tight before reaches its torque [rad]."""
SLIPPED_SHARE, MOST_MEASURED = 0.4, 12
"""Share of the torque before below which the jaw has slipped off; number of measurements that end a stroke."""
PLACES_TRIED = 6
"""Number of places to which a way is planned."""


class Tightening:
    """Tightens one nut.

    Args:
        motions: The arm and its motions.
        look: Looks at the tool; None for the nominal pose, a baseline.
        work: The nut.

    Attributes:
        turns: The strokes so far.
        torque: Torque as measured last [Nm]; None before the first stroke.
    """

    def __init__(self, motions: Motions, look: Look | None, work: NutWork) -> None:
        self.turns: list[Turn] = []
        self.torque: float | None = None
        self._motions, self._look, self._work = motions, look, work
        self._aside = np.zeros(3)  # by what the jaw has felt, the nut is so far from where it was measured [m]
        self._on: Array | None = None  # way onto the nut of the jaw that is on it [m]
        self._angle = 0.0  # of the nut since the begin [rad]
        self._failures = 0

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
        if self._look is not None:
            held = self._look(held, self._motions.config.task.views)
        way_on: Array | None = None
        while len(self.turns) < MAX_STROKES:
            if way_on is None:
                way_on = self._before(held)
            if not self._slide_on(held, way_on):
                held, way_on = self._after_failure(held, "the jaw does not go onto the nut"), None
                continue
            turn, slipped = self._stroke(held)
            self.turns.append(turn)
            self.torque = turn.torque
            self._angle += turn.angle - self._wound(held, turn.torque)
            self._motions.observer.message(str(turn))
            if self._reached(turn.torque):
                return self._tight(turn.torque)
            way_on = self.leave(held)
            if slipped:
                held, way_on = self._after_failure(held, "the jaw slipped off the nut under load"), None
            elif self._look is not None and len(self.turns) % LOOK_EVERY == 0:
                held, way_on = self._again(held), None
            else:
                way_on = self._turned(self._turn("back", -SIXTH, held), way_on)
        return Outcome.NOT_TIGHT, f"{MAX_STROKES} strokes did not tighten the nut: is the jaw on it?"

    def leave(self, held: HeldTool) -> Array:
        """Slide the jaw off the nut, if it is on it; first it is turned back until it is free.

        Args:
            held: The wrench.

        Returns:
            The way onto it again, (3,) [m].
        """
        if self._on is None:
            return np.zeros(3)
        if self.torque is not None:
            self._turn("unwind", -self._wound(held, self.torque), held)
        way, self._on = self._on, None
        self._motions.straight("off the nut", -way, float(np.linalg.norm(way)), held)
        return way

    def _reached(self, torque: float) -> bool:
        return torque >= (1.0 - CLOSE) * self._work.torque

    def _tight(self, torque: float) -> tuple[Outcome, str]:
        if sum(turn.angle for turn in self.turns) < AT_ONCE:
            return Outcome.ALREADY_TIGHT, f"{torque:.1f} Nm at once: the nut does not turn"
        count = len(self.turns)
        return Outcome.TIGHTENED, f"{torque:.1f} Nm after {count} stroke{'' if count == 1 else 's'}"

    def _after_failure(self, held: HeldTool, what: str) -> HeldTool:
        """Look again after the jaw has lost the nut; the last time ends the job."""
        self._failures += 1
        if self._look is None or self._failures > MAX_FAILURES:
            raise JobEnded(Outcome.SLIPPED_OFF, what)
        self._motions.observer.message(f"{what}; looking again")
        return self._again(held)

    def _again(self, held: HeldTool) -> HeldTool:
        assert self._look is not None
        self._motions.rise("up from beside the nut", held, RISE)
        return self._look(held, self._motions.config.task.views_again)

    def _strokes(self) -> list[Stroke]:
        """The strokes from each of the nut's sides."""
        work = self._work
        X_jaw_ee = transform(rotation_z(-work.jaw_turn) @ np.diag([-1.0, -1.0, 1.0]))  # a jaw's x is out of its mouth
        found = []
        for side in range(6):
            X_base_jaw = work.X_base_nut @ transform(rotation_z(self._angle + side * SIXTH))
            X = transform(p=self._aside) @ X_base_jaw @ transform(p=[-work.seat, 0.0, 0.0]) @ X_jaw_ee
            way_on, angle = STAND_OFF * X_base_jaw[:3, 0], SIXTH + 3 * PLAY
            found.append(Stroke(X, way_on, work.axis, work.point + self._aside, angle, RISE))
        return found

    def _before(self, held: HeldTool) -> Array:
        """Bring the jaw before the nut, on a side where a whole stroke is free: the way on, (3,) [m]."""
        motions = self._motions
        world, strokes = motions.world(held), self._strokes()
        X_flange_ee = motions.robot.X_flange_hand(motions.q_hand) @ held.X_hand_ee
        why = ""
        with motions.stages(Stage.PLAN):
            found = places(motions.robot, world, motions.q, X_flange_ee, strokes)
            for side, q in islice(found, PLACES_TRIED):
                try:
                    way = plan_transfer(motions.robot, motions.config, world, motions.q, q)
                    way_on = strokes[side].way_on
                    break
                except PlanningError as error:
                    why = f": {error}"
            else:
                raise JobEnded(Outcome.OUT_OF_REACH, f"the arm cannot turn the wrench by 60° on the nut{why}")
        motions.transfer("above the nut", way, held)
        motions.straight("down beside the nut", (0.0, 0.0, -1.0), RISE, held)
        return way_on

    def _slide_on(self, held: HeldTool, way_on: Array) -> bool:
        """Slide the jaw onto the nut. If it is blocked, move it aside by what it feels, and try again."""
        motions, length = self._motions, float(np.linalg.norm(way_on))
        slot = way_on / length
        with motions.stages(Stage.TOUCH):
            for _ in range(TRIES):
                motions.zero_wrench()
                start = self._place(held)
                gone, blocked = self._slide("onto the nut", held, start, slot, length, SLIDE_GUARD)
                aside = self._felt_aside(np.cross(self._work.axis, slot))
                if gone < ON_SHARE * length:
                    motions.observer.message(f"the jaw met the nut {1e3 * (length - gone):.0f} mm too early")
                    motions.straight("back", -slot, gone, held)
                    if not aside.any():
                        return False
                    self._shift(held, aside)
                    continue
                self._shift(held, aside)
                if blocked:
                    gone, _ = self._slide("on", held, start, slot, length, 1.5 * SLIDE_GUARD)
                self._on = gone * slot
                return True
        return False

    def _slide(
        self, name: str, held: HeldTool, start: Array, slot: Array, length: float, force: float
    ) -> tuple[float, bool]:
        """Slide on along the slot, up to a length from the start [m]: how far the jaw is, and whether it is blocked."""
        gone, guard = float((self._place(held) - start) @ slot), ContactGuard(force, averaging_window=WINDOW_S)
        blocked = self._motions.straight(name, slot, length - gone, held, guard, speed=SLIDE_SPEED)
        return float((self._place(held) - start) @ slot), blocked

    def _felt_aside(self, across: Array) -> Array:
        """The way that relieves the force beside the jaw, (3,) [m]; 0 where there is only noise."""
        side = float(np.mean(self._motions.forces(FEEL_S), axis=0) @ across)
        if abs(side) < LEAST_SIDE:
            return np.zeros(3)
        return float(np.clip(side / SIDE_STIFFNESS, -LARGEST_ASIDE, LARGEST_ASIDE)) * across

    def _shift(self, held: HeldTool, way: Array) -> None:
        length = float(np.linalg.norm(way))
        if length > 0.0:
            self._motions.straight("aside", way / length, length, held, speed=SLIDE_SPEED)
            self._aside = self._aside + way

    def _place(self, held: HeldTool) -> Array:
        return self._motions.X_base_ee(held)[:3, 3]

    def _stroke(self, held: HeldTool) -> tuple[Turn, bool]:
        """Turn the nut by a sixth, or until it is tight: the stroke, and whether the jaw has slipped off."""
        motions, work = self._motions, self._work
        angle, torque, measured, slipped, goal = 0.0, max(self.torque or 0.0, 0.0), 0, False, SIXTH + PLAY
        with motions.stages(Stage.TURN):
            while angle < goal - 1e-3 and not slipped and measured < MOST_MEASURED:
                step = (work.torque - torque) / STIFFEST if torque > EASY * work.torque else LARGEST_STEP
                step = min(max(step, LEAST_STEP), LARGEST_STEP, goal - angle)
                angle += self._turn("turn", step, held)
                before, torque = torque, self._measured(held, min(torque + step * STIFFEST / 2, work.torque))
                measured += 1
                motions.observer.message(f"{torque:.1f} Nm after {np.rad2deg(angle):.0f}° of this stroke")
                slipped = torque < SLIPPED_SHARE * before and before > EASY * work.torque
                if self._reached(torque):
                    break
        return Turn(len(self.turns) + 1, motions.station.clock.now(), angle, torque, measured), slipped

    def _measured(self, held: HeldTool, expected: float) -> float:
        """Torque at the nut [Nm]: the difference to that of a jaw which is turned back until it is free of the nut.

        Args:
            held: The wrench.
            expected: What it may be [Nm]. If it is more, the jaw was not yet free, and is turned back farther.
        """
        back, torque = self._wound(held, max(expected, LEAST_WOUND)), 0.0
        for _ in range(RELEASES):
            duration = MEASURE_S if max(expected, torque) > EASY * self._work.torque else QUICK_S
            loaded = self._about_nut(duration)
            self._turn("release", -back, held)
            torque = self._about_nut(duration) - loaded
            self._turn("on again", back, held)
            needed = self._wound(held, torque)
            if needed <= back + UNSURE and (duration == MEASURE_S or torque <= EASY * self._work.torque):
                break
            back = max(back, needed)
        return torque

    def _wound(self, held: HeldTool, torque: float) -> float:
        """Angle to turn a jaw back until it is free [rad]: what hand and jaw yield under a torque [Nm], and play."""
        grip = self._motions.robot.description.hand.grasp.X_hand_tool(0.0)[:3, 3]
        lever = float(np.linalg.norm(held.X_hand_ee[:3, 3] - grip))
        return max(torque, 0.0) * (1.0 / (SIDE_STIFFNESS * lever**2 + TILT_STIFFNESS) + 1.0 / JAW_STIFFNESS) + PLAY

    def _about_nut(self, duration: float) -> float:
        """Torque of the work on the flange about the nut's axis, by the arm's wrench at rest [Nm]."""
        motions = self._motions
        wrench = np.mean(motions.wrenches(duration), axis=0)
        arm = motions.robot.arm.fk(motions.q)[:3, 3] - self._work.point - self._aside
        return float((wrench[3:] + np.cross(arm, wrench[:3])) @ self._work.axis)

    def _turn(self, name: str, angle: float, held: HeldTool) -> float:
        """Turn the wrench about the nut; returns the angle that it has turned [rad]."""
        motions, point = self._motions, self._work.point + self._aside
        before = motions.robot.arm.fk(motions.q)[:3, :3]
        turn = plan_turn(
            motions.robot, motions.config, motions.world(held), motions.q, self._work.axis, point, angle, TURN_SPEED
        )
        guard = ContactGuard(TURN_GUARD, averaging_window=WINDOW_S) if angle > 0.0 else None  # a way back unloads
        motions.execute(name, turn, held, guard, at_work=True)
        R = motions.robot.arm.fk(motions.q)[:3, :3] @ before.T
        turned = float(Rotation.from_matrix(R).as_rotvec() @ self._work.axis)
        if self._on is not None:
            self._on = self._turned(turned, self._on)
        return turned

    def _turned(self, angle: float, way: Array) -> Array:
        """A way (3,) after a turn about the nut."""
        return np.asarray(Rotation.from_rotvec(angle * self._work.axis).apply(way))

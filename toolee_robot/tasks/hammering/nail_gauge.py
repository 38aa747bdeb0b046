"""Measure how far the nail stands out by touching its head and the wood beside it."""

from __future__ import annotations

import numpy as np

from toolee_robot.config import StationConfig
from toolee_robot.control.planning.strike import plan_over_nail, plan_straight
from toolee_robot.control.records import StrikePlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.control.slip import protrusion
from toolee_robot.frames import transform
from toolee_robot.hal import ContactGuard
from toolee_robot.tasks.common.motions import UP, Motions
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import JobEnded, Outcome

TOLERANCE = 0.012
"""[m] A touch further than this from the expected height has not met the nail's head."""
CLEAR = 0.020
"""[m] over the nail's head: where a measurement starts."""
LIFT = 0.006
"""[m] off what was touched, before the face moves aside."""
MARGIN = 0.004
"""[m] over where the wood should be: from there on slowly."""
TOUCH_TIME = 0.024
"""[s] over which a touch is felt: three readings of a CB3, 0.7 mm of way."""
MAX_DEPTH_PER_STRIKE = 0.008
"""[m] No strike of this arm drives a nail further: a head that sinks more has bent away."""
DOUBTED = 0.004
"""[m] Further than a strike usually drives a nail: the wood is touched once more before that is believed."""
ASIDE = 0.032
"""[m] from the nail to where the wood is touched: a face of up to 25 mm radius clears the nail's head."""


class NailGauge:
    """Touches nail and wood with the tool's face.

    The tool slips a little with every strike, so only the difference of two touches tells; it also says where the face
    is now, and `motions.X_hand_ee` is set by it."""

    def __init__(self, motions: Motions, config: StationConfig, robot: RobotModel, observer: TaskObserver) -> None:
        self._motions = motions
        self._config = config
        self._robot = robot
        self._observer = observer
        self._reference = 0.0

    def begin(self, plan: StrikePlan) -> None:
        """Go to a nail of known height and touch it and the wood: what is off is the face's place along its normal."""
        motions, config = self._motions, self._config
        motions.transfer(
            "to the touch", plan_over_nail(self._robot, config, motions.world(), motions.q, plan, before=CLEAR)
        )
        known = config.work.nail_protrusion
        measured = self.measure(known)
        self._reference = known - measured
        if abs(self._reference) > 0.5 * TOLERANCE:
            off = f"{abs(self._reference) * 1e3:.1f} mm too {'high' if measured > known else 'low'}"
            raise JobEnded(Outcome.NAIL_MISSED, f"the nail's head seems to stand {off}: set it as in config.work")

    def measure(self, expected: float, missed: Outcome = Outcome.NAIL_MISSED) -> float:
        """From CLEAR over the nail and back: how far its head stands out [m], about `expected` [m].

        missed: what it means if the head is not there.
        """
        motions = self._motions
        nail = self._touch("nail", CLEAR + TOLERANCE, missed)
        motions.straight("up", UP, LIFT)
        # Towards the handle: the hand goes away from the block.
        aside = motions.X_base_ee[:3, 0] * [1.0, 1.0, 0.0]
        aside /= np.linalg.norm(aside)
        motions.straight("aside", (float(aside[0]), float(aside[1]), 0.0), ASIDE)
        # Fast only as far as the nail stands out for sure: one that sank further than expected must not push the face
        # into the wood.
        expected = max(expected, 0.0)
        fast = max(min(expected, nail) - MARGIN, 0.0)
        motions.straight("down", UP, -fast)
        reach = expected + LIFT + TOLERANCE - fast
        wood = self._touch("wood", reach, Outcome.NAIL_MISSED)
        if nail - wood + self._reference < expected - DOUBTED:
            # What is felt before the wood is there makes the nail seem driven. Nothing is felt below the wood.
            motions.straight("up", UP, LIFT)
            wood = min(wood, self._touch("wood", reach + LIFT, Outcome.NAIL_MISSED))
        motions.straight("up", UP, expected + LIFT + MARGIN)
        measured = nail - wood + self._reference
        # Where the face really is along its normal, from the nail's head that it rested on.
        motions.X_hand_ee = motions.X_hand_ee @ transform(p=[0.0, 0.0, nail - measured])
        return measured

    def _touch(self, what: str, reach: float, missed: Outcome) -> float:
        """Lower the face slowly by up to `reach` [m]; the height [m] over the wood where it seems to be stopped."""
        motions, strike = self._motions, self._config.strike
        if not motions.wait_until_quiet(0.5 * strike.touch_force):
            motions.straight("up", UP, CLEAR)
            raise JobEnded(
                missed, f"before the {what} was touched the arm felt a force: the tool leans against something"
            )
        down = plan_straight(self._robot, self._config, motions.world(), motions.q, -reach, UP, strike.touch_speed)
        report = motions.execute(
            f"touch the {what}", down, ContactGuard(strike.touch_force, averaging_window=TOUCH_TIME), at_work=True
        )
        if report.contact is None:
            motions.straight("up", UP, reach)
            raise JobEnded(missed, f"the face was lowered to where the {what} should be and met nothing")
        X_base_ee = self._robot.X_base_ee(report.contact.q, motions.q_hand, motions.X_hand_ee)
        self._observer.contact(report.contact.stamp, strike.touch_force, X_base_ee)
        return protrusion(X_base_ee, self._config.work.X_base_nail(0.0))

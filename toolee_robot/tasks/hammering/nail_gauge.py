"""Measure the nail's protrusion by touching its head and the wood beside it."""

from __future__ import annotations

import numpy as np

from toolee_robot.control.contact import protrusion
from toolee_robot.control.planning.straight import plan_over_nail
from toolee_robot.control.records import StrikePlan
from toolee_robot.frames import Array, inverse, transform_points
from toolee_robot.hal import ContactGuard
from toolee_robot.station import StationConfig, WorkConfig
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.outcome import JobEnded, Outcome
from toolee_robot.tasks.hammering.nail_watch import nail_of
from toolee_robot.tasks.hammering.touch import Contact, SidewaysContactError, Touch

ASIDE = 0.032
"""Distance from upright nails to the touch point on the wood [m]: a face of up to 25 mm radius clears their heads."""
EDGE = 0.005
"""Distance of that point from the block's edges [m]."""
TURNS = np.deg2rad([0.0, *(sign * turn for turn in range(15, 91, 15) for sign in (1, -1))])
"""Angles from the wanted direction in which the point may lie [rad], the best first."""


def way_to_bare_wood(work: WorkConfig, wanted: Array, height: float) -> Array:
    """Find the way from over a nail to over a point where a face meets bare wood and nothing else.

    It is turned from the wanted direction where another nail is in the way, or where the face would meet its head for
    the wood, or where there is no wood.

    Args:
        work: The work, about the nail.
        wanted: Wanted direction, `base`, (3,), of any length.
        height: Height of the nail's head over the wood [m].

    Returns:
        The way in the plane of the wood, `base`, (3,) [m]; where no direction has a good point, that to the best one.
    """
    out = work.wood_normal
    towards = wanted - (wanted @ out) * out
    towards /= np.linalg.norm(towards)
    across = np.cross(out, towards)
    others = [nail.X_base_nail(h)[:3, 3] for nail in work.others for h in (0.0, nail.nail_protrusion)]
    X_block_base, half = inverse(work.X_base_block), np.array(work.block_size[:2]) / 2
    best, most = np.zeros(3), -np.inf
    for turn in TURNS:
        aside = np.cos(turn) * towards + np.sin(turn) * across
        # A nail that leans has its foot nearer to there, or farther from it, than its head.
        way = (ASIDE + max(0.0, -height * float(aside @ work.nail_axis))) * aside
        steps = work.p_base_entry + np.linspace(0.0, 1.0, 9)[1:, None] * way
        free = [np.linalg.norm(np.cross(steps - end, out), axis=1).min() - ASIDE for end in others]
        wood = np.min(half - np.abs(transform_points(X_block_base, steps[-1:])[0, :2])) - EDGE
        room = float(min([wood, *free]))
        if room > most:
            best, most = way, room
        if room >= 0.0:
            break
    return np.asarray(best)


TOLERANCE = 0.012
"""Largest deviation of a touch from the expected height at which it counts as the nail's head [m]."""
CLEAR = 0.015
"""Height over the nail's head at which a measurement starts [m]; over others that stand beside it, where they are
higher."""
SEEN_MARGIN = 0.008
"""The same of a tool that was touched with and seen since: a look shifts the face by millimetres."""
LIFT = 0.006
"""Height over what was touched at which the face moves aside [m]."""
MARGIN = 0.005
"""Height over the expected head or wood at which the slow approach starts [m]; the tool rarely slips as far in one
strike, and a contact ends the fast way."""
MAX_DEPTH_PER_STRIKE = 0.008
"""Depth that a strike with a hammer of some 0.9 kg drives a nail at most [m]."""
LEAST_RESISTANCE = 80.0
"""Force with which the softest wood holds a nail up, on average over a strike [N]: assumed, a little less than the 85 N
that a simulated club hammer of 1.05 kg met in wood 22 % less dense than told."""
IMPLAUSIBLE_DEPTH = 0.004
"""Progress per strike above which the wood is touched a second time to confirm it [m]; strikes usually drive less."""
NO_HEAD = 0.002
"""Largest height over the wood of what is no nail's head, but the wood: a touch may be off by this [m]."""
CHECK = "see where the face is, and check work.nail_xy, the height of the wood and the camera's calibration"
"""What a person is to do about a nail that is not met."""

Touches = tuple[Contact, Contact]
"""Contacts of a measurement with the nail's head and with the wood."""


def deepest_strike(mass: float, speed: float) -> float:
    """Depth that a strike can drive a nail at most; a head that sinks more has bent.

    Args:
        mass: Mass of the tool [kg].
        speed: Speed of its face at the contact [m/s].

    Returns:
        The depth [m]: all of the tool's kinetic energy against `LEAST_RESISTANCE`, at least `MAX_DEPTH_PER_STRIKE`.
    """
    return max(MAX_DEPTH_PER_STRIKE, 0.5 * mass * speed**2 / LEAST_RESISTANCE)


class NailGauge:
    """Measures the nail's protrusion with the tool's face.

    The tool slips a little with every strike, so the protrusion is the difference of two touches. A measurement also
    determines the face's position along its normal: the held tool comes back with it.

    Args:
        motions: The arm and its motions.
        config: Configuration of the station with this nail.

    Attributes:
        latest: Touches of the last measurement; None before it.
    """

    def __init__(self, motions: Motions, config: StationConfig) -> None:
        self._motions, self._config = motions, config
        self._touch = Touch(motions, config)
        self.latest: Touches | None = None
        self._out = config.work.wood_normal
        self._over = CLEAR  # height over the nail's head at which the next measurement starts [m]
        self._known = 0.0  # height of the nail at the first measurement [m]
        self._first: Touches | None = None  # its touches: nail and wood
        self._corrected: Array | None = None  # the face's place in the hand as the last measurement has left it

    @property
    def noisy(self) -> bool:
        """Whether a measurement may be off by half a millimetre, see `Touch.noisy`."""
        return self._touch.noisy

    def begin(self, plan: StrikePlan, held: HeldTool) -> HeldTool:
        """Touch a nail of known height, and the wood, to find the offset of the face along its normal.

        Args:
            plan: The strike whose line leads to the nail.
            held: What the hand holds.

        Returns:
            The tool, with that offset.

        Raises:
            JobEnded: The offset is too large, or a touch met nothing.
        """
        self.go_over(plan, held)
        known = self._config.work.nail_protrusion
        self._first = self.latest = None
        self._touch.forget()
        measured, held = self.measure(known, held)
        self._known, self._first = known, self.latest
        self._corrected = None  # the place of the face will shift by the offset in the next measurement
        if abs(known - measured) <= 0.5 * TOLERANCE:
            return held
        if abs(measured) < NO_HEAD:
            raise JobEnded(
                Outcome.NAIL_MISSED,
                "the face met nothing above the wood where the nail's head should be. The nail is missing, or the "
                f"face came down beside it; {CHECK}",
            )
        off = f"{abs(known - measured) * 1e3:.1f} mm too {'high' if measured > known else 'low'}"
        raise JobEnded(
            Outcome.NAIL_MISSED,
            f"the nail's head seems to stand {off}. Set the nail as work.nail_protrusion says; {CHECK}",
        )

    def resume(self, plan: StrikePlan, expected: float, held: HeldTool) -> tuple[float, HeldTool]:
        """Measure the nail after an interruption, from wherever the arm stands; the offset stays.

        Args:
            plan: The strike whose line leads to the nail.
            expected: Protrusion before the interruption [m]; an interrupted strike may have driven the nail.
            held: What the hand holds.

        Returns:
            The measured protrusion [m], and the tool with the face's position along its normal.

        Raises:
            JobEnded: A touch met nothing.
        """
        self._corrected = None
        self.go_over(plan, held)
        return self.measure(expected, held)

    def measure(
        self, expected: float, held: HeldTool, strikes: int = 1, missed: Outcome = Outcome.NAIL_MISSED
    ) -> tuple[float, HeldTool]:
        """Measure the protrusion, from where `go_over` ends, or CLEAR over the nail; it ends beside it, above its head.

        Args:
            expected: Expected protrusion [m].
            held: What the hand holds.
            strikes: Number of strikes that it does not know of.
            missed: Outcome of the job if the nail's head is not met.

        Returns:
            The measured protrusion [m], and the tool with the face's position along its normal.

        Raises:
            JobEnded: A touch met nothing, or the tool already touches something before it.
        """
        motions, expected, implausible = self._motions, max(expected, 0.0), strikes * IMPLAUSIBLE_DEPTH
        place = held.X_hand_ee[:3, 3]
        known = self._corrected is not None and np.array_equal(place, self._corrected)  # but for the slip of strikes
        # A strike may have driven the nail, which `expected` does not know of.
        lowest = self._height(held) - self._over - TOLERANCE - implausible
        self._over = CLEAR
        above = expected + (MARGIN if known else SEEN_MARGIN)
        head = self._lower("nail", held, None if self._first is None else above, lowest, missed)
        nail = head.felt
        self._rise_to(nail + LIFT, held)
        # Towards the handle, so that the hand moves away from the block.
        way = way_to_bare_wood(self._config.work, motions.X_base_ee(held)[:3, 0], expected)
        motions.straight("aside", way / np.linalg.norm(way), float(np.linalg.norm(way)), held)
        # The nail may have sunk, never risen: the tool has slipped by at least this.
        slipped, margin = nail - expected, MARGIN if known else MAX_DEPTH_PER_STRIKE
        lowest = min(slipped, 0.0) - TOLERANCE
        wood = self._lower("wood", held, max(slipped, 0.0) + margin, lowest, Outcome.NAIL_MISSED)
        if self.protrusion((head, wood)) < expected - implausible:
            # A force felt above the wood makes the nail seem driven deeper; none can be felt below it.
            self._rise_to(wood.felt + LIFT, held)
            again = self._lower("wood", held, None, lowest, Outcome.NAIL_MISSED)
            if again.felt < wood.felt:
                wood.disbelieve()
                wood = again
        self._rise_to(max(nail, wood.felt) + LIFT + MARGIN, held)
        self.latest = head, wood
        measured = self.protrusion(self.latest)
        # Correct the face's position along its normal, from the nail's head that it rested on.
        motions.carry(held := held.shifted(head.height - measured))
        self._corrected = held.X_hand_ee[:3, 3]
        return measured, held

    def go_over(self, plan: StrikePlan, held: HeldTool, *, near: bool = False) -> None:
        """Move to over the nail and those that stand beside it, by CLEAR, the face square to it.

        Args:
            plan: The strike whose line leads to the nail.
            held: What the hand holds.
            near: Whether the face is over the nail already, as after a strike.

        Raises:
            TooleeError: There is no way there, or the motion failed.
        """
        motions = self._motions
        motions.rise_from_among_nails(held)
        head, out = plan.X_base_ee_contact[:3, 3], self._out
        higher = [float((nail_of(body).head - head) @ out) for body in motions.in_the_way]
        self._over = CLEAR + max([0.0, *higher])
        world = motions.world(held)
        way = plan_over_nail(motions.robot, self._config, world, motions.q, plan, self._over, near=near)
        motions.transfer("to the touch", way, held)

    def protrusion(self, touches: Touches) -> float:
        """Protrusion by the touches of a measurement, and the first two, which met a nail of known height.

        The face is not square to the wood, so that its centre does not come down to either.

        Args:
            touches: Those of nail and wood; what later touches tell of them counts as well.

        Returns:
            The protrusion [m].
        """
        offset = 0.0 if self._first is None else self._known - (self._first[0].height - self._first[1].height)
        return touches[0].height - touches[1].height + offset

    def _height(self, held: HeldTool) -> float:
        """Height of the face's centre over the wood by its estimated pose [m], as `Contact.felt` is."""
        return protrusion(self._motions.X_base_ee(held), self._config.work.X_base_nail(0.0))

    def _rise_to(self, height: float, held: HeldTool) -> None:
        self._motions.straight("up", self._out, max(height - self._height(held), 0.0), held)

    def _lower(self, what: str, held: HeldTool, above: float | None, lowest: float, missed: Outcome) -> Contact:
        """Touch something.

        Args:
            what: What is touched.
            held: What the hand holds.
            above: Height of the face down to which it moves fast [m]; None for nowhere.
            lowest: Least height of the face at which the thing may lie [m].
            missed: Outcome of the job if nothing is met.

        Returns:
            The contact with the thing.

        Raises:
            JobEnded: The face met nothing, or the tool something else.
        """
        motions = self._motions
        if not self._touch.prepare(keep=what == "wood"):
            motions.straight("up", self._out, CLEAR, held)
            message = f"the arm felt a force before it touched the {what}: the tool leans against something"
            raise JobEnded(missed, message)
        begin = self._height(held)
        if above is not None and above < begin:
            guard = ContactGuard(self._config.strike.contact_force)
            if motions.straight("down", self._out, above - begin, held, guard):
                # The thing stands higher than expected, or the arm's own motion was felt: slowly from the start.
                self._rise_to(begin, held)
        reach = self._height(held) - lowest
        try:
            contact = self._touch.lower(what, reach, held)
        except SidewaysContactError as error:
            motions.straight("up", self._out, CLEAR, held)
            message = f"something pressed on the tool's side with {error.force:.0f} N on the way to the {what}"
            raise JobEnded(Outcome.NAIL_MISSED, f"{message}: the face is not where it is estimated; {CHECK}") from error
        if contact is None:
            motions.straight("up", self._out, reach, held)
            raise JobEnded(missed, f"the face went down to the expected {what} and met nothing; {CHECK}")
        return contact

"""What a person measures after a trial, and the outcome that follows from it and from what the robot believes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from toolee_robot.station import StationConfig

Ask = Callable[[str], str]
"""Shows a question and returns the line that was typed; raises EOFError where nobody can answer any more."""
NOT_MEASURABLE = "-"
"""The answer of a person who cannot measure a nail: it has come out, or its head has come off."""
DEEPEST = -20.0
"""[mm] Least height over the wood that is believed: no hammer drives a nail's head deeper."""


@dataclass(frozen=True)
class MeasuredNail:
    """A nail, as a person found it.

    Attributes:
        name: Its name.
        protrusion_mm: Height of the top of its head over the wood, by calipers [mm]; None where it cannot be measured.
        bent: Whether it leans by 10° or its head was pushed 3 mm aside.
        flush: Whether it is driven as a job must drive it.
    """

    name: str
    protrusion_mm: float | None
    bent: bool
    flush: bool


@dataclass(frozen=True)
class Judgement:
    """What a person found after a job.

    Attributes:
        nails: Each nail that was to be driven.
        slipped: Whether the tool slipped in the hand.
    """

    nails: tuple[MeasuredNail, ...]
    slipped: bool

    @property
    def flush(self) -> bool:
        """Whether every nail is."""
        return all(nail.flush for nail in self.nails)

    def outcome(self, figures: dict[str, Any]) -> dict[str, Any]:
        """The outcome of the trial: the person's, whatever the robot believes.

        What is asked of a job is a nail that is flush, and calipers tell it; the touch by which the robot measures it
        is a part of what is tried. The robot's own verdict stays beside it, as `robot`, and the report tells where they
        disagree. Where both say that the job failed, the cause is the robot's.

        Args:
            figures: The job's, as of `run_job`.

        Returns:
            The trial's.
        """
        robot = {name: figures[name] for name in ("success", "outcome", "reason")}
        made = {**figures, "success": self.flush, "robot": robot, "person": asdict(self)}
        if self.flush:
            made |= {"outcome": "flush", "reason": f"the person measured {self._heights()}"}
        elif robot["success"]:
            outcome = "bent" if any(nail.bent for nail in self.nails) else "not_flush"
            made |= {"outcome": outcome, "reason": f"the robot takes it for flush; the person found {self._heights()}"}
        return made

    def _heights(self) -> str:
        return ", ".join(
            f"{nail.name} {'not measurable' if nail.protrusion_mm is None else f'{nail.protrusion_mm:g} mm'}"
            f"{' and bent' if nail.bent else ''}"
            for nail in self.nails
        )


def judged(config: StationConfig, nails: Sequence[str], ask: Ask, tell: Callable[[str], object]) -> Judgement:
    """Ask a person for what only a person can measure. Every question is asked until it is answered.

    Args:
        config: What the job was told of the station.
        nails: Names of the nails that were to be driven.
        ask: Asks the person.
        tell: Tells the person why an answer is none.

    Returns:
        The answers.

    Raises:
        EOFError: Nobody answers.
    """
    flush = config.task.flush_protrusion * 1e3
    found = []
    for name, work in config.work.each():
        if name not in nails:
            continue
        of = f" {name}" if len(nails) > 1 else ""
        height = _height(
            f"Nail{of}: height of its head over the wood by calipers, in mm, below it with a minus "
            f"({NOT_MEASURABLE}: it cannot be measured)? ",
            1e3 * work.nail_length, ask, tell,
        )  # fmt: skip
        bent = yes(f"Nail{of}: does it lean by 10° or more, or was its head pushed 3 mm aside? y: yes, n: no? ", ask)
        found.append(MeasuredNail(name, height, bent, height is not None and height <= flush and not bent))
    slipped = yes("Did the tool slip in the hand? y: yes, n: no? ", ask)
    return Judgement(tuple(found), slipped)


def yes(question: str, ask: Ask) -> bool:
    """Ask a question until it is answered with yes or no.

    Args:
        question: The question.
        ask: Asks the person.

    Returns:
        Whether the answer is yes.
    """
    return choice(question, "yn", ask) == "y"


def choice(question: str, letters: str, ask: Ask) -> str:
    """Ask a question until the answer begins with one of some letters.

    Args:
        question: The question, which says what the letters mean.
        letters: The letters.
        ask: Asks the person.

    Returns:
        The letter.
    """
    while True:
        answer = ask(question).strip().lower()[:1]
        if answer and answer in letters:
            return answer


def words(question: str, ask: Ask) -> str:
    """Ask a question until something is said.

    Args:
        question: The question.
        ask: Asks the person.

    Returns:
        The answer.
    """
    while not (answer := ask(question).strip()):
        pass
    return answer


def _height(question: str, length: float, ask: Ask, tell: Callable[[str], object]) -> float | None:
    while True:
        answer = ask(question).strip().replace(",", ".")
        if answer == NOT_MEASURABLE:
            return None
        try:
            height = float(answer)
        except ValueError:
            tell(f"{answer!r} is no number")
            continue
        if DEEPEST <= height <= length:
            return height
        tell(f"{answer} mm: the nail is {length:g} mm long; give the height of its head over the wood in mm")

"""What a person at the terminal decides after a stop with the tool in the hand."""

from __future__ import annotations

from collections.abc import Callable

from rich.console import Console

from toolee_robot.errors import DeviceError
from toolee_robot.tasks.common.outcome import HammerResult, Outcome
from toolee_robot.tasks.hammering.task import HammeringTask

QUESTION = "Look at the robot. r: resume the job, t: take the hammer out of the hand, q: quit? "
QUESTION_LAST = "The job cannot go on. t: take the hammer out of the hand, q: quit? "
FIRM = "Is somebody holding the hammer firmly? The hand opens. y: yes, n: no? "
"""The questions."""
ASKED_AFTER = (Outcome.DEVICE_FAULT, Outcome.PERSON_NEAR, Outcome.TOOL_LOST, Outcome.WEIGHT_UNKNOWN)
"""Outcomes that leave the arm where it stopped, or at the handover with a tool whose weight is not known."""


def after_stop(
    task: HammeringTask,
    result: HammerResult,
    ask: Callable[[str], str],
    console: Console,
    resume: Callable[[], HammerResult],
) -> HammerResult:
    """Ask a person what to do about a job that stopped with the tool in the hand, until it is out or the job has ended.

    Args:
        task: The job.
        result: Its result so far.
        ask: Shows a question and returns the line that was typed; EOFError counts as quitting.
        console: The console.
        resume: Resumes the job, with its progress shown.

    Returns:
        The job's last result.
    """
    while task.holds_tool and result.outcome in ASKED_AFTER:
        console.print(result.reason, markup=False)
        answer = _answer(ask, QUESTION if task.resumable else QUESTION_LAST)
        if answer == "r" and task.resumable:
            result = resume()
        elif answer == "t" and _answer(ask, FIRM) == "y":
            _take_out(task, console)
        elif answer == "q":
            break
    return result


def _take_out(task: HammeringTask, console: Console) -> None:
    try:
        opened = task.give_back()
    except DeviceError as error:
        console.print(f"the hand did not open: {error}", markup=False)
        return
    console.print("the hand is open" if opened else "nobody confirmed that they hold the hammer: the hand stays closed")


def _answer(ask: Callable[[str], str], question: str) -> str:
    try:
        return ask(question).strip().lower()[:1]
    except EOFError:
        return "q"

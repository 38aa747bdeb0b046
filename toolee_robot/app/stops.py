"""What a person at the terminal decides after a stop with the tool in the hand."""

from __future__ import annotations

from toolee_robot.app.observer import JobObserver
from toolee_robot.errors import DeviceError
from toolee_robot.tasks.common.outcome import HammerResult, Outcome
from toolee_robot.tasks.hammering.task import HammeringTask

QUESTION = "Look at the robot. r: resume the job, t: take the hammer out of the hand, q: quit? "
QUESTION_LAST = "The job cannot go on. t: take the hammer out of the hand, q: quit? "
FIRM = "Is somebody holding the hammer firmly? The hand opens. y: yes, n: no? "
"""The questions."""
ASKED_AFTER = (Outcome.DEVICE_FAULT, Outcome.PERSON_NEAR, Outcome.TOOL_LOST, Outcome.WEIGHT_UNKNOWN)
"""Outcomes that leave the arm where it stopped, or at the handover with a tool whose weight is not known."""


def after_stop(task: HammeringTask, result: HammerResult, observer: JobObserver) -> HammerResult:
    """Ask a person what to do about a job that stopped with the tool in the hand, until it is out or the job has ended.

    Args:
        task: The job.
        result: Its result so far.
        observer: Asks the person; where nobody answers, the job has ended.

    Returns:
        The job's last result.
    """
    while task.holds_tool and result.outcome in ASKED_AFTER:
        answer = _answer(observer, f"{result.reason}\n{QUESTION if task.resumable else QUESTION_LAST}")
        if answer == "r" and task.resumable:
            with observer.live():
                result = task.resume(confirmed=True)
        elif answer == "t" and _answer(observer, FIRM) == "y":
            _take_out(task, observer)
        elif answer == "q":
            break
    return result


def _take_out(task: HammeringTask, observer: JobObserver) -> None:
    try:
        opened = task.give_back()
    except DeviceError as error:
        observer.message(f"the hand did not open: {error}")
        return
    observer.message("the hand is open" if opened else "nobody confirmed that they hold the hammer: it stays closed")


def _answer(observer: JobObserver, question: str) -> str:
    try:
        answer = observer.ask(question)
    except EOFError:
        answer = None
    return "q" if answer is None else answer.strip().lower()[:1]

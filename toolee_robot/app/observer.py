"""Who hears of what a function of this room does, and who watches a job and answers for the person at the terminal."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.tasks.common.observer import TaskObserver


class Waiting(Protocol):
    """Work that takes a while."""

    def update(self, text: str, /) -> None:
        """What it does now."""


class Listener(Protocol):
    """A person at a terminal, or nobody."""

    def say(self, text: str) -> None:
        """What is going on."""

    def warn(self, text: str) -> None:
        """What the person should look at, although it goes on."""

    def prompt(self, text: str) -> None:
        """What the person is to do now."""

    def doing(self, text: str) -> None:
        """What a device is doing."""

    def waiting(self, text: str) -> AbstractContextManager[Waiting]:
        """Context of work that takes a while."""


class JobObserver(TaskObserver):
    """Base class of those who watch a job. This one shows nothing and answers nothing."""

    def doing(self, text: str) -> None:
        """Called with what is being set up, before the job begins."""

    def prompt(self, text: str) -> None:
        """Called with what the person at the station is to do."""

    def opened(self, title: str, mode: str, recorder: RunRecorder) -> None:
        """Called when the devices are open.

        Args:
            title: The tool in words.
            mode: What is real and what is not, in words.
            recorder: The recorder of the job.
        """

    def live(self) -> AbstractContextManager[None]:
        """Context in which the task runs."""
        return nullcontext()

    def ask(self, question: str) -> str | None:
        """Ask the person at the terminal after a stop.

        Args:
            question: The question.

        Returns:
            The line that was typed; None where nobody answers.
        """
        _ = question
        return None

"""A scripted person at the station."""

from __future__ import annotations

from collections.abc import Callable


class People:
    """A `hal.Person` with scripted answers, who records the questions.

    Args:
        gives: Answer to `request_handover`.
        steps_back: Answer to `release`.
        on_release: Called at `release`; None for nothing.

    Attributes:
        gives: Answer to `request_handover`.
        steps_back: Answer to `release`.
        takes: Answer to `take_tool`.
        confirms: Answer to `confirm_swing`.
        is_inside: Whether the person is within the arm's reach.
        holds_switch: Whether the person holds the enabling switch.
        on_release: Called at `release`.
        asked: The questions so far.
    """

    def __init__(
        self, gives: bool = True, steps_back: bool = True, on_release: Callable[[], None] | None = None
    ) -> None:
        self.gives, self.steps_back = gives, steps_back
        self.takes, self.confirms = True, True
        self.is_inside, self.holds_switch = False, True
        self.on_release = on_release
        self.asked: list[str] = []

    def take_tool(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """See `hal.Person`."""
        self.asked.append("take")
        return self.takes

    def confirm_swing(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """See `hal.Person`."""
        self.asked.append("swing")
        return self.confirms

    def zone_occupied(self) -> bool:
        """See `hal.Person`."""
        return self.is_inside

    def enabling_switch_held(self) -> bool:
        """See `hal.Person`."""
        return self.holds_switch

    def step_in(self) -> None:
        self.is_inside = True

    def request_handover(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """See `hal.Person`."""
        self.asked.append("handover")
        return self.gives

    def release(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """See `hal.Person`."""
        self.asked.append("release")
        if self.on_release is not None:
            self.on_release()
        return self.steps_back

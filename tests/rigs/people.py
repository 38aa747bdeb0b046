"""A scripted person at the station."""

from __future__ import annotations

from collections.abc import Callable


class People:
    """A `hal.Person` with scripted answers, who records the questions.

    Attributes:
        gives: Answer to `request_handover`.
        steps_back: Answer to `release`.
        takes: Answer to `take_tool`.
        confirms: Answer to `confirm_swing`.
        inspects: Answer to `confirm_inspection`.
        is_inside: Whether the person is within the arm's reach although nothing asks them to be there.
        holds_switch: Whether the person takes the hold-to-run switch when asked to.
        on_release: Called at `release`.
        asked: The questions so far.
    """

    def __init__(
        self, gives: bool = True, steps_back: bool = True, on_release: Callable[[], None] | None = None
    ) -> None:
        self.gives, self.steps_back = gives, steps_back
        self.takes, self.confirms, self.inspects = True, True, True
        self._at_hand, self._switch_taken = False, False
        self.is_inside, self.holds_switch = False, True
        self.on_release = on_release
        self.asked: list[str] = []

    def take_tool(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        self.asked.append("take")
        self._at_hand, self._switch_taken = self.takes, False
        return self.takes

    def confirm_swing(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        self.asked.append("swing")
        return self.confirms

    def confirm_inspection(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        self.asked.append("inspection")
        return self.inspects

    def hold_switch(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        self._switch_taken = self.holds_switch
        return self.holds_switch

    def zone_occupied(self) -> bool:
        """See `hal.Person`: while the tool is handed over somebody is there."""
        return self.is_inside or self._at_hand

    def readings_certain(self) -> bool:
        return True

    def hold_to_run_held(self) -> bool:
        return self.holds_switch and self._switch_taken

    def step_in(self) -> None:
        self.is_inside = True

    def request_handover(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        self.asked.append("handover")
        self._at_hand, self._switch_taken = True, False
        return self.gives

    def release(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        self.asked.append("release")
        if self.on_release is not None:
            self.on_release()
        self._at_hand = not self.steps_back
        return self.steps_back

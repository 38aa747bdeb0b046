"""A scripted person at the station."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import Array, transform
from toolee_robot.sim_backend.truth import PerfectPerception, Truth
from toolee_robot.types import CameraError, HoldingHand, InHandEstimate, RgbdFrame, ToolEstimate


class People:
    """A `hal.Person` with scripted answers, who records the questions."""

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


Change = Callable[[InHandEstimate], InHandEstimate]


class ScriptedPerception(PerfectPerception):
    """Perfect perception whose fused estimates are changed."""

    def __init__(self, judge: Truth, *changes: Change) -> None:
        super().__init__(judge)
        self.changes = list(changes) or [right]
        self.hands: list[Array] = []
        self.sees = True

    def estimate(
        self, frame: RgbdFrame, hand: HoldingHand | None = None, categories: Sequence[Category] = CATEGORIES
    ) -> list[ToolEstimate]:
        return super().estimate(frame, hand, categories) if self.sees else []

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],
        Xs_camera_hand: Sequence[Array],
        category: Category | None = None,
        camera: CameraError | None = None,
    ) -> InHandEstimate:
        self.hands.append(Xs_camera_hand[-1])
        change = self.changes.pop(0) if len(self.changes) > 1 else self.changes[0]
        return change(super().fuse(estimates_per_frame, Xs_camera_hand, category, camera))


def right(estimate: InHandEstimate) -> InHandEstimate:
    """Leave the estimate unchanged."""
    return estimate


def unsure(estimate: InHandEstimate) -> InHandEstimate:
    """Make the estimate unusable."""
    return replace(estimate, usable=False, reason="sigma 31 mm")


def moved(p: Sequence[float]) -> Change:
    """Displace the estimate by p, (3,) [m], along the face's own axes."""
    return lambda e: replace(e, X_hand_ee=e.X_hand_ee @ transform(p=p))

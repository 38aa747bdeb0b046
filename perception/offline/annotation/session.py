"""A person at work on a set of frames: where they are, and what they do; every change is saved at once."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from toolee_robot.errors import UserError
from toolee_robot.perception.offline.annotation.clicks import Click, ClickedEnd, ClickedFrame
from toolee_robot.perception.offline.annotation.frame_set import AnnotatedFrame, FrameSet
from toolee_robot.perception.offline.annotation.protocol import BOX, PROTOCOL, Asked, Role, Shape


class Session:
    """Work on a set.

    Args:
        frames: The set.

    Attributes:
        frames: The set.
        number: Index of the frame that is looked at.
        end: Index of the end effector that clicks belong to; -1 where the frame has none.
    """

    def __init__(self, frames: FrameSet) -> None:
        self.frames = frames
        self.number, self.end = 0, -1
        self._annotated: AnnotatedFrame | None = None
        todo = [k for k, name in enumerate(frames.names) if name not in frames.clicks.frames]
        self.look_at(todo[0] if todo else 0)

    @property
    def name(self) -> str:
        """Name of the frame that is looked at."""
        return self.frames.names[self.number]

    @property
    def clicked(self) -> ClickedFrame:
        """What was said of this frame."""
        return self.frames.clicks.frames.get(self.name, ClickedFrame())

    @property
    def current(self) -> ClickedEnd | None:
        """The end effector that clicks belong to."""
        return self.clicked.ends[self.end] if self.end >= 0 else None

    @property
    def annotated(self) -> AnnotatedFrame:
        """This frame with its fits."""
        if self._annotated is None:
            self._annotated = self.frames.annotate(self.name, self._images)
        return self._annotated

    def look_at(self, number: int) -> None:
        """Go to a frame, by its index; beyond the ends to the first or last one. Raises UserError if unreadable."""
        number = min(max(number, 0), len(self.frames.names) - 1)
        self._images = self.frames.read(self.frames.names[number])
        self.number = number
        self._annotated = None
        self.end = len(self.clicked.ends) - 1

    def choose_end(self, end: int) -> None:
        """Let clicks belong to an end effector of this frame, by its index."""
        self.end = min(max(end, 0), len(self.clicked.ends) - 1)

    def add_end(self, shape: Shape) -> None:
        """Begin with another end effector."""
        ends = (*self.clicked.ends, ClickedEnd(shape))
        self._change(ClickedFrame(False, ends))
        self.end = len(ends) - 1

    def remove_end(self) -> None:
        """Forget the current end effector."""
        ends = tuple(e for k, e in enumerate(self.clicked.ends) if k != self.end)
        self.end = len(ends) - 1
        self._change(ClickedFrame(False, ends))

    def say_no_tool(self, no_tool: bool) -> None:
        """Say that the frame shows no end effector, or take it back.

        Args:
            no_tool: Whether there is none.

        Raises:
            UserError: End effectors are clicked in it.
        """
        if no_tool and self.clicked.ends:
            raise UserError("this frame has clicked ends: remove them first", code="user.ends_clicked")
        self._change(ClickedFrame(no_tool))

    def click(self, role: Role, u: float, v: float) -> None:
        """Add a click.

        Args:
            role: What it shows.
            u: Column [px].
            v: Row [px].

        Raises:
            UserError: There is no end effector to add it to.
        """
        self._change_end(self._needed().with_click(Click(role, round(u, 2), round(v, 2))))

    def undo(self) -> None:
        """Take back the last click of the current end effector. Raises UserError where there is no end effector."""
        end = self._needed()
        self._change_end(replace(end, clicks=end.clicks[:-1]))

    def enter(self, **measured: Any) -> None:
        """Enter what was measured by hand.

        Args:
            **measured: `caliper_mm` or `tape_mm`, in millimetres or None.

        Raises:
            UserError: There is no end effector.
        """
        self._change_end(replace(self._needed(), **measured))

    def enter_tape_offset(self, offset_mm: float | None) -> None:
        """Enter how far the depth's origin lies behind the tape's beginning [mm]."""
        self._annotated = None
        self.frames.change(replace(self.frames.clicks, tape_offset_mm=offset_mm))

    def roles(self) -> dict[Role, Asked]:
        """What can be clicked on the current end effector."""
        return {} if self.current is None else {**PROTOCOL[self.current.shape].clicks, Role.BOX: BOX}

    def next_role(self) -> Role | None:
        """The first role of which there are fewer clicks than advised; None: there are enough, or no end effector."""
        if self.current is None:
            return None
        asked = PROTOCOL[self.current.shape].clicks.items()
        return next((role for role, a in asked if len(self.current.of(role)) < a.advised), None)

    def _needed(self) -> ClickedEnd:
        if self.current is None:
            raise UserError("choose first what the clicks show: add an end", code="user.no_end")
        return self.current

    def _change_end(self, end: ClickedEnd) -> None:
        ends = list(self.clicked.ends)
        ends[self.end] = end
        self._change(ClickedFrame(False, tuple(ends)))

    def _change(self, frame: ClickedFrame) -> None:
        self._annotated = None
        self.frames.change(self.frames.clicks.with_frame(self.name, frame))

"""The folder of a test: recorded frames, the clicks on them, `frames.json`, and a person's work on all that."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from toolee_robot.errors import UserError
from toolee_robot.perception.io import BopImage, bop_images
from toolee_robot.perception.offline.annotation.clicks import (
    BOX,
    CLICKS,
    PROTOCOL,
    Asked,
    Click,
    ClickedEnd,
    ClickedFrame,
    ClicksFile,
    Role,
    Shape,
    read_clicks,
    write_clicks,
)
from toolee_robot.perception.offline.annotation.poses import AnnotatedEnd, annotate_end, clicked_box
from toolee_robot.runtime.files import read_json, write_atomic
from toolee_robot.types import RgbdFrame

FRAMES = "frames.json"
_SOURCE = "derived_from"


@dataclass(frozen=True, eq=False)
class AnnotatedFrame:
    """A frame whose clicks were fitted.

    Attributes:
        name: Its name.
        frame: Colour and depth.
        clicked: The clicked end effectors.
        ends: For each of them its pose, or why there is none.
    """

    name: str
    frame: RgbdFrame
    clicked: tuple[ClickedEnd, ...]
    ends: tuple[AnnotatedEnd | UserError, ...]

    @property
    def complete(self) -> bool:
        """Whether every end effector has a pose or at least a clicked box; another frame is left out of the test."""
        pairs = zip(self.clicked, self.ends, strict=True)
        return all(isinstance(end, AnnotatedEnd) or len(clicked.of(Role.BOX)) == 2 for clicked, end in pairs)

    @property
    def annotated(self) -> list[AnnotatedEnd]:
        """The end effectors with a pose."""
        return [end for end in self.ends if isinstance(end, AnnotatedEnd)]


class FrameSet:
    """A folder of frames with the clicks on them.

    Args:
        folder: A recording by `toolee camera record`, or another folder in the BOP layout.
        clicks: A file of clicks to use instead of the folder's own; it is copied there.

    Attributes:
        names: The frames' names, in their order.
        clicks: The clicks.

    Raises:
        UserError: The folder has no frames, a `frames.json` that was not made here, or clicks on frames that it lacks.
        ConfigError: The file of clicks is wrong.
    """

    def __init__(self, folder: Path, clicks: Path | None = None) -> None:
        self.folder = folder
        self._images = {f"{image.im_id:06d}": image for image in bop_images(folder)}
        self.names = list(self._images)
        self._refuse_foreign()
        own = folder / CLICKS
        source = own if clicks is None else clicks
        new = clicks is None and not own.exists()
        self.clicks = ClicksFile(folder.resolve().name) if new else read_clicks(source)
        if self.clicks.half not in ("A", "B"):
            raise UserError(f"{source}: half {self.clicks.half}: it is A or B", code="user.clicks_file")
        if clicks is not None and own.exists() and read_clicks(own) != self.clicks:
            raise UserError(
                f"{own} holds other clicks than {clicks} and would be overwritten: move it away, or leave out --clicks",
                code="user.clicks_exist",
            )
        unknown = sorted(set(self.clicks.frames) - set(self.names))
        if unknown:
            raise UserError(
                f"{source} has clicks on frame {unknown[0]}, which {folder} lacks: is it another folder's file?",
                code="user.clicks_file",
            )

    def read(self, name: str) -> RgbdFrame:
        """The images of a frame. Raises UserError where they are unusable."""
        return self._images[name].read()

    def annotate(self, name: str, frame: RgbdFrame | None = None) -> AnnotatedFrame:
        """Fit the clicks on a frame.

        Args:
            name: The frame.
            frame: Its images, where they are read already.

        Returns:
            The frame with its ends; without any where it has not been looked at.

        Raises:
            UserError: Its images are unusable.
        """
        images = self.read(name) if frame is None else frame
        ends: list[AnnotatedEnd | UserError] = []
        every = self.clicks.frames.get(name, ClickedFrame()).ends
        for clicked in every:
            try:
                ends.append(annotate_end(images, clicked, self.clicks.tape_offset_mm))
            except UserError as error:
                ends.append(error)
        return AnnotatedFrame(name, images, every, tuple(ends))

    def change(self, clicks: ClicksFile) -> None:
        """Take other clicks, and save them. Raises UserError where the folder cannot be written."""
        write_clicks(self.folder / CLICKS, clicks)
        self.clicks = clicks

    def write(self) -> list[AnnotatedFrame]:
        """Fit all clicks and write `frames.json`, the clicks beside it.

        Returns:
            The frames that were looked at; those with an end without pose and box are not in `frames.json`.

        Raises:
            UserError: Images are unusable, or the folder cannot be written.
        """
        write_clicks(self.folder / CLICKS, self.clicks)
        looked_at = [name for name in self.names if self._decided(name)]
        frames = [self.annotate(name) for name in looked_at]
        entries = [self._entry(f) for f in frames if f.complete]
        data = json.dumps({_SOURCE: CLICKS, "frames": entries}, indent=1)
        write_atomic(self.folder / FRAMES, data.encode() + b"\n")
        return frames

    def _decided(self, name: str) -> bool:
        clicked = self.clicks.frames.get(name)
        return clicked is not None and (clicked.no_tool or bool(clicked.ends))

    def _entry(self, annotated: AnnotatedFrame) -> dict[str, Any]:
        image: BopImage = self._images[annotated.name]
        k = annotated.frame.intrinsics
        return {
            "name": annotated.name,
            "place": self.clicks.place,
            "half": self.clicks.half,
            "rgb": str(image.rgb.relative_to(self.folder)),
            "depth": str(image.depth.relative_to(self.folder)),
            "depth_scale": image.scale * 1000.0,
            "depth_is": "measured",
            "intrinsics": [k.fx, k.fy, k.cx, k.cy],
            "ends": [_end(*pair) for pair in zip(annotated.clicked, annotated.ends, strict=True)],
            "ignore": [],
        }

    def _refuse_foreign(self) -> None:
        path = self.folder / FRAMES
        if not path.exists():
            return
        try:
            ours = _SOURCE in read_json(path)
        except (OSError, ValueError, TypeError):
            ours = False
        if not ours:
            raise UserError(
                f"{path} was not made by `toolee annotate`, which would overwrite it: move it away first",
                code="user.frames_exist",
            )


def _end(clicked: ClickedEnd, end: AnnotatedEnd | UserError) -> dict[str, Any]:
    box = end.box if isinstance(end, AnnotatedEnd) else clicked_box(clicked)
    assert box is not None
    fields: dict[str, Any] = {"category": str(clicked.shape.category), "box": [round(v, 1) for v in box]}
    if isinstance(end, AnnotatedEnd) and end.known:
        X = end.fit.X_camera_ee.round(7).tolist()
        fields |= {"X_camera_ee": X, "covariance": [[float(f"{v:.5g}") for v in row] for row in end.fit.covariance]}
    return fields


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


def end_record(name: str, end: AnnotatedEnd | UserError) -> dict[str, Any]:
    """What `toolee annotate` prints of an end effector of a frame.

    Args:
        name: Name of the frame.
        end: The end effector, or why it has no pose.

    Returns:
        The values for `--json`; "cells" are those of the printed table.
    """
    if not isinstance(end, AnnotatedEnd):
        cells = [name, "no pose", "-", "-", "-", "-"]
        return {"frame": name, "problem": str(end), "code": end.code, "known": False, "cells": cells}
    checks = ", ".join(
        f"{c.measured_mm:.1f}: {c.fitted_mm:.1f} mm{'' if c.agrees else ' DISAGREES'}" for c in end.checks
    )
    label, scale = end.category.label, f"{end.fit.scale:.1f}x"
    cells = [name, label, f"{end.sigma_mm:.1f}", f"{end.sigma_deg:.1f}", scale, checks or "-"]
    return {
        "frame": name,
        "problem": None,
        "known": end.known,
        "category": str(end.category),
        "X_camera_ee": end.fit.X_camera_ee.tolist(),
        "sigma_mm": end.sigma_mm,
        "sigma_deg": end.sigma_deg,
        "scale": end.fit.scale,
        "wrong": end.fit.wrong,
        "checks": [asdict(c) | {"agrees": c.agrees} for c in end.checks],
        "cells": cells,
    }

"""The page of `toolee annotate`: a frame, the clicks on it, and what they say."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from toolee_robot.errors import UserError
from toolee_robot.perception.offline.annotation.clicks import PROTOCOL, Role
from toolee_robot.perception.offline.annotation.frame_set import Session
from toolee_robot.perception.offline.annotation.poses import AnnotatedEnd
from toolee_robot.viewer.annotation_scene import COLORS, AnnotationScene

ZOOMS = {"whole": 1.0, "3x": 3.0, "8x": 8.0}
NOTHING, ENOUGH = "none yet", "nothing"


class AnnotationPage:
    """Serves the page on a loopback address, until it is closed.

    Args:
        session: The work on the set.
        port: Port of the page; the next free one is taken where it is in use.

    Attributes:
        scene: The picture.

    Raises:
        UserError: viser is not installed, or the frame is unreadable.
    """

    def __init__(self, session: Session, port: int) -> None:
        self._session = session
        self._lock = threading.RLock()
        self._problem = ""
        self.scene = AnnotationScene(port, self._click)
        self._build()
        self.scene.show_frame(session.annotated)
        self._refresh()

    @property
    def address(self) -> str:
        """Address of the page."""
        return self.scene.address

    @property
    def text(self) -> str:
        """What the panel says of the current end effector, in Markdown."""
        return str(self._result.content)

    def close(self) -> None:
        """Stop serving."""
        self.scene.close()

    def refresh(self) -> None:
        """Show what the session holds, after a change that was not made on the page."""
        with self._lock:
            self._refresh()

    def _build(self) -> None:
        gui = self.scene.server.gui
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        self._head = gui.add_markdown("")
        self._go = gui.add_button_group("Frame", ("previous", "next", "next unseen"))
        self._go.on_click(self._handled(lambda: self._walk(str(self._go.value))))
        self._no_tool = gui.add_checkbox("No tool in this frame", False)
        self._no_tool.on_update(self._chosen(lambda: self._session.say_no_tool(bool(self._no_tool.value))))
        self._view = gui.add_button_group("View", ("photograph", "cloud"))
        self._view.on_click(self._handled(lambda: self._look(self._zoomed)))
        self._zoom = gui.add_button_group("Zoom", tuple(ZOOMS))
        self._zoom.on_click(self._handled(lambda: self._look(ZOOMS[str(self._zoom.value)])))
        self._zoomed = 1.0
        with gui.add_folder("End effector"):
            kinds = tuple(p.label for p in PROTOCOL.values())
            self._kind = gui.add_dropdown("Kind", kinds)
            self._add = gui.add_button_group("", ("add", "remove"))
            self._add.on_click(self._handled(lambda: self._add_or_remove(str(self._add.value))))
            self._end: Any = gui.add_dropdown("Clicks are on", (NOTHING,))
            self._end.on_update(self._chosen(lambda: self._session.choose_end(self._ends.index(str(self._end.value)))))
            self._role: Any = gui.add_dropdown("Next click shows", (NOTHING,))
            self._role.on_update(self._chosen(lambda: None))
            self._where = gui.add_markdown("")
            self._undo = gui.add_button("Undo the last click")
            self._undo.on_click(self._handled(self._session.undo))
            self._caliper = gui.add_text("Caliper [mm]", "")
            self._caliper.on_update(self._chosen(lambda: self._session.enter(caliper_mm=_number(self._caliper.value))))
            self._tape = gui.add_text("Tape [mm]", "", hint="From the start of the tape to the end effector's origin.")
            self._tape.on_update(self._chosen(lambda: self._session.enter(tape_mm=_number(self._tape.value))))
            self._offset = gui.add_text(
                "Tape offset [mm]",
                "",
                hint="How far the depth's origin lies behind the start of the tape (camera's data sheet).",
            )
            self._offset.on_update(self._chosen(lambda: self._session.enter_tape_offset(_number(self._offset.value))))
        self._result = gui.add_markdown("")
        self._ends = [NOTHING]
        self._roles: dict[str, Role | None] = {NOTHING: None}

    def _handled(self, act: Callable[[], None]) -> Callable[[Any], None]:
        """A callback that does something, tells what was wrong, and brings the page up to date."""

        def callback(event: Any) -> None:
            with self._lock:
                self._problem = ""
                try:
                    act()
                except UserError as error:
                    self._problem = str(error)
                self._refresh(advance=event is None)

        return callback

    def _chosen(self, act: Callable[[], None]) -> Callable[[Any], None]:
        """As `_handled`, of a value that a person changed, not the program."""
        handled = self._handled(act)
        return lambda event: handled(event) if event.client is not None else None

    def _click(self, u: float, v: float) -> None:
        role = self._roles[str(self._role.value)]
        if role is not None:
            self._handled(lambda: self._session.click(role, u, v))(None)

    def _walk(self, where: str) -> None:
        session = self._session
        number = session.number + (-1 if where == "previous" else 1)
        if where == "next unseen":
            seen, names = session.frames.clicks.frames, session.frames.names
            number = next((k for k in range(number, len(names)) if names[k] not in seen), number)
        session.look_at(number)
        self.scene.show_frame(session.annotated)
        self._zoomed = 1.0

    def _look(self, zoom: float) -> None:
        self._zoomed = zoom
        current = self._session.current
        clicks = [(c.u, c.v) for c in current.clicks if c.role is not Role.HANDLE] if current is not None else []
        about = np.mean(clicks, axis=0) if clicks else None
        self.scene.look("cloud" if self._view.value == "cloud" else "photograph", zoom, about)

    def _add_or_remove(self, what: str) -> None:
        if what == "add":
            self._session.add_end(next(s for s, p in PROTOCOL.items() if p.label == self._kind.value))
        else:
            self._session.remove_end()

    def _refresh(self, *, advance: bool = False) -> None:
        """Bring panel and picture up to date."""
        session, clicked = self._session, self._session.clicked
        total, done = len(session.frames.names), len(session.frames.clicks.frames)
        self._head.content = f"## Frame {session.name}\n{session.number + 1} of {total}; {done} looked at"
        _set(self._no_tool, clicked.no_tool)
        self._ends = [f"{k + 1}: {PROTOCOL[e.shape].label}" for k, e in enumerate(clicked.ends)] or [NOTHING]
        _options(self._end, self._ends, self._ends[max(session.end, 0)])
        self._refresh_roles(advance)
        current = session.current
        _set(self._caliper, "" if current is None else _text(current.caliper_mm))
        _set(self._tape, "" if current is None else _text(current.tape_mm))
        _set(self._offset, _text(session.frames.clicks.tape_offset_mm))
        ends = session.annotated.ends
        marks = []
        for k, end in enumerate(clicked.ends):
            fitted = ends[k]
            wrong = fitted.fit.wrong if isinstance(fitted, AnnotatedEnd) else None
            marks += [(click, n == wrong) for n, click in enumerate(end.clicks)]
        self.scene.draw(marks, session.annotated)
        said = [f"**{self._problem}**"] if self._problem else []
        if session.end >= 0:
            found = ends[session.end]
            said.append(f"*{found}*" if isinstance(found, UserError) else result_text(found))
        self._result.content = "\n\n".join(said)

    def _refresh_roles(self, advance: bool) -> None:
        session = self._session
        asked = session.roles()
        self._roles = {NOTHING: None}
        if not asked or session.current is None:
            _options(self._role, [NOTHING], NOTHING)
            self._where.content = (
                "Add an end effector, then click on the picture." if not session.clicked.no_tool else ""
            )
            return
        before = str(self._role.value).partition(":")[0]
        labels = {r: f"{r}: {len(session.current.of(r))} of {a.advised}" for r, a in asked.items()}
        self._roles = {**{label: role for role, label in labels.items()}, ENOUGH: None}
        role = next((r for r in asked if r == before), None)
        if role is None or (advance and len(session.current.of(role)) >= asked[role].advised):
            role = session.next_role()
        _options(self._role, list(self._roles), ENOUGH if role is None else labels[role])
        protocol = PROTOCOL[session.current.shape]
        caliper = f"Caliper ({'needed' if protocol.caliper_needed else 'a check'}): {protocol.caliper}."
        if role is None:
            self._where.content = f"There are enough clicks.\n\n{caliper}"
            return
        r, g, b = COLORS[role]
        mark = f'<span style="color: rgb({r},{g},{b})">■</span>'
        self._where.content = f"{mark} Click **{asked[role].where}**.\n\n{caliper}"


def result_text(end: AnnotatedEnd) -> str:
    """What the clicks say of an end effector, in Markdown.

    Args:
        end: The end effector.

    Returns:
        Position, uncertainty, checks, and the residual of each click.
    """
    x, y, z = 1000.0 * end.fit.X_camera_ee[:3, 3]
    rows = [
        f"### {PROTOCOL[end.clicked.shape].label}: ± {end.sigma_mm:.1f} mm, ± {end.sigma_deg:.1f}°",
        f"At {x:.1f}, {y:.1f}, {z:.1f} mm from the camera.",
    ]
    if end.fit.redundancy == 0:
        rows.append("**A wrong click would go unnoticed: make more clicks.**")
    if end.fit.scale > 1.5:
        rows.append(f"Residuals are {end.fit.scale:.1f} times the expected ones; the uncertainty has grown with them.")
    for check in end.checks:
        verdict = "agrees" if check.agrees else "**disagrees: the pose is not used**"
        rows.append(
            f"{check.name}: {check.measured_mm:.1f} mm measured, {check.fitted_mm:.1f} ± {check.sigma_mm:.1f} mm by "
            f"the clicks, {verdict}."
        )
    table = ["| residuals | image [px] | depth [mm] |", "|---|---|---|"]
    for role in PROTOCOL[end.clicked.shape].clicks:
        numbers = [n for n, click in enumerate(end.clicked.clicks) if click.role is role]
        off = [_residual(end, n, end.fit.pixels, 1.0) for n in numbers]
        deep = [_residual(end, n, end.fit.metres, 1000.0) for n in numbers]
        if numbers:
            table.append(f"| {role} | {' '.join(off)} | {' '.join(deep)} |")
    if end.fit.wrong is not None:
        rows.append("The click in bold contradicts the others and is left out: undo it or leave it so.")
    return "\n\n".join(rows) + "\n\n" + "\n".join(table)


def _residual(end: AnnotatedEnd, number: int, residuals: dict[int, float], unit: float) -> str:
    if number not in residuals:
        return ""
    text = f"{unit * residuals[number]:.1f}"
    return f"**{text}**" if number == end.fit.wrong else text


def _number(text: str) -> float | None:
    """A number in a field; None where it is empty."""
    if not text.strip():
        return None
    try:
        return float(text.replace(",", "."))
    except ValueError:
        raise UserError(f"{text!r} is not a number: enter millimetres") from None


def _text(number: float | None) -> str:
    return "" if number is None else f"{number:g}"


def _set(handle: Any, value: Any) -> None:
    if handle.value != value:
        handle.value = value


def _options(dropdown: Any, options: list[str], value: str) -> None:
    if list(dropdown.options) != options:
        dropdown.options = tuple(options)
    _set(dropdown, value)

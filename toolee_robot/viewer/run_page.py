"""The page of a run: the scene, a panel, curves, and a timeline that plays; of a run that is over or goes on."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np

from toolee_robot.recording.history import RunHistory, thinned
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.recording.series import SeenDecision
from toolee_robot.station import StationConfig
from toolee_robot.viewer.run_scene import SIGMAS, RunScene
from toolee_robot.viewer.run_state import RunState

RATE = 30.0
"""Rate at which the scene is drawn while it plays [Hz]."""
SLOW = 6
"""Slider, panel and curves are brought up to date at every so-many-th drawing."""
POINTS = 800
"""Points of a curve."""
BEHIND = 3.0
"""A page of a running job plays faster when it is further behind it [s]."""
SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "4", "10")
WORDS = {
    "": "Connecting",
    "handover": "Handover: waiting for the hammer",
    "grip": "Grip",
    "view": "Look: bringing the hammer before the camera",
    "perceive": "Look: finding its face",
    "plan": "Planning the strike",
    "touch": "Measuring the nail with a slow touch",
    "strike": "Striking: keep out of reach",
    "park": "Parking",
}
"""What the panel says of each stage."""


class RunPage:
    """Serves the page of a run on a loopback address, until it is closed.

    Args:
        history: What was recorded; of a running job it grows.
        config: The station.
        port: Port of the page; the next free one is taken where it is in use.
        live: Whether the job still runs: the page then follows it.

    Attributes:
        scene: The scene.
        drawn: Number of drawings so far.

    Raises:
        UserError: viser is not installed.
    """

    def __init__(self, history: RunHistory, config: StationConfig, port: int, *, live: bool = False) -> None:
        self._history, self._live = history, live
        self.scene = RunScene(history, config, port)
        self.drawn = 0
        self._prompt, self._prompted = "", 0
        self._stamp, self._shown = history.start, float("nan")
        self._listed, self._labels = -1, list[str]()
        self._playing = live
        self._build()
        self._state = self.scene.show(self._stamp)
        self._refresh()
        self._open = True
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Address of the page."""
        return self.scene.picture.address

    @property
    def text(self) -> str:
        """What the panel says, in Markdown."""
        self._refresh()
        return str(self._panel.content)

    @property
    def stamp(self) -> float:
        """Time of the run that is shown [s]."""
        return self._stamp

    def close(self) -> None:
        """Stop serving."""
        self._open = False
        self._thread.join()
        self.scene.picture.close()

    def follow(self, recorder: RunRecorder) -> None:
        """Show what a recorder records from now on.

        Args:
            recorder: The open recorder of the job.
        """
        self._history.metadata.update(recorder.metadata)
        self.scene.follow()
        recorder.history = self._history

    def prompt(self, text: str) -> None:
        """Show what the person is to do; it stays until the job goes on.

        Args:
            text: The prompt.
        """
        self._prompt, self._prompted = text, len(self._history.decisions)

    def seek(self, stamp: float) -> None:
        """Show the run at a time [s]."""
        self._stamp = float(np.clip(stamp, self._history.start, self._history.end))

    def play(self, playing: bool = True) -> None:
        """Play, or pause."""
        if playing and not self._live and self._stamp >= self._history.end - 1e-3:
            self._stamp = self._history.start
        self._playing = playing
        self._button.label = "Pause" if playing else "Play"

    def _build(self) -> None:
        import viser.uplot as uplot

        gui = self.scene.picture.server.gui
        self._panel = gui.add_markdown("")
        self._slider: Any = gui.add_slider("Time [s]", 0.0, 0.1, 0.01, 0.0)
        self._button = gui.add_button("Pause" if self._live else "Play")
        self._speed = gui.add_dropdown("Speed", SPEEDS, initial_value="1")
        self._list: Any = gui.add_dropdown("Decision", ("-",))
        self._step = gui.add_button_group("Go to", ("previous", "next", "next strike"))
        self._reason = gui.add_markdown("")
        sigmas = gui.add_slider("Ellipsoids [std. dev.]", 1.0, 30.0, 1.0, SIGMAS)
        empty = np.array([0.0, 1.0])
        clock, cursor = uplot.Series(label="s"), uplot.Series(label="now", stroke="#888888", width=2)
        series = (clock, uplot.Series(label="force [N]", stroke="#c0392b"), cursor)
        scales = {"x": uplot.Scale(time=False)}
        self._force = gui.add_uplot(
            (empty, empty, empty), series, title="Force at the flange [N]", aspect=2.4, scales=scales
        )
        series = (clock, uplot.Series(label="nail [mm]", stroke="#2471a3"), cursor)
        self._depth = gui.add_uplot(
            (empty, empty, empty), series, title="Nail over the wood [mm]", aspect=2.4, scales=scales
        )
        self._slider.on_update(self._dragged)
        self._button.on_click(lambda _event: self.play(not self._playing))
        self._list.on_update(self._chosen)
        self._step.on_click(lambda _event: self._go(str(self._step.value)))

        def resize(_event: Any) -> None:
            self.scene.sigmas, self._shown = float(sigmas.value), float("nan")

        sigmas.on_update(resize)

    def _dragged(self, event: Any) -> None:
        if event.client is not None:
            self.play(False)
            self.seek(float(self._slider.value))

    def _chosen(self, event: Any) -> None:
        if event.client is not None and self._list.value in self._labels:
            self.play(False)
            self.seek(self.decisions[self._labels.index(str(self._list.value))].stamp)

    def _go(self, where: str) -> None:
        stamps = [d.stamp for d in self.decisions if where != "next strike" or d.name == "strike"]
        later = [t for t in stamps if t > self._stamp + 1e-6]
        earlier = [t for t in stamps if t < self._stamp - 1e-6]
        self.play(False)
        if where == "previous" and earlier:
            self.seek(earlier[-1])
        elif where != "previous" and later:
            self.seek(later[0])

    @property
    def decisions(self) -> list[SeenDecision]:
        """The decisions that the page lists: all but ends of stages and motions that went as planned."""
        found = list(self._history.decisions.values)
        return [
            d
            for d in found
            if d.name not in ("stage_ended", "motion") or d.data.get("outcome") not in (None, "completed")
        ]

    def _run(self) -> None:
        last, n = time.perf_counter(), 0
        while self._open:
            now = time.perf_counter()
            if self._playing:
                self._advance(now - last)
            last, n = now, n + 1
            if self._stamp != self._shown:
                self._shown = self._stamp
                self._state = self.scene.show(self._stamp)
                self.drawn += 1
            if n % SLOW == 0:
                self._refresh()
            time.sleep(max(1.0 / RATE - (time.perf_counter() - now), 0.0))

    def _advance(self, seconds: float) -> None:
        end = self._history.end
        speed = float(self._speed.value)
        if self._live:
            speed = max(speed, (end - self._stamp) / BEHIND)
        self._stamp = min(self._stamp + speed * seconds, end)
        if self._stamp >= end and not self._live:
            self.play(False)

    def _refresh(self) -> None:
        """Bring panel, list, slider and curves up to date; what has not changed is not sent."""
        h = self._history
        if self._prompt and len(h.decisions) > self._prompted:
            self._prompt = ""
        end = max(np.ceil(10.0 * h.end) / 10.0, 0.1)
        if self._slider.max != end:
            self._slider.max = end
        if abs(self._slider.value - self._stamp) > 5e-3:
            self._slider.value = self._stamp
        decisions = self.decisions
        if len(decisions) != self._listed and decisions:
            self._listed = len(decisions)
            self._labels = _labels(decisions)
            self._list.options = self._labels
        i = max((n for n, d in enumerate(decisions) if d.stamp <= self._stamp + 1e-9), default=-1)
        if i >= 0 and i < len(self._labels):
            if self._list.value != self._labels[i]:
                self._list.value = self._labels[i]
            _set(self._reason, f"**{decisions[i].name.replace('_', ' ')}**: {decisions[i].reason}")
        _set(self._panel, self._words(self._state))
        self._draw_curves()

    def _words(self, state: RunState) -> str:
        h = self._history
        parts = [f"## {WORDS.get(state.stage, state.stage.replace('_', ' ').capitalize())}"]
        if self._prompt:
            parts.append(f"### ➤ {self._prompt}")
        parts.append(f"**Nail**: {state.protrusion * 1e3:.1f} mm over the wood")
        seen = h.status.at(state.stamp)
        if seen is not None:
            code = "" if seen.error_code is None else f", {seen.error_code}"
            parts.append(f"**Robot**: {seen.status.replace('_', ' ')}{code}")
        if not h.complete and not self._live:
            parts.append("*The run was killed: the recording ends where it was last written.*")
        strikes = [d.reason for t, d in h.decisions if d.name == "strike" and t <= state.stamp]
        messages = [text for t, text in h.logs if t <= state.stamp][-2:]
        parts += [f"- {line}" for line in [*strikes[-3:], *messages]]
        return "\n\n".join(parts)

    def _draw_curves(self) -> None:
        h, key = self._history, (len(self._history.wrenches), len(self._history.protrusions), round(self._stamp, 2))
        if key == getattr(self, "_drawn_curves", None):
            return
        self._drawn_curves = key
        stamps, force = self._thinned()
        if len(stamps) > 1:
            self._force.data = _with_cursor(stamps, force, self._stamp)
        depth = [(h.start, self.scene.states.at(h.start).protrusion * 1e3)]
        depth += [(t, 1e3 * p) for t, p in h.protrusions]
        depth.append((max(h.end, depth[-1][0] + 0.1), depth[-1][1]))
        times, heights = np.array(depth).T
        self._depth.data = _with_cursor(times, heights, self._stamp)

    def _thinned(self) -> tuple[Any, Any]:
        n = len(self._history.wrenches)
        if getattr(self, "_thinned_at", -1) != n:
            self._thinned_at, self._curve = n, thinned(self._history.wrenches, POINTS)
        return self._curve


def _labels(decisions: list[SeenDecision]) -> list[str]:
    """Lines of the list; each differs, as the list wants it."""
    lines = [f"{d.stamp:7.2f} s  {d.name.replace('_', ' ')}: {d.reason}" for d in decisions]
    seen: dict[str, int] = {}
    for i, line in enumerate(lines):
        seen[line] = seen.get(line, 0) + 1
        if seen[line] > 1:
            lines[i] = f"{line} ({seen[line]})"
    return lines


def _with_cursor(stamps: Any, values: Any, now: float) -> tuple[Any, Any, Any]:
    """Curve, and a cursor: zero but for the present time. Not NaN, which the curves' scale does not bear."""
    x = np.concatenate([stamps, [now - 1e-3, now + 1e-3, now]])
    y = np.interp(x, stamps, values)
    cursor = np.zeros(len(x))
    cursor[-1] = max(float(np.max(values)), 1e-3)
    order = np.argsort(x, kind="stable")
    return x[order], y[order], cursor[order]


def _set(markdown: Any, content: str) -> None:
    if markdown.content != content:
        markdown.content = content

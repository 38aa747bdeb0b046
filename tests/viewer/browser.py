"""A page in a real browser without a screen, and what it costs to load and to play.

`python -m tests.viewer.browser RUN` prints it for a recording.
"""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from toolee_robot.recording.reading import read_history
from toolee_robot.viewer.run_page import RunPage

if TYPE_CHECKING:
    from playwright.sync_api import Page

CHROMIUM = next((p for p in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if p), None)
ARGUMENTS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
MOST_SERVED, MOST_RECEIVED, MOST_MESSAGES = 1_500_000, 1_500_000, 10
"""Sizes of files and messages [B], and number of messages, until a run's page is there: three times what they are."""
QUIET = 1.0
"""The scene is there when nothing has been received for so long [s]."""
_COUNT_PAINTED = "window.painted = 0; (function paint() { window.painted++; requestAnimationFrame(paint); })();"

_COLLECT_HEADINGS = """
window.headings = [];
new MutationObserver(() => {
    for (const heading of document.querySelectorAll("h2, h3"))
        if (!window.headings.includes(heading.textContent)) window.headings.push(heading.textContent);
}).observe(document, { subtree: true, childList: true, characterData: true });
"""


class Browser:
    """A page in the browser.

    Args:
        view: The browser's tab.

    Attributes:
        view: Likewise.
        messages: Number of messages that the page's websocket has received.
        received: Their size [B].
        served: Size of the files that were loaded [B].
        newest: When the last of all these came (`time.perf_counter`).
    """

    def __init__(self, view: Page) -> None:
        self.view = view
        self.messages, self.received, self.served, self.newest = 0, 0, 0, time.perf_counter()
        view.on("websocket", lambda socket: socket.on("framereceived", self._message))
        view.on("requestfinished", self._file)
        view.add_init_script(_COLLECT_HEADINGS)

    def _message(self, data: Any) -> None:
        self.messages, self.received = self.messages + 1, self.received + len(data)
        self.newest = time.perf_counter()

    def _file(self, request: Any) -> None:
        if request.url.startswith("http"):
            self.served += request.sizes()["responseBodySize"]
            self.newest = time.perf_counter()

    def painted_in(self, seconds: float) -> int:
        """Wait; returns the number of pictures that the browser paints in this time [s]."""
        self.view.evaluate(_COUNT_PAINTED)
        self.view.wait_for_timeout(1e3 * seconds)
        return int(self.view.evaluate("window.painted"))

    @property
    def headings(self) -> list[str]:
        """The panel's headings so far, however short they were shown: stages and prompts."""
        return list(self.view.evaluate("window.headings"))

    def load(self, address: str, text: str) -> float:
        """Open a page.

        Args:
            address: Its address.
            text: What it says once it is there.

        Returns:
            The time until text and scene were there [s].
        """
        began = time.perf_counter()
        self.view.goto(address)
        self.view.get_by_text(text).first.wait_for(timeout=60_000)
        shown = time.perf_counter()
        while time.perf_counter() - self.newest < QUIET:
            self.view.wait_for_timeout(50)
        return max(shown, self.newest) - began


@contextmanager
def browser() -> Iterator[Browser]:
    """A tab of a browser that draws by software."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield Browser(chromium.new_page(viewport={"width": 1300, "height": 900}))
        chromium.close()


@dataclass(frozen=True)
class PageSpeed:
    """What a run's page costs.

    Attributes:
        seconds: From opening it until text and scene are there [s].
        served: Files that were loaded [B].
        messages: Messages of the websocket until then.
        received: Their size [B].
        drawn: Drawings that the program sends while it plays [Hz].
        painted: Pictures that the browser paints then [Hz].
    """

    seconds: float
    served: int
    messages: int
    received: int
    drawn: float
    painted: float

    def __str__(self) -> str:
        return (
            f"loaded in {self.seconds:.1f} s: {self.served / 1e6:.1f} MB of files, "
            f"{self.received / 1e6:.1f} MB in {self.messages} messages; "
            f"playing: {self.drawn:.1f} drawings a second are sent, {self.painted:.1f} painted"
        )


def page_speed(page: RunPage, text: str, seconds: float = 5.0) -> PageSpeed:
    """Measure a run's page.

    Args:
        page: The page, paused.
        text: What it says at its beginning.
        seconds: For how long it plays [s].

    Returns:
        What was measured.
    """
    with browser() as seen:
        loaded = seen.load(page.address, text)
        served, messages, received = seen.served, seen.messages, seen.received
        seen.view.get_by_role("button", name="Play", exact=True).click()
        began, drawn = time.perf_counter(), page.drawn
        painted = seen.painted_in(seconds)
        past = time.perf_counter() - began
        rates = (page.drawn - drawn) / past, painted / past
        page.play(False)
    return PageSpeed(loaded, served, messages, received, *rates)


if __name__ == "__main__":
    run = Path(sys.argv[1])
    history = read_history(run / "recording.mcap" if run.is_dir() else run)
    page = RunPage(history, history.station(), 8310)
    print(page_speed(page, "over the wood"))
    page.close()

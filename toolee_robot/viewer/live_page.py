"""The page of a job that runs."""

from __future__ import annotations

import threading

from toolee_robot.recording.history import RunHistory
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.station import StationConfig
from toolee_robot.viewer.rerun_page import RerunPage
from toolee_robot.viewer.run_view import RunView, blueprint

PERIOD_S = 0.2
"""Time between two looks at what was recorded [s]."""
SEEN_S = 2.0
"""Time for which the page is served after the job's end, so that browsers get its result [s]."""


class LivePage:
    """Shows a job while it runs, until it is closed.

    Args:
        config: The station.
        port: Port of the page; the next free one is taken if it is in use.

    Attributes:
        address: Address of the page.

    Raises:
        UserError: Rerun is not installed, or does not start.
    """

    def __init__(self, config: StationConfig, port: int) -> None:
        self._history = RunHistory(complete=False)
        self._page = RerunPage("job", blueprint(live=True), port)
        self.address = self._page.address
        self._view = RunView(self._page.stream, self._history, config, live=True)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()

    def follow(self, recorder: RunRecorder) -> None:
        """Show what a recorder records from now on.

        Args:
            recorder: The open recorder of the job.
        """
        self._history.metadata.update(recorder.metadata)
        recorder.history = self._history

    def prompt(self, text: str) -> None:
        """Show what the person is to do; it stays until the job goes on.

        Args:
            text: The prompt.
        """
        self._view.prompt(text)

    def close(self) -> None:
        """Show the end, and stop serving."""
        self._over.set()
        self._thread.join()
        self._page.close(SEEN_S)

    def _run(self) -> None:
        while not self._over.wait(PERIOD_S):
            self._view.update()
        self._view.update()
        self._view.update()  # the last frames

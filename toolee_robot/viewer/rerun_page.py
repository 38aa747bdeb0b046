"""A page of Rerun, served by a program of its own to this computer only; and the page of a job that runs."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
import time
from typing import Any

from toolee_robot.errors import UserError
from toolee_robot.recording.history import RunHistory
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.station import StationConfig
from toolee_robot.viewer.rerun_server import HOST, free_port, listens
from toolee_robot.viewer.run_view import RunView, blueprint

START_S = 60.0
"""Longest time that the viewer's program may take to start [s]."""
PORTS_TRIED = 50


class RerunPage:
    """Starts Rerun's program, which serves a page and collects what is logged, until it is closed.

    Args:
        name: What the page shows.
        blueprint: Its layout (`rerun.blueprint.Blueprint`).
        port: Port of the page; the next free one is taken if it is in use.

    Attributes:
        stream: The `rerun.RecordingStream` to log to.
        address: Address of the page.

    Raises:
        UserError: Rerun is not installed, or does not start.
    """

    def __init__(self, name: str, blueprint: Any, port: int) -> None:
        try:
            import rerun
        except ImportError as error:
            raise UserError(
                f"the page needs rerun-sdk ({error}): run `python -m pip install -e '.[viewer]'`",
                code="user.missing_package",
            ) from error
        web, data = _next_free(port), free_port()
        command = [sys.executable, "-m", "toolee_robot.viewer.rerun_server", str(web), str(data)]
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  (closed in `close`)
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=self._said, stderr=subprocess.STDOUT, start_new_session=True
        )
        proxy = f"{HOST}:{data}/proxy"
        self.address = f"http://{HOST}:{web}/?url=rerun%2Bhttp://{proxy}"
        try:
            self._wait_for(web)
            self.stream = rerun.RecordingStream(name)
            self.stream.connect_grpc(f"rerun+http://{proxy}", default_blueprint=blueprint)
        except BaseException:
            self._process.kill()
            raise

    def close(self, after: float = 0.0) -> None:
        """Stop serving; a browser keeps what it has.

        Args:
            after: Time for which the page is served still [s].
        """
        self.stream.flush()
        self.stream.disconnect()
        time.sleep(after)
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()
        self._said.close()

    def _wait_for(self, port: int) -> None:
        end = time.monotonic() + START_S
        while time.monotonic() < end and self._process.poll() is None:
            if listens(port):
                return
            time.sleep(0.05)
        self._said.seek(0)
        said = self._said.read().decode(errors="replace").strip()[-500:]
        raise UserError(f"the viewer's program does not start: {said or 'it says nothing'}")


def _next_free(wanted: int) -> int:
    """The wanted port, or the next that is free."""
    for port in range(wanted, wanted + PORTS_TRIED):
        try:
            return free_port(port)
        except OSError:
            continue
    raise UserError(f"no port from {wanted} on is free: give another --port")


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

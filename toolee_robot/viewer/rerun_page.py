"""Rerun's page of a run: its program, which listens on loopback only, and what it shows."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from toolee_robot.errors import UserError
from toolee_robot.recording.history import RunHistory
from toolee_robot.recording.recorder import RunRecorder
from toolee_robot.station import StationConfig
from toolee_robot.viewer.run_view import RunView, blueprint

HOST = "127.0.0.1"
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; worker-src 'self' blob:; connect-src 'self' data: blob: http://{data}"
)
"""What the page may load: nothing but from this computer."""


def listens(port: int) -> bool:
    """Whether something on this computer listens on a port."""
    with socket.socket() as probe:
        return probe.connect_ex((HOST, port)) == 0


def free_port(wanted: int = 0) -> int:
    """A port that is free: the wanted one, or any; raises OSError if the wanted one is in use."""
    with socket.socket() as probe:
        probe.bind((HOST, wanted))
        return int(probe.getsockname()[1])


def serve(port: int, data_port: int) -> None:
    """Serve until standard input is closed."""
    import rerun_cli

    inner = free_port()
    # `serve_grpc` and `serve_web_viewer` of the Python module would listen on every network.
    program = str(Path(rerun_cli.__file__).with_name("rerun"))
    command = [program, "--serve-web", "--bind", HOST, "--port", str(data_port), "--web-viewer-port", str(inner)]
    rerun = subprocess.Popen(command, env=os.environ | {"RERUN_ANALYTICS": "0"}, stdin=subprocess.DEVNULL)
    names = {f"{name}:{port}" for name in (HOST, "localhost")}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.headers.get("Host") not in names:
                self.send_error(403)
                return
            if self.path == "/":  # a short address for people
                self.send_response(302)
                self.send_header("Location", f"/?url=rerun%2Bhttp://{HOST}:{data_port}/proxy")
                self.end_headers()
                return
            with urllib.request.urlopen(f"http://{HOST}:{inner}{self.path}") as answer:
                content = answer.read()
            self.send_response(200)
            self.send_header("Content-Type", answer.headers["Content-Type"])
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Content-Security-Policy", POLICY.format(data=f"{HOST}:{data_port}"))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            """Nothing is logged."""

    try:
        while not (listens(inner) and listens(data_port)) and rerun.poll() is None:
            time.sleep(0.05)
        server = ThreadingHTTPServer((HOST, port), Handler)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        sys.stdin.read()
    finally:
        rerun.terminate()


if __name__ == "__main__":
    serve(int(sys.argv[1]), int(sys.argv[2]))


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
        ModuleNotFoundError: Rerun is not installed.
        UserError: It does not start.
    """

    def __init__(self, name: str, blueprint: Any, port: int) -> None:
        import rerun

        web, data = _next_free(port), free_port()
        command = [sys.executable, "-m", "toolee_robot.viewer.rerun_page", str(web), str(data)]
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  (closed in `close`)
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=self._said, stderr=subprocess.STDOUT, start_new_session=True
        )
        self.address = f"http://{HOST}:{web}"
        try:
            self._wait_for(web)
            self.stream = rerun.RecordingStream(name)
            self.stream.connect_grpc(f"rerun+http://{HOST}:{data}/proxy", default_blueprint=blueprint)
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
        ModuleNotFoundError: Rerun is not installed.
        UserError: It does not start.
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

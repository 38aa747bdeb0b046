"""A page of Rerun, the viewer: a program of its own, for this computer only."""

from __future__ import annotations

import os
import socket
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from toolee_robot.errors import UserError

HOST = "127.0.0.1"
START_S = 30.0
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
            import rerun_cli
        except ImportError as error:
            raise UserError(
                f"the page needs rerun-sdk ({error}): run `python -m pip install -e '.[viewer]'`",
                code="user.missing_package",
            ) from error
        program = Path(rerun_cli.__file__).with_name("rerun")
        web, data = _free_port(port), _free_port(0)
        # `serve_grpc` and `serve_web_viewer` of the Python module would listen on every network.
        command = [str(program), "--serve-web", "--bind", HOST, "--port", str(data), "--web-viewer-port", str(web)]
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  (closed in `close`)
        self._process = subprocess.Popen(
            command, env=os.environ | {"RERUN_ANALYTICS": "0"}, stdin=subprocess.DEVNULL, stdout=self._said,
            stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        proxy = f"{HOST}:{data}/proxy"
        self.address = f"http://{HOST}:{web}/?url=rerun%2Bhttp://{proxy}"
        try:
            for needed in (data, web):
                self._wait_for(needed)
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
        self._process.terminate()
        self._process.wait()
        self._said.close()

    def _wait_for(self, port: int) -> None:
        end = time.monotonic() + START_S
        while time.monotonic() < end and self._process.poll() is None:
            with socket.socket() as probe:
                if probe.connect_ex((HOST, port)) == 0:
                    return
            time.sleep(0.05)
        self._said.seek(0)
        said = self._said.read().decode(errors="replace").strip()[-500:]
        raise UserError(f"the viewer's program does not start: {said or 'it says nothing'}", code="user.viewer_program")


def _free_port(wanted: int) -> int:
    """The wanted port, or the next that is free; any for 0."""
    for port in range(wanted, wanted + PORTS_TRIED):
        with socket.socket() as probe:
            try:
                probe.bind((HOST, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise UserError(f"no port from {wanted} on is free: give another --port", code="user.port")

"""Serves Rerun's page in a process of its own: `python -m toolee_robot.viewer.rerun_server PORT DATA_PORT`.

Rerun's own web server sends neither a policy nor a look at the Host header: its page would fetch fonts and send usage
data to other computers, and another site's page could ask for it by a name of its own. So this server stands before it.
It ends, with Rerun's program, when its standard input is closed: when the process that started it is gone.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

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

"""The control script as the unmodified ur_rtde uploads it, caught by a server that knows just enough."""

from __future__ import annotations

import selectors
import socket
import struct
import subprocess
import sys
import time
from functools import lru_cache

from toolee_robot.sim_backend.ur_controller.robot.plant import ControllerModel

DASHBOARD, UPLOAD, RTDE = 29999, 30003, 30004
STATUS = ("robot_status_bits", "safety_status_bits", "runtime_state")
REPLIES = {"PolyscopeVersion": "URSoftware 5.11.0.108249", "get serial number": "20195500001"}
CLIENT = "import rtde_control, sys; rtde_control.RTDEControlInterface(sys.argv[1], float(sys.argv[2]))"


@lru_cache(maxsize=2)
def control_script(model: ControllerModel, host: str) -> str:
    """For a controller of this model; ur_rtde connects to `host`, a loopback address."""
    sockets = {port: socket.create_server((host, port)) for port in (DASHBOARD, UPLOAD, RTDE)}
    client = subprocess.Popen(
        [sys.executable, "-c", CLIENT, host, str(model.rate)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        return _Catcher(model, sockets).catch(timeout=30.0)
    finally:
        client.kill()
        client.wait()
        for server in sockets.values():
            server.close()


class _Catcher:
    def __init__(self, model: ControllerModel, servers: dict[int, socket.socket]) -> None:
        self._model, self._servers = model, servers
        self._selector = selectors.DefaultSelector()
        for port, server in servers.items():
            self._selector.register(server, selectors.EVENT_READ, ("accept", port))
        self._script, self._input = b"", b""
        self._outputs: list[str] = []
        self._stream: socket.socket | None = None
        self._recipes = 0

    def catch(self, timeout: float) -> str:
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            for key, _ in self._selector.select(self._model.period):
                kind, port = key.data
                sock = key.fileobj
                assert isinstance(sock, socket.socket)
                if kind == "accept":
                    self._accept(sock, port)
                elif not (data := sock.recv(65536)):
                    self._selector.unregister(sock)
                else:
                    self._receive(sock, port, data)
            if self._script.rstrip().endswith(b"\nend") and self._script.count(b"NODE_CONTROL_LOOP_ENDS"):
                return self._script.decode()
            if self._stream is not None:
                self._publish(self._stream)
        raise AssertionError("ur_rtde has not uploaded its script")

    def _accept(self, server: socket.socket, port: int) -> None:
        connection, _ = server.accept()
        self._selector.register(connection, selectors.EVENT_READ, ("data", port))
        if port == DASHBOARD:
            connection.sendall(b"Connected: Universal Robots Dashboard Server\n")

    def _receive(self, connection: socket.socket, port: int, data: bytes) -> None:
        if port == UPLOAD:
            self._script += data
        elif port == DASHBOARD:
            for line in data.decode().splitlines():
                connection.sendall((REPLIES.get(line, "true") + "\n").encode())
        else:
            self._input += data
            while len(self._input) >= 3 and len(self._input) >= (size := struct.unpack(">H", self._input[:2])[0]):
                self._answer(connection, chr(self._input[2]), self._input[3:size])
                self._input = self._input[size:]

    def _answer(self, connection: socket.socket, kind: str, body: bytes) -> None:
        if kind == "V":
            reply = b"\x01"
        elif kind == "v":
            reply = struct.pack(">4I", *self._model.version)
        elif kind == "O":
            self._outputs = [name for name in body[8:].decode().split(",") if name]
            reply = b"\x01" + ",".join(map(_type, self._outputs)).encode()
        elif kind == "I":
            self._recipes += 1
            names = [name for name in body.decode().split(",") if name]
            reply = bytes([self._recipes]) + ",".join(map(_type, names)).encode()
        elif kind == "S":
            reply = b"\x01"
            self._stream = connection
        else:
            return
        connection.sendall(struct.pack(">HB", len(reply) + 3, ord(kind)) + reply)
        if kind == "S":
            time.sleep(0.1)  # the client reads exactly one packet here

    def _publish(self, connection: socket.socket) -> None:
        known = {"timestamp": time.monotonic(), "runtime_state": 1, "safety_status_bits": 1, "robot_status_bits": 1}
        formats = {"DOUBLE": "d", "UINT32": "I", "INT32": "i"}
        layout = ">B" + "".join(formats[_type(name)] for name in self._outputs)
        data = struct.pack(layout, 1, *(known.get(name, 0) for name in self._outputs))
        connection.sendall(struct.pack(">HB", len(data) + 3, ord("U")) + data)


def _type(name: str) -> str:
    if "int_register" in name:
        return "INT32"
    if name in STATUS:
        return "UINT32"
    return "VECTOR6D" if name == "external_force_torque" else "DOUBLE"

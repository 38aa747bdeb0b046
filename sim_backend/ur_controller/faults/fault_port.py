"""The fault port: its service in the controller's loop, and its client."""

from __future__ import annotations

import json
import socket
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from toolee_robot.errors import DeviceError, UserError, words_of
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.faults.hooks import Faults
from toolee_robot.sim_backend.ur_controller.server.port import Sink

MAX_WAITING = 65536  # [bytes] of queued requests; a client that sends more is dropped


class FaultSession:
    """A client's session on the fault port.

    Args:
        sink: The client's connection.
        faults: The hooks.
    """

    def __init__(self, sink: Sink, faults: Faults) -> None:
        self._sink, self._faults = sink, faults
        self._buffer = bytearray()

    def feed(self, data: bytes) -> None:
        """Take received bytes and answer at most one request."""
        self._buffer += data
        # One request per tick, since some take milliseconds.
        if (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end])
            del self._buffer[: end + 1]
            if line.strip():
                self._sink.send(json.dumps(self._answer(line)).encode() + b"\n")
        if len(self._buffer) > MAX_WAITING:
            self._sink.close()

    def tick(self) -> None:
        """Answer the next queued request."""
        if self._buffer:
            self.feed(b"")

    def close(self) -> None:
        """Nothing to release."""

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
        except (ValueError, RecursionError) as error:
            return {"ok": False, "error": f"not JSON: {error}"}
        return self._faults.do(request)


FAULT_PORT = 30020


@dataclass(frozen=True)
class Trace:
    """The arm's states, one row per tick.

    Attributes:
        ticks: Numbers of the ticks, (N,).
        stamps: Times, (N,) [s], on the controller's clock, which is the same in every process of the machine.
        q: True joint positions, (N, 6) [rad].
        qd: True joint velocities, (N, 6) [rad/s].
        q_target: Set-points, (N, 6) [rad].
        safety: Values of `SafetyMode`, (N,).
        program: Values of `RuntimeState`, (N,).
        commands: Packets with set-points or arguments that had come by then, (N,); see `Inputs.commands`.
    """

    ticks: Array
    stamps: Array
    q: Array
    qd: Array
    q_target: Array
    safety: Array
    program: Array
    commands: Array


class FaultClient:
    """A connection to a stand-in's fault port.

    Args:
        host: Address of the stand-in.
        port: TCP port of its fault port.
        timeout: Timeout of connecting and of every answer [s].

    Raises:
        DeviceError: Nothing answers.
    """

    def __init__(self, host: str, port: int = FAULT_PORT, timeout: float = 10.0) -> None:
        self._address = f"{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout)
        except OSError as error:
            raise DeviceError(
                f"no emulated controller answers on {self._address} ({words_of(error)}): start one with `toolee "
                f"emulate ur --host {host}`"
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._buffer = b""

    def fault(self, name: str, /, **arguments: object) -> dict[str, Any]:
        """Call a hook.

        Args:
            name: Name of the hook.
            arguments: Its arguments.

        Returns:
            Its answer.

        Raises:
            UserError: The hook or an argument is invalid.
            DeviceError: The stand-in does not answer.
        """
        try:
            self._socket.sendall(json.dumps({"fault": name, **arguments}).encode() + b"\n")
            while b"\n" not in self._buffer:
                data = self._socket.recv(1 << 20)
                if not data:
                    raise ConnectionError("closed")
                self._buffer += data
        except OSError as error:
            message = f"the emulated controller on {self._address} does not answer: {words_of(error)}"
            raise DeviceError(message) from error
        line, self._buffer = self._buffer.split(b"\n", 1)
        answer: dict[str, Any] = json.loads(line)
        if not answer.pop("ok"):
            raise UserError(answer["error"])
        return answer

    def state(self) -> dict[str, Any]:
        """True state of the robot."""
        return self.fault("state")

    def trace(self, after: int = -1) -> Trace:
        """The arm's states in all ticks after number `after` that are still kept."""
        rows: list[list[Any]] = []
        last = after
        while page := self.fault("trace", after=last)["rows"]:
            rows += page
            last = page[-1][0]
            if len(page) < 100:  # up to date: do not chase newer ticks
                break
        columns = list(zip(*rows, strict=True)) if rows else [()] * 8
        ticks, stamps, safety, program, q, qd, q_target, commands = columns
        return Trace(
            ticks=np.array(ticks, dtype=int),
            stamps=np.array(stamps, dtype=float),
            q=np.array(q, dtype=float).reshape(-1, 6),
            qd=np.array(qd, dtype=float).reshape(-1, 6),
            q_target=np.array(q_target, dtype=float).reshape(-1, 6),
            safety=np.array(safety, dtype=int),
            program=np.array(program, dtype=int),
            commands=np.array(commands, dtype=int),
        )

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

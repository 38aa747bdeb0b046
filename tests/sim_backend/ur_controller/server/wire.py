"""Raw ends of the controller's protocols, for tests: a recording sink, packets, a robot without sockets."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

from toolee_robot.sim_backend.ur_controller.process import resting_joints
from toolee_robot.sim_backend.ur_controller.profile import ProfileName, profile
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.server.rtde import RtdeFaults, RtdeSession
from toolee_robot.sim_backend.ur_controller.server.rtde_types import FORMATS, HEADER, packet
from toolee_robot.sim_backend.ur_controller.server.rtde_variables import Inputs, Outputs


@dataclass
class Recorder:
    """A sink that keeps what is sent."""

    data: bytearray = field(default_factory=bytearray)
    open: bool = True
    backlog: int = 0

    def send(self, data: bytes) -> None:
        self.data += data

    def close(self, reset: bool = False) -> None:  # noqa: ARG002
        self.open = False

    def take(self) -> bytes:
        """What has been sent since the last call."""
        data = bytes(self.data)
        self.data.clear()
        return data


def robot(
    model: str = "UR10", name: ProfileName = "ideal", seed: int = 0, limits: Mapping[str, Any] | None = None
) -> Robot:
    """A robot on ideal joints; `limits` replace some of its profile's."""
    kind = MODELS[model]
    chosen = profile(name, kind.e_series)
    return Robot(kind, resting_joints(kind), replace(chosen.limits, **(limits or {})), profile=chosen, seed=seed)


class RtdeServer:
    """The RTDE side of a robot without sockets."""

    def __init__(self, model: str = "UR10") -> None:
        self.robot = robot(model)
        self.outputs, self.inputs, self.faults = Outputs(self.robot), Inputs(self.robot), RtdeFaults()

    def connect(self, version: int = 2) -> RtdeClient:
        client = RtdeClient(self)
        assert client.ask("V", struct.pack(">H", version)) == b"\x01"
        return client


class RtdeClient:
    """One client of it."""

    def __init__(self, server: RtdeServer) -> None:
        self.server, self.sink = server, Recorder()
        self.session = RtdeSession(self.sink, server.robot, server.outputs, server.inputs, server.faults)

    def send(self, kind: str, payload: bytes = b"") -> list[tuple[str, bytes]]:
        """Packets that come back."""
        self.session.feed(packet(ord(kind), payload))
        return packets(self.sink.take())

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        """The payload of the one answer, which must be of the same type."""
        ((answered, answer),) = self.send(kind, payload)
        assert answered == kind
        return answer

    def outputs(self, *names: str, frequency: float | None = None) -> bytes:
        rate = self.server.robot.model.rate if frequency is None else frequency
        return self.ask("O", struct.pack(">d", rate) + "".join(f"{name}," for name in names).encode())

    def inputs(self, *names: str) -> bytes:
        return self.ask("I", "".join(f"{name}," for name in names).encode())

    def tick(self) -> list[tuple[str, bytes]]:
        """The next tick of the robot, and what this client is sent."""
        self.server.robot.step()
        self.session.tick()
        return packets(self.sink.take())


class RtdeSocket:
    """A bare client on a real socket. packet_size: of its data packets [bytes]."""

    def __init__(self, host: str) -> None:
        self._socket = socket.create_connection((host, 30004), 5.0)
        self.packet_size = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._socket.close()

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        """The payload of the next packet, which must be of the same type."""
        self._socket.sendall(packet(ord(kind), payload))
        size, answered = HEADER.unpack(self._exactly(HEADER.size))
        assert chr(answered) == kind
        return self._exactly(size - HEADER.size)

    def subscribe(self, *names: str) -> None:
        """Protocol 2, these variables at the full rate, start."""
        assert self.ask("V", b"\x00\x02") == b"\x01"
        answer = self.ask("O", struct.pack(">d", 125.0) + ",".join(names).encode())
        assert answer[0] == 1, answer
        types = answer[1:].decode().split(",")
        self.packet_size = HEADER.size + 1 + struct.calcsize(">" + "".join(FORMATS[name] for name in types))
        assert self.ask("S") == b"\x01"

    def numbers(self) -> tuple[float, ...]:
        """Of the next data packet, all of them doubles."""
        data = self._exactly(self.packet_size)
        assert data[2:4] == b"U\x01"
        return struct.unpack(f">{(len(data) - 4) // 8}d", data[4:])

    def timestamps(self, count: int) -> list[float]:
        """The first number of so many packets."""
        return [self.numbers()[0] for _ in range(count)]

    def read_for(self, seconds: float) -> bytes:
        """Whatever comes within this time. Raises EOFError at the end of the connection."""
        end, data = time.monotonic() + seconds, b""
        while (left := end - time.monotonic()) > 0.0:
            self._socket.settimeout(left)
            try:
                piece = self._socket.recv(65536)
            except TimeoutError:
                break
            if not piece:
                raise EOFError
            data += piece
        self._socket.settimeout(5.0)
        return data

    def _exactly(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            piece = self._socket.recv(size - len(data))
            if not piece:
                raise EOFError
            data += piece
        return data


def packets(data: bytes) -> list[tuple[str, bytes]]:
    """(type, payload) of each packet; nothing may be left over."""
    found, at = [], 0
    while at < len(data):
        size, kind = HEADER.unpack_from(data, at)
        assert at + size <= len(data)
        found.append((chr(kind), data[at + HEADER.size : at + size]))
        at += size
    return found

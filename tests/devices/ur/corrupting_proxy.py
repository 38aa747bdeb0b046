"""A network that lies: a proxy before the controller stand-in that passes everything on, until a rule corrupts one
direction of one connection. A process of its own."""

from __future__ import annotations

import select
import socket
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Self

from toolee_robot.sim_backend.ur_controller.server.rtde_types import FORMATS

RTDE = 30004
PORTS = (29999, 30001, 30002, 30003, RTDE)
_PROGRAM = "from tests.devices.ur.corrupting_proxy import main; main()"
_HEADER = struct.Struct(">HB")
_DRIP = 0.05  # [s] between two bytes
_BUFFER = 1 << 18  # [bytes] on the way to somebody who does not read


@dataclass(frozen=True)
class Rule:
    """What to do to the unit number `skip` (of those that match, from the rule's arming on) of a direction."""

    action: str
    data: bytes = b""
    number: float = 0.0
    port: int = RTDE
    kind: int = 0
    skip: int = 0
    every: bool = False
    to_robot: bool = False


class CorruptingProxy:
    """The test's side. host: where clients connect; upstream: the controller's."""

    def __init__(self, host: str, upstream: str) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _PROGRAM, str(theirs.fileno()), host, upstream],
                pass_fds=(theirs.fileno(),),
            )
        self._pipe = Connection(ours.detach())
        assert self._pipe.recv() == "ready"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pipe.close()
        self._process.wait(5.0)

    def arm(self, rule: Rule) -> None:
        """From now on."""
        self._ask(rule)

    def heal(self) -> None:
        """No rule any more; connections that have suffered are reset."""
        self._ask("heal")

    def struck(self) -> float | None:
        """`time.monotonic()` at which the rule was applied first, or None."""
        when = self._ask("when")
        assert when is None or isinstance(when, float)
        return when

    def _ask(self, what: object) -> object:
        self._pipe.send(what)
        assert self._pipe.poll(10.0)
        return self._pipe.recv()


class _Way:
    """One direction of a connection."""

    def __init__(self, source: socket.socket, sink: socket.socket, link: _Link, to_robot: bool) -> None:
        self.source, self.sink, self.link, self.to_robot = source, sink, link, to_robot
        self.incoming, self.outgoing = bytearray(), bytearray()
        self.mode, self.flood = "", b""
        self.drip_at = 0.0


class _Link:
    """A client's connection. layout: of the data packets: variable -> offset, struct."""

    def __init__(self, client: socket.socket, robot: socket.socket, port: int) -> None:
        self.client, self.robot, self.port = client, robot, port
        self.ways = (_Way(client, robot, self, True), _Way(robot, client, self, False))
        self.names: list[str] = []
        self.layout: dict[str, tuple[int, struct.Struct]] = {}
        self.open, self.hurt = True, False

    def close(self, reset: bool = False) -> None:
        self.open = False
        for sock in (self.client, self.robot):
            if reset and sock is self.client:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            sock.close()

    def learn(self, to_robot: bool, kind: int, payload: bytes) -> None:
        """Of the handshake: where in the data the variables are."""
        if kind != ord("O"):
            return
        if to_robot:
            self.names = payload[8:].decode().rstrip(",").split(",")
            return
        at, self.layout = 1, {}
        for name, type_name in zip(self.names, payload[1:].decode().split(","), strict=True):
            packed = struct.Struct(">" + FORMATS.get(type_name, ""))
            self.layout[name] = (at, packed)
            at += packed.size


class _Proxy:
    def __init__(self, host: str, upstream: str) -> None:
        self._upstream = upstream
        self._listeners: dict[socket.socket, int] = {}
        for port in PORTS:
            listener = socket.socket()
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((host, port))
            listener.listen(16)
            self._listeners[listener] = port
        self._links: list[_Link] = []
        self._rule: Rule | None = None
        self._count = 0
        self._when: float | None = None

    def serve(self, pipe: Connection) -> None:
        pipe.send("ready")
        while True:
            self._links = [link for link in self._links if link.open]
            ways = {way.source: way for link in self._links for way in link.ways if len(way.outgoing) < _BUFFER}
            blocked = {
                way.sink: way for link in self._links for way in link.ways if way.outgoing and way.mode != "drip"
            }
            floods = {way.sink: way for link in self._links for way in link.ways if way.mode == "flood"}
            drips = any(way.mode == "drip" for link in self._links for way in link.ways)
            sources: list[Connection | socket.socket] = [pipe, *self._listeners, *ways]
            readable, writable, _ = select.select(sources, [*blocked, *floods], [], _DRIP if drips else None)
            for ready in readable:
                if isinstance(ready, Connection):
                    try:
                        pipe.send(self._obey(pipe.recv()))
                    except (EOFError, OSError):
                        return
                elif ready in self._listeners:
                    self._accept(ready)
                elif ways[ready].link.open:
                    self._pump(ways[ready])
            for sink in writable:
                way = floods.get(sink) or blocked[sink]
                if way.link.open:
                    if way.mode == "flood" and len(way.outgoing) < 4 * len(way.flood):
                        way.outgoing += way.flood
                    self._send(way)
            for link in self._links:
                for way in link.ways:
                    if link.open and way.mode == "drip" and way.outgoing and time.monotonic() >= way.drip_at:
                        self._send(way, 1)
                        way.drip_at = time.monotonic() + _DRIP

    def _obey(self, order: object) -> object:
        if isinstance(order, Rule):
            self._rule, self._count, self._when = order, 0, None
        elif order == "heal":
            self._rule = None
            for link in self._links:
                if link.hurt:
                    link.close(reset=True)
        elif order == "when":
            return self._when
        return "done"

    def _accept(self, listener: socket.socket) -> None:
        client, _ = listener.accept()
        port = self._listeners[listener]
        try:
            robot = socket.create_connection((self._upstream, port), 5.0)
        except OSError:
            client.close()
            return
        for sock in (client, robot):
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.setblocking(False)
        self._links.append(_Link(client, robot, port))

    def _pump(self, way: _Way) -> None:
        try:
            data = way.source.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            way.link.close()
            return
        way.incoming += data
        for unit in self._units(way):
            self._pass(way, unit)
            if not way.link.open:
                return
        if way.mode != "drip":
            self._send(way)

    def _units(self, way: _Way) -> list[bytes]:
        if way.link.port != RTDE:
            unit = bytes(way.incoming)
            way.incoming.clear()
            return [unit]
        units = []
        while len(way.incoming) >= 3 and len(way.incoming) >= (size := _HEADER.unpack_from(way.incoming)[0]):
            units.append(bytes(way.incoming[:size]))
            del way.incoming[:size]
            way.link.learn(way.to_robot, units[-1][2], units[-1][3:])
        return units

    def _pass(self, way: _Way, unit: bytes) -> None:
        if way.mode in ("silence", "flood"):
            return
        rule = self._rule
        fits = rule is not None and rule.port == way.link.port and rule.to_robot is way.to_robot
        if rule is None or not fits or (rule.kind and unit[2] != rule.kind):
            way.outgoing += unit
            return
        poisons = rule.action in ("poison", "shift")
        if poisons and (unit[2] != ord("U") or rule.data.decode() not in way.link.layout):
            way.outgoing += unit
            return
        self._count += 1
        if self._count <= rule.skip or (self._count > rule.skip + 1 and not rule.every):
            way.outgoing += unit
            return
        if self._when is None:
            self._when = time.monotonic()
        if not poisons:
            way.link.hurt = True
        way.outgoing += self._corrupt(way, rule, unit)

    def _corrupt(self, way: _Way, rule: Rule, unit: bytes) -> bytes:
        changed = bytearray(unit)
        match rule.action:
            case "replace":
                return rule.data
            case "insert":
                return rule.data + unit
            case "append":
                return unit + rule.data
            case "kind":
                changed[2] = int(rule.number)
            case "size":
                changed[:2] = int(rule.number).to_bytes(2, "big")
            case "cut":
                self._mute(way)
                return unit[: int(rule.number)]
            case "silence":
                self._mute(way)
                return b""
            case "fin" | "rst":
                way.link.close(rule.action == "rst")
                return b""
            case "drip" | "flood":
                way.mode, way.flood = rule.action, rule.data
            case "poison" | "shift":
                at, packed = way.link.layout[rule.data.decode()]
                values = packed.unpack_from(unit, 3 + at)
                new = [v + rule.number if rule.action == "shift" else rule.number for v in values]
                kind = type(values[0])
                packed.pack_into(changed, 3 + at, *(kind(v) for v in new))
            case other:
                raise ValueError(other)
        return bytes(changed)

    @staticmethod
    def _mute(way: _Way) -> None:
        way.mode = "silence"

    def _send(self, way: _Way, count: int | None = None) -> None:
        try:
            sent = way.sink.send(way.outgoing[:count])
            del way.outgoing[:sent]
        except BlockingIOError:
            pass
        except OSError:
            way.link.close()


def main() -> None:
    _Proxy(sys.argv[2], sys.argv[3]).serve(Connection(int(sys.argv[1])))

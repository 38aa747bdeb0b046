"""The emulated Shadow Hand behind a rosbridge's websocket."""

from __future__ import annotations

import heapq
import itertools
import json
import socket
import threading
import time
from contextlib import suppress
from typing import Any, Self

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from toolee_robot.errors import UserError
from toolee_robot.sim_backend.hand_wire import HandEmulator, LineFaults
from toolee_robot.sim_backend.shadow_hand import ros
from toolee_robot.sim_backend.shadow_hand.bridge import Client
from toolee_robot.sim_backend.shadow_hand.hand import NAMES, Hand

TICK = 0.004
"""Time between two looks at what is due [s]."""
BURST = 24
"""Bytes that a damaged message has others of: where TCP fails, it fails for a stretch."""


class ShadowEmulator(HandEmulator[Hand]):
    """A right Shadow Hand that a driver finds at `port`, the address of a rosbridge on this computer.

    Args:
        seed: Seed of the noise.
        pace: Rate of the hand's time relative to the host's, its clock included.
        tcp_port: TCP port of the rosbridge; 0 for any that is free.

    Raises:
        UserError: The port is taken, or is none.
    """

    label = "Shadow Dexterous Hand (right) behind a rosbridge"
    motors, thumb = NAMES, "THJ5"
    events = (
        "heat MOTOR DEGREES, heat DEGREES, jam MOTOR, free MOTOR, break MOTOR, repair MOTOR, "
        "controllers off, controllers on, diagnostics off, diagnostics on"
    )

    def __init__(self, seed: int = 0, pace: float = 1.0, tcp_port: int = 0) -> None:
        super().__init__(Hand(lambda: pace * time.monotonic(), seed), LineFaults(_of_the_left_hand, seed, BURST))
        self._clients: dict[ServerConnection, Client] = {}
        self._pace, self._over = pace, threading.Event()
        self._diagnoses = True
        try:
            self._server = serve(self._converse, "127.0.0.1", tcp_port, compression=None, ping_interval=None)
        except (OSError, OverflowError) as error:
            raise UserError(
                f"no rosbridge at TCP port {tcp_port}: {error}; choose another", code="user.port"
            ) from error
        self.port = f"ws://127.0.0.1:{self._server.socket.getsockname()[1]}"
        self._threads = [
            threading.Thread(target=self._server.serve_forever, name="emulated rosbridge", daemon=True),
            threading.Thread(target=self._publish, name="emulated hand", daemon=True),
        ]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    @property
    def plugged(self) -> bool:
        """Whether the rosbridge is there."""
        return not self._over.is_set()

    def unplug(self) -> None:
        """End the rosbridge for good: whoever is connected gets an error."""
        if self._over.is_set():
            return
        self._over.set()
        for connection in list(self._clients):
            with suppress(OSError):
                connection.socket.shutdown(socket.SHUT_RDWR)
        if self._threads[0].ident is None:
            self._server.socket.close()
            return
        self._server.shutdown()
        for thread in self._threads:
            thread.join()

    def met(self, finger: str) -> None:
        """Let a finger meet something where it is now; one that the hand does not have, such as the palm, is ignored.

        Args:
            finger: Its name in the hand's `HandModel`.
        """
        self.tell(lambda hand: hand.met(finger))

    def happen(self, event: str, motor: int | None, *words: str) -> None:
        """Let a motor or all get hot, let one jam or break, stop the controllers, or the diagnostics.

        Args:
            event: Its first word, one of `events`.
            motor: The motor that it names; None without one.
            words: What follows.

        Raises:
            ValueError: There is no such event, or a word is wrong.
        """
        if event == "heat" and len(words) == 1:
            degrees = float(words[0])
            self._change(motor, "temperature", degrees)
        elif event in ("jam", "free", "break", "repair") and motor is not None and not words:
            field = "jammed" if event in ("jam", "free") else "bridge_fault"
            self._change(motor, field, event in ("jam", "break"))
            if event == "break":
                self._change(motor, "halted", True)
        elif event == "controllers" and motor is None and words in (("on",), ("off",)):
            self.tell(lambda hand: _run(hand, words == ("on",)))
        elif event == "diagnostics" and motor is None and words in (("on",), ("off",)):
            self._diagnoses = words == ("on",)
        else:
            raise ValueError(event)

    def _change(self, motor: int | None, field: str, value: object) -> None:
        def change(hand: Hand) -> None:
            hand.run()
            for changed in hand.motors if motor is None else [hand.motors[motor]]:
                setattr(changed, field, value)

        self.tell(change)

    def _converse(self, connection: ServerConnection) -> None:
        """One client, in a thread of its own."""
        client = Client(self._command)
        self._clients[connection] = client
        try:
            for data in connection:
                for answer in client.take(data):
                    connection.send(json.dumps(answer))
                if self.faults.echo:
                    connection.send(data)
        except (ConnectionClosed, OSError):
            pass
        finally:
            self._clients.pop(connection, None)

    def _command(self, topic: str, message: dict[str, Any]) -> None:
        def command(hand: Hand) -> None:
            hand.run()
            for controller in (hand.fingers, hand.wrist):
                if topic == f"/{controller.name}/command":
                    controller.command(message, hand.now)

        self.tell(command)

    def _publish(self) -> None:
        """Publish what is due, in a thread of its own."""
        due = dict.fromkeys(ros.PERIODS, time.monotonic())
        late: list[tuple[float, int, ServerConnection, bytes]] = []
        numbers = itertools.count()
        while not self._over.wait(TICK):
            now = time.monotonic()
            for topic, period in ros.PERIODS.items():
                if now < due[topic]:
                    continue
                due[topic] = max(due[topic] + period / self._pace, now - period)
                if topic == ros.DIAGNOSTICS and not self._diagnoses:
                    continue
                with self._lock:
                    self._hand.run()
                    said = ros.message(self._hand, topic, next(numbers))
                data = json.dumps({"op": "publish", "topic": topic, "msg": said}).encode()
                for connection, client in list(self._clients.items()):
                    if client.wants(topic, now):
                        for piece in self.faults.on_the_way(data):
                            heapq.heappush(late, (now + piece.delay, next(numbers), connection, piece.data))
            while late and late[0][0] <= now:
                _, _, connection, piece_data = heapq.heappop(late)
                with suppress(ConnectionClosed, OSError):
                    connection.send(piece_data, text=True)


def _of_the_left_hand(data: bytes) -> bytes:
    """The same message of a left hand on the same computer."""
    return data.replace(b"rh_", b"lh_").replace(b"rh SRD", b"lh SRD")


def _run(hand: Hand, running: bool) -> None:
    hand.run()
    hand.fingers.running = hand.wrist.running = running

"""The emulated Shadow Hand behind a rosbridge's websocket."""

from __future__ import annotations

import heapq
import itertools
import json
import select
import time
from typing import Any

from toolee_robot.robots.hands.shadow import joints_of_motors
from toolee_robot.sim_backend.hand_wire import HandEmulator, HandTime, LineFaults, listener
from toolee_robot.sim_backend.shadow_hand import ros
from toolee_robot.sim_backend.shadow_hand.bridge import Client
from toolee_robot.sim_backend.shadow_hand.hand import NAMES, Hand
from toolee_robot.sim_backend.shadow_hand.websocket import WebSocket

BURST = 24
"""Bytes that a damaged message has others of: where TCP fails, it fails for a stretch."""


class ShadowEmulator(HandEmulator[Hand]):
    """A right Shadow Hand that a driver finds at `port`, the address of a rosbridge.

    Args:
        seed: Seed of the noise.
        pace: Rate of the hand's time relative to the host's, its clock included; messages come at the host's.
        address: Host and port at which the rosbridge listens; port 0 for a free one.

    Raises:
        UserError: It cannot listen there.
    """

    label = "Shadow Dexterous Hand (right) behind a rosbridge"
    motors, thumb = NAMES, "THJ5"
    joints = staticmethod(joints_of_motors)
    events = (
        "heat MOTOR DEGREES, heat DEGREES, jam MOTOR, free MOTOR, break MOTOR, repair MOTOR, "
        "controllers off, controllers on, diagnostics off, diagnostics on"
    )

    def __init__(self, seed: int = 0, pace: float = 1.0, address: tuple[str, int] = ("127.0.0.1", 0)) -> None:
        faults = LineFaults(_of_the_left_hand, seed, burst=BURST)
        self.time = HandTime(pace)
        super().__init__(Hand(self.time, seed), faults)
        self._listener = listener(address)
        host, port = self._listener.getsockname()[:2]
        self.port = f"ws://{host}:{port}"
        self._clients: dict[WebSocket, Client] = {}
        self._diagnoses = True
        self._late: list[tuple[float, int, WebSocket, bytes]] = []
        self._numbers = itertools.count()

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

    def _command(self, topic: str, message: dict[str, Any]) -> None:
        def command(hand: Hand) -> None:
            hand.run()
            for controller in (hand.fingers, hand.wrist):
                if topic == f"/{controller.name}/command":
                    controller.command(message, hand.now)

        self.tell(command)

    def _run(self) -> None:
        due = dict.fromkeys(ros.PERIODS, time.monotonic())
        try:
            while not self._over:
                next_at = min([*due.values(), *(at for at, *_ in self._late[:1])])
                wait = max(0.0, next_at - time.monotonic())
                watched: list[Any] = [self._listener, self._woken, *self._clients]
                ready, _, _ = select.select(watched, [], [], wait)
                if self._listener in ready:
                    self._clients[WebSocket(self._listener.accept()[0])] = Client(self._command)
                for websocket in [one for one in ready if isinstance(one, WebSocket)]:
                    self._converse(websocket)
                self._publish(due)
        finally:
            self._listener.close()
            for client in self._clients:
                client.cut()

    def _converse(self, websocket: WebSocket) -> None:
        """Carry out what a client asks for."""
        client = self._clients[websocket]
        for data in websocket.receive():
            for answer in client.take(data):
                websocket.send(json.dumps(answer).encode())
            if self.faults.echo:
                websocket.send(data)
        self._drop_if_gone(websocket)

    def _publish(self, due: dict[str, float]) -> None:
        """Publish what is due."""
        now = time.monotonic()
        for topic, period in ros.PERIODS.items():
            if now < due[topic]:
                continue
            due[topic] = max(due[topic] + period, now - period)
            wanting = [websocket for websocket, client in self._clients.items() if client.wants(topic, now)]
            if not wanting or (topic == ros.DIAGNOSTICS and not self._diagnoses):
                continue
            with self._lock:
                self._hand.run()
                said = ros.message(self._hand, topic, next(self._numbers))
            data = json.dumps({"op": "publish", "topic": topic, "msg": said}).encode()
            for websocket in wanting:
                for piece in self.faults.on_the_way(data):
                    heapq.heappush(self._late, (now + piece.delay, next(self._numbers), websocket, piece.data))
        while self._late and self._late[0][0] <= now:
            _, _, websocket, data = heapq.heappop(self._late)
            if websocket in self._clients:
                websocket.send(data)
                self._drop_if_gone(websocket)

    def _drop_if_gone(self, websocket: WebSocket) -> None:
        if not websocket.open:
            self._clients.pop(websocket, None)
            websocket.cut()


def _of_the_left_hand(data: bytes) -> bytes:
    """The same message of a left hand on the same computer."""
    return data.replace(b"rh_", b"lh_").replace(b"rh SRD", b"lh SRD")


def _run(hand: Hand, running: bool) -> None:
    hand.run()
    hand.fingers.running = hand.wrist.running = running

"""The rosbridge beside the emulated hand: one client's subscriptions, and what is answered to its operations."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from toolee_robot.sim_backend.shadow_hand.ros import PERIODS, TYPES

Publish = Callable[[str, dict[str, Any]], None]


class Client:
    """One client of the rosbridge.

    Args:
        publish: Publishes a message on a topic of the hand's computer.
    """

    def __init__(self, publish: Publish) -> None:
        self._publish = publish
        self._throttle: dict[str, float] = {}
        self._sent: dict[str, float] = {}

    def wants(self, topic: str, now: float) -> bool:
        """Whether a message of a topic goes out to it now, by its subscription and its `throttle_rate`.

        Args:
            topic: The topic.
            now: Time [s].

        Returns:
            Whether it does; it counts as sent then.
        """
        if topic not in self._throttle or now - self._sent.get(topic, -1e9) < self._throttle[topic]:
            return False
        self._sent[topic] = now
        return True

    def take(self, data: str | bytes) -> list[dict[str, Any]]:
        """Carry out an operation.

        Args:
            data: A websocket message.

        Returns:
            The operations that answer it. Text that is no JSON is passed over.
        """
        try:
            said = json.loads(data)
        except ValueError:
            return []
        if not isinstance(said, dict) or "op" not in said:
            return [_error("Received a message without an op.", said)]
        try:
            problem = self._carry_out(said["op"], said)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            problem = f"{said['op']}: {error!r}"
        return [_error(problem, said)] if problem else []

    def _carry_out(self, op: str, said: dict[str, Any]) -> str:
        topic = said.get("topic")
        if op == "subscribe":
            if topic in TYPES and said.get("type", TYPES[topic]) != TYPES[topic]:
                return f"subscribe: tried to subscribe to {topic} with type {said['type']}, it is {TYPES[topic]}"
            self._throttle[str(topic)] = 1e-3 * float(said.get("throttle_rate", 0))
        elif op == "unsubscribe":
            self._throttle.pop(str(topic), None)
        elif op in ("advertise", "unadvertise"):
            if topic in TYPES and op == "advertise" and said["type"] != TYPES[topic]:
                return f"advertise: {topic} has the type {TYPES[topic]}"
        elif op == "publish":
            if topic not in TYPES:
                return f"publish: cannot infer topic type for topic {topic} as it is not yet advertised"
            if topic not in PERIODS:
                self._publish(str(topic), dict(said["msg"]))
        elif op != "set_level":
            return f"Unknown operation: {op}."
        return ""


def _error(text: str, said: Any) -> dict[str, Any]:
    answer = {"op": "status", "level": "error", "msg": text}
    identity = said.get("id") if isinstance(said, dict) else None
    return answer if identity is None else answer | {"id": identity}

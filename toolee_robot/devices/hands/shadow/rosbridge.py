"""Operations of the rosbridge v2.0 protocol as text: built strictly, read strictly."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from toolee_robot.errors import ProtocolError

DAMAGED = "protocol.rosbridge"
"""Code of what is no operation of the protocol."""


@dataclass(frozen=True)
class Publication:
    """A message on a topic."""

    topic: str
    """The topic."""
    message: Mapping[str, Any]
    """The ROS message, its fields by name."""


@dataclass(frozen=True)
class Notice:
    """What rosbridge itself says: by default errors only."""

    level: str
    """Its level: "info", "warning", "error"."""
    text: str
    """What it says."""


def subscribe(topic: str, kind: str) -> str:
    """Build the request for a topic's messages, each as soon as it is there.

    Args:
        topic: The topic.
        kind: Its ROS type, such as `sensor_msgs/JointState`.

    Returns:
        The operation. Its queue holds the newest message only, so that a slow line brings no old ones.
    """
    return _text(op="subscribe", id=f"subscribe:{topic}", topic=topic, type=kind, throttle_rate=0, queue_length=1)


def advertise(topic: str, kind: str) -> str:
    """Build the announcement of messages on a topic.

    Args:
        topic: The topic.
        kind: Its ROS type.

    Returns:
        The operation.
    """
    return _text(op="advertise", id=f"advertise:{topic}", topic=topic, type=kind)


def publish(topic: str, message: Mapping[str, Any]) -> str:
    """Build a message on a topic.

    Args:
        topic: The topic.
        message: The ROS message, its fields by name.

    Returns:
        The operation.

    Raises:
        ValueError: A number in it is not finite.
    """
    return _text(op="publish", topic=topic, msg=message)


def decode(data: bytes) -> Publication | Notice | None:
    """Decode one websocket message.

    Args:
        data: Its bytes.

    Returns:
        What it says; None for an operation that is not in use here.

    Raises:
        ProtocolError: It is no operation of the protocol: no text, no JSON, a number that JSON does not have, a field
            twice, or a field that is missing or of a wrong type.
    """
    try:
        said = json.loads(data.decode("utf-8"), parse_constant=_refuse, object_pairs_hook=_fields)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"rosbridge sent what is no JSON: {error}", code=DAMAGED) from error
    if not isinstance(said, dict) or not isinstance(said.get("op"), str):
        raise ProtocolError("rosbridge sent something without an operation", code=DAMAGED)
    if said["op"] == "publish":
        topic, message = said.get("topic"), said.get("msg")
        if not isinstance(topic, str) or not isinstance(message, dict):
            raise ProtocolError("rosbridge sent a publication without topic or message", code=DAMAGED)
        return Publication(topic, message)
    if said["op"] == "status":
        return Notice(str(said.get("level")), str(said.get("msg")))
    return None


def _text(**fields: object) -> str:
    return json.dumps(fields, separators=(",", ":"), allow_nan=False)


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no number of JSON")


def _fields(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) != len(pairs):
        raise ValueError("a field twice in one object")
    return fields

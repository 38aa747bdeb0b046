"""The known hands, one `HandModel` each, and the tool mount.

A new hand is a record in a module of its own here, and an entry in `HANDS`; its device driver is a
`toolee_robot.hal.Hand` with the record's joints.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Protocol

from toolee_robot.errors import ConfigError
from toolee_robot.robots.hands.model import PALM, Finger, HandModel, NominalGrasp, Phalanx, WristJoint
from toolee_robot.robots.hands.mount import mount_model
from toolee_robot.robots.hands.shadow import SHADOW_HAND
from toolee_robot.types import MOUNT, HandWeight, ToolMount

HANDS: dict[str, HandModel] = {hand.name: hand for hand in (SHADOW_HAND,)}
"""Name in the station file -> hand."""


class HandChoice(Protocol):
    """What a station file says of its hand: `config.HandConfig`."""

    @property
    def model(self) -> str:
        """Name of the hand, a key of `HANDS`, or `MOUNT`."""

    @property
    def yield_torque(self) -> float | None:
        """Torque above which wrist or mount yields [Nm]; None for the hand's own."""

    @property
    def weighed(self) -> HandWeight | None:
        """What hangs on the flange without a tool; None for the hand's own masses."""

    @property
    def mount(self) -> ToolMount | None:
        """The tool mount; None for a hand."""


def hand_model(hand: str | HandChoice) -> HandModel:
    """Look up a hand, or build a tool mount.

    Args:
        hand: Name of the hand, a key of `HANDS`; or what the station file says of it.

    Returns:
        The hand, with the station's yield torque and weight where it gives them.

    Raises:
        ConfigError: There is no such hand, the message names those that are known; or it has no wrist that could yield.
    """
    if isinstance(hand, str):
        name, torque, weighed, mount = hand, None, None, None
    else:
        name, torque, weighed, mount = hand.model, hand.yield_torque, hand.weighed, hand.mount
    if mount is not None and torque is not None:
        return mount_model(mount, torque)
    if name == MOUNT:
        raise ConfigError("a tool mount needs its data: give hand.mount and hand.yield_torque in a station file")
    try:
        model = HANDS[name]
    except KeyError:
        known = ", ".join((*HANDS, MOUNT))
        raise ConfigError(
            f"there is no hand {name!r} (hand.model in a station file, --hand): choose one of {known}"
        ) from None
    return model if torque is None and weighed is None else _with(model, torque, weighed)


@lru_cache(maxsize=8)
def _with(hand: HandModel, torque: float | None, weighed: HandWeight | None) -> HandModel:
    if torque is None:
        return replace(hand, weighed=weighed)
    index = hand.yielding
    if index is None:
        raise ConfigError(f"hand.yield_torque: the {hand.label} has no wrist that yields; remove the field")
    wrist = (*hand.wrist[:index], replace(hand.wrist[index], torque=torque), *hand.wrist[index + 1 :])
    return replace(hand, wrist=wrist, weighed=weighed)


__all__ = [
    "HANDS",
    "MOUNT",
    "PALM",
    "SHADOW_HAND",
    "Finger",
    "HandChoice",
    "HandModel",
    "NominalGrasp",
    "Phalanx",
    "WristJoint",
    "hand_model",
]

"""The known hands, one `HandModel` each.

A new hand is a record in a module of its own here, and an entry in `HANDS`; its device driver is a
`toolee_robot.hal.Hand` with the record's joints.
"""

from toolee_robot.errors import ConfigError
from toolee_robot.robots.hands.model import PALM, Finger, HandModel, NominalGrasp, Phalanx, WristJoint
from toolee_robot.robots.hands.shadow import SHADOW_HAND

HANDS: dict[str, HandModel] = {hand.name: hand for hand in (SHADOW_HAND,)}
"""Name in the station file -> hand."""


def hand_model(name: str) -> HandModel:
    """Look up a hand.

    Args:
        name: Name of the hand, a key of `HANDS`.

    Raises:
        ConfigError: There is no such hand; the message names those that are known.
    """
    try:
        return HANDS[name]
    except KeyError:
        raise ConfigError(
            f"there is no hand {name!r} (hand.model in a station file, --hand): choose one of {', '.join(HANDS)}"
        ) from None


__all__ = [
    "HANDS",
    "PALM",
    "SHADOW_HAND",
    "Finger",
    "HandModel",
    "NominalGrasp",
    "Phalanx",
    "WristJoint",
    "hand_model",
]

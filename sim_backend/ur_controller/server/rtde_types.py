"""Types of RTDE variables and their big-endian encoding (UR, "RTDE guide")."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache

HEADER = struct.Struct(">HB")  # size of the whole packet, type

PROTOCOL_VERSION, CONTROLLER_VERSION, TEXT, DATA = ord("V"), ord("v"), ord("M"), ord("U")
OUTPUTS, INPUTS, START, PAUSE = ord("O"), ord("I"), ord("S"), ord("P")

# type name -> struct format (without byte order)
FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}


def width(type_name: str) -> int:
    """Number of values of a variable of this type."""
    return 6 if type_name.startswith("VECTOR6") else 3 if type_name == "VECTOR3D" else 1


@dataclass(frozen=True)
class Recipe:
    """The variables of a data packet, in order.

    Attributes:
        names: Names of the variables.
        types: Their RTDE types.
    """

    names: tuple[str, ...]
    types: tuple[str, ...]

    @property
    def layout(self) -> struct.Struct:
        """Binary layout of the values."""
        return _layout(self.types)


@lru_cache(maxsize=256)
def _layout(types: tuple[str, ...]) -> struct.Struct:
    return struct.Struct(">" + "".join(FORMATS[type_name] for type_name in types))


def packet(kind: int, payload: bytes = b"") -> bytes:
    """Encode a packet.

    Args:
        kind: Type of the packet.
        payload: Its payload.

    Returns:
        The packet with its header.
    """
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def split_names(payload: bytes) -> tuple[str, ...]:
    """Split a list of variable names, which clients may end with a comma. Undecodable bytes give unknown names."""
    return tuple(name for name in payload.decode("ascii", "replace").split(",") if name)

"""The clicks that the pose of each category needs: what the page asks for, and what a fit refuses to go without."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from toolee_robot.end_effectors import Category


class Role(StrEnum):
    """What a click shows."""

    RIM = "rim"
    SURFACE = "surface"
    THROAT = "throat"
    END_A = "end_a"
    END_B = "end_b"
    TIP = "tip"
    SHAFT = "shaft"
    HANDLE = "handle"
    BOX = "box"


class Shape(StrEnum):
    """What is fitted to the clicks."""

    FACE = "face"
    CLAW = "claw"
    OPEN_JAW = "open_jaw"
    RING = "ring"
    TIP = "tip"

    @property
    def category(self) -> Category:
        """The category of end effectors that have this shape."""
        return PROTOCOL[self].category


@dataclass(frozen=True)
class Asked:
    """Clicks of one role.

    Attributes:
        least: Fewest clicks with which there is a pose.
        advised: Number with which a wrong one shows.
        where: Where to click.
        depth: Whether the depth at these clicks is measured too; at the edge of a surface it is not to be trusted.
    """

    least: int
    advised: int
    where: str
    depth: bool = True


@dataclass(frozen=True)
class Protocol:
    """What the pose of a shape needs.

    Attributes:
        label: Its name on the page.
        category: The category of end effectors.
        clicks: Clicks by role, in the order in which the page asks for them.
        caliper: What is measured with a caliper [mm].
        caliper_needed: Whether there is no pose without it; otherwise it is a check, and makes the pose more accurate.
    """

    label: str
    category: Category
    clicks: dict[Role, Asked]
    caliper: str
    caliper_needed: bool


_SURFACE = "the flat itself, well inside of its edges and spread over it"
_HANDLE = Asked(1, 1, "the middle of the handle's free end, or as far along the handle as it is seen")

PROTOCOL: dict[Shape, Protocol] = {
    Shape.FACE: Protocol(
        "hammer face",
        Category.HAMMER_HEAD,
        {
            Role.RIM: Asked(
                5, 8, "the edge of the striking face, all around; of a square or octagonal face its corners", False
            ),
            Role.SURFACE: Asked(3, 6, _SURFACE),
            Role.HANDLE: Asked(0, 1, _HANDLE.where),
        },
        "diameter of the face (of a square face, its diagonal)",
        False,
    ),
    Shape.CLAW: Protocol(
        "claw",
        Category.HAMMER_GRIP,
        {
            Role.SURFACE: Asked(3, 6, "both tines beside the middle of the slot, within a centimetre along it"),
            Role.THROAT: Asked(1, 2, "the closed end of the slot"),
            Role.END_A: Asked(1, 2, "the inner corner of one tine at the slot's open end"),
            Role.END_B: Asked(1, 2, "the inner corner of the other tine"),
            Role.HANDLE: _HANDLE,
        },
        "thickness of the tines beside the middle of the slot",
        True,
    ),
    Shape.OPEN_JAW: Protocol(
        "open or adjustable jaw",
        Category.WRENCH_HEAD,
        {
            Role.SURFACE: Asked(3, 6, "the broad side of the jaw, well inside of its edges and spread over it"),
            Role.THROAT: Asked(1, 2, "the deepest point of the opening, on its centre line", False),
            Role.END_A: Asked(1, 2, "the end of one flat, at the opening's mouth", False),
            Role.END_B: Asked(1, 2, "the end of the other flat", False),
            Role.HANDLE: _HANDLE,
        },
        "thickness of the jaw",
        True,
    ),
    Shape.RING: Protocol(
        "ring or socket",
        Category.WRENCH_HEAD,
        {
            Role.RIM: Asked(5, 8, "the corners of the hole, all around, on the side that is seen", False),
            Role.SURFACE: Asked(3, 6, "the ring's rim around the hole, spread over it"),
            Role.HANDLE: _HANDLE,
        },
        "thickness of the ring (of a socket, depth of its hole)",
        True,
    ),
    Shape.TIP: Protocol(
        "screwdriver tip",
        Category.SCREWDRIVER_HEAD,
        {
            Role.TIP: Asked(1, 2, "the middle of the tip's end", False),
            Role.SHAFT: Asked(2, 5, "the shaft's centre line, from near the tip to near the handle"),
        },
        "diameter of the shaft",
        True,
    ),
}
"""What each shape needs."""

BOX = Asked(
    0, 2, "two opposite corners of the box of what is seen of the end effector; left out: found in the depth image"
)
"""The box that a detection is compared with."""

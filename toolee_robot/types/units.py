"""The unit and the range of a number in a file, as part of its type: `Annotated[float, Metres(0.01, 2.0)]`."""

from __future__ import annotations

import reprlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import isfinite, pi
from typing import Annotated, Any

_SHORT = reprlib.Repr()
_SHORT.maxlevel = 1
OTHER_UNITS = {
    "m": (("millimetres", 1e-3),),
    "rad": (("degrees", pi / 180.0),),
    "kg": (("grams", 1e-3),),
    "m/s": (("millimetres per second", 1e-3),),
    "rad/s": (("degrees per second", pi / 180.0),),
    "s": (("milliseconds", 1e-3), ("microseconds", 1e-6)),
}
"""What a number that is out of its range may have been given in instead, and what one of those is."""


@dataclass(frozen=True)
class Unit:
    """Unit and range of a number: metadata of its type, by which pydantic checks it.

    Attributes:
        symbol: The unit, such as m; empty for a number without one.
        low: The smallest value.
        high: The largest value.
        why: What the range follows from, for the message that refuses a value; empty where it is plain.
    """

    symbol: str
    low: float
    high: float
    why: str = ""

    @property
    def range(self) -> str:
        """The range in words, such as `0.01 to 2 m`."""
        return f"{self.low:.6g} to {self.high:.6g} {self.symbol}".rstrip()

    def checked(self, value: Any) -> Any:
        """Refuse what is no number, and a number that is out of the range.

        Args:
            value: What a file holds.

        Returns:
            The same.

        Raises:
            ValueError: It is refused; the message names the unit, the range, and the unit that was meant.
        """
        try:
            number = float("nan") if isinstance(value, bool) else float(value)  # YAML takes 1e-05 for a text
        except (TypeError, ValueError, OverflowError):
            number = float("nan")
        if not isfinite(number):
            raise ValueError(
                f"{shown(value)} is not a number: give digits, a point for decimals, no unit ({self.range})"
            )
        if self.low <= number <= self.high:
            return value
        why = f" ({self.why})" if self.why else ""
        raise ValueError(f"{value} is out of range, {self.range}{why}{self._meant(number)}")

    def _meant(self, number: float) -> str:
        for name, size in OTHER_UNITS.get(self.symbol, ()):
            if self.low <= number * size <= self.high:
                return f": that looks like {name}"
        return ""

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        from pydantic_core import core_schema  # the records need no pydantic until a file is read

        return core_schema.no_info_before_validator_function(self.checked, handler(source))


Number = partial(Unit, "")
Metres = partial(Unit, "m")
Radians = partial(Unit, "rad")
Kilograms = partial(Unit, "kg")
Seconds = partial(Unit, "s")
Newtons = partial(Unit, "N")
NewtonMetres = partial(Unit, "Nm")
MetresPerSecond = partial(Unit, "m/s")
RadiansPerSecond = partial(Unit, "rad/s")
RadiansPerSecond2 = partial(Unit, "rad/s^2")
RadiansPerSecond3 = partial(Unit, "rad/s^3")
Pixels = partial(Unit, "px")

Part = Annotated[float, Number(-100.0, 100.0, "part of a direction; its length does not matter")]
Direction = tuple[Part, Part, Part]
"""A direction of any length."""
Near = Annotated[float, Metres(-1.0, 1.0, "on or beside a flange or a tool")]
NearPoint = tuple[Near, Near, Near]
"""A point of a hand, a mount or a tool."""


def shown(value: Any) -> str:
    """A value of a file in a message, of any size and depth, on part of a line."""
    return _SHORT.repr(value)

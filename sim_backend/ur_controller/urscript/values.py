"""Values of a script and the operations on them.

Types are 32-bit integers, floats, booleans, strings, lists and poses. There are no implicit conversions: a boolean is
not a number, and an integer that does not fit 32 bits is an error. Lists and poses have value semantics: assignment
copies.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from toolee_robot.sim_backend.ur_controller.urscript.tokens import INT_MAX

_NUMBERS = frozenset({int, float})


class Pose(list[float]):
    """A pose `p[x, y, z, rx, ry, rz]`: position [m], rotation vector [rad]."""


def kind(value: Any) -> str:
    """Name of a value's type in messages."""
    if value is None:
        return "nothing"
    names = {bool: "a boolean", int: "an integer", float: "a float", str: "a text", list: "a list", Pose: "a pose"}
    return names.get(type(value), f"a {type(value).__name__.strip('_').lower()}")


def numbers(a: Any, b: Any) -> None:
    """Check the operands of an operation.

    Args:
        a: The first operand.
        b: The second operand.

    Raises:
        TypeError: One of them is not a number.
    """
    if type(a) not in _NUMBERS or type(b) not in _NUMBERS:
        raise TypeError(f"expected two numbers, got {kind(a)} and {kind(b)}")


def fitting(value: Any) -> Any:
    """The value; raises OverflowError for an integer that does not fit 32 bits."""
    if type(value) is int and not -INT_MAX - 1 <= value <= INT_MAX:
        raise OverflowError("an integer does not fit 32 bits")
    return value


def of_numbers(operation: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """The operation on two values of a script.

    Args:
        operation: The operation on Python's numbers.

    Returns:
        The same; it raises TypeError for other values, and OverflowError for an integer that does not fit 32 bits.
    """

    def call(a: Any, b: Any) -> Any:
        numbers(a, b)
        return fitting(operation(a, b))

    return call


def negate(a: Any) -> Any:
    """Negation -a."""
    numbers(a, 0)
    return fitting(-a)


def truth(value: Any) -> bool:
    """The value; raises TypeError unless it is a boolean."""
    if value is True or value is False:
        return value
    raise TypeError(f"expected a boolean, got {kind(value)}")


def _position(values: Any, index: Any) -> int:
    if not isinstance(values, list):
        raise TypeError(f"expected a list, got {kind(values)}")
    if type(index) is not int:
        raise TypeError(f"expected an integer as the index, got {kind(index)}")
    if not 0 <= index < len(values):
        raise IndexError(f"index {index} is outside a list of {len(values)}")
    return index


def item(values: Any, index: Any) -> Any:
    """Element of a list or pose.

    Args:
        values: The list or pose.
        index: Index of the element.

    Returns:
        The element.

    Raises:
        TypeError: It has no elements, or the index is not an integer.
        IndexError: There is no such element.
    """
    return values[_position(values, index)]


def flat(value: Any) -> Any:
    """The value; raises TypeError for a list of lists, which must not be an element of a list."""
    if isinstance(value, list) and any(isinstance(each, list) for each in value):
        raise TypeError("lists are nested twice at most")
    return value


def set_item(values: Any, index: Any, value: Any) -> None:
    """Set an element of a list or pose.

    Args:
        values: The list or pose.
        index: Index of the element.
        value: The new value.

    Raises:
        TypeError: It has no elements, the index is not an integer, or the value does not fit.
        IndexError: There is no such element.
    """
    at = _position(values, index)
    flat(value)
    if type(values) is Pose:
        numbers(value, 0)
    values[at] = value


def pose(*items: Any) -> Pose:
    """A pose of numbers; raises TypeError."""
    for value in items:
        numbers(value, 0)
    return Pose(items)


def copied(value: Any) -> Any:
    """The value, or a deep copy of a list."""
    if isinstance(value, list):
        return type(value)(copied(each) for each in value)
    return value


def text(value: Any) -> str:
    """The value as `textmsg` and `to_str` format it."""
    if isinstance(value, list):
        return ("p[" if type(value) is Pose else "[") + ", ".join(map(text, value)) + "]"
    if type(value) is float:
        return f"{value:.6g}"
    return str(value)

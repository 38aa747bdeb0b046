"""Values of a script, and functions that need no robot: mathematics, poses and lists.

Types are 32-bit integers, floats, booleans, strings, lists and poses. There are no implicit conversions: a boolean is
not a number, and an integer that does not fit 32 bits is an error. Lists and poses have value semantics: assignment
copies. Names, arguments and semantics of the functions are those of Universal Robots' Script Manual.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from toolee_robot import frames
from toolee_robot.sim_backend.ur_controller.robot import poses
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


LIBRARY: dict[str, Callable[..., Any]] = {}


def _function(f: Callable[..., Any]) -> Callable[..., Any]:
    LIBRARY[f.__name__] = f
    return f


def _float(f: float) -> float:
    numbers(f, 0)
    return float(f)


def six(values: Any, what: str = "value") -> list[float]:
    """Six finite numbers of a pose or list, called `what` in messages. Raises TypeError or ValueError."""
    if not isinstance(values, list) or len(values) != 6:
        raise TypeError(f"the {what} has to be a pose or a list of 6 numbers, not {text(values)}")
    found = [_float(each) for each in values]
    if not all(map(math.isfinite, found)):
        raise ValueError(f"the {what} {text(values)} is not finite")
    return found


def matrix(pose: Any) -> Any:
    """Matrix, 4x4, of the script's value of a pose. Raises TypeError or ValueError."""
    return poses.matrix(six(pose, "pose"))


def as_pose(X: Any) -> Pose:
    """The script's value of a pose, 4x4."""
    return Pose(poses.vector(X))


def _of_number(function: Callable[[float], float]) -> Callable[..., Any]:
    def call(f: float) -> float:
        return function(_float(f))

    return call


for _each in (math.acos, math.asin, math.atan, math.cos, math.sin, math.tan, math.sqrt):
    LIBRARY[_each.__name__] = _of_number(_each)


@_function
def atan2(x: float, y: float) -> float:
    """Angle of the point (y, x) [rad]; the manual calls the ordinate, which comes first, x."""
    return math.atan2(_float(x), _float(y))


@_function
def pow(base: float, exponent: float) -> float:
    return math.pow(_float(base), _float(exponent))


@_function
def log(b: float, f: float) -> float:
    """Logarithm of f to the base b."""
    return math.log(_float(f)) / math.log(_float(b))


@_function
def ceil(f: float) -> int:
    return int(fitting(math.ceil(_float(f))))


@_function
def floor(f: float) -> int:
    return int(fitting(math.floor(_float(f))))


@_function
def d2r(d: float) -> float:
    return math.radians(_float(d))


@_function
def r2d(r: float) -> float:
    return math.degrees(_float(r))


@_function
def norm(a: Any) -> float:
    """Euclidean norm of a list, absolute value of a number."""
    if isinstance(a, list):
        return math.hypot(*(_float(each) for each in a))
    return abs(_float(a))


@_function
def length(v: Any) -> int:
    if not isinstance(v, list | str):
        raise TypeError(f"length() of {text(v)}: expected a list or a text")
    return len(v)


@_function
def point_dist(p_from: Any, p_to: Any) -> float:
    """Distance of the positions [m]."""
    return math.dist(six(p_from, "pose")[:3], six(p_to, "pose")[:3])


@_function
def pose_trans(p_from: Any, p_from_to: Any) -> Pose:
    return as_pose(matrix(p_from) @ matrix(p_from_to))


@_function
def pose_inv(p_from: Any) -> Pose:
    return as_pose(frames.inverse(matrix(p_from)))


@_function
def pose_add(p_1: Any, p_2: Any) -> Pose:
    """Sum of two poses: positions are added, rotations multiplied."""
    X, Y = matrix(p_1), matrix(p_2)
    return Pose([*(X[:3, 3] + Y[:3, 3]).tolist(), *poses.rotation_vector(X[:3, :3] @ Y[:3, :3])])


@_function
def pose_sub(p_to: Any, p_from: Any) -> Pose:
    """The pose that `pose_add` adds to p_from to give p_to."""
    X, Y = matrix(p_to), matrix(p_from)
    return Pose([*(X[:3, 3] - Y[:3, 3]).tolist(), *poses.rotation_vector(Y[:3, :3].T @ X[:3, :3])])

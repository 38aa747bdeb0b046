"""URScript functions that need no robot: mathematics, poses and lists.

Names, arguments and semantics are those of Universal Robots' Script Manual.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from toolee_robot import frames
from toolee_robot.sim_backend.ur_controller.robot import poses
from toolee_robot.sim_backend.ur_controller.urscript.values import Pose, fitting, numbers, text

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

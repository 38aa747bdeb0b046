"""URScript functions that need no robot: mathematics, poses, lists and strings.

Names, arguments and semantics are those of Universal Robots' Script Manual.
"""

from __future__ import annotations

import math
import random as randomness
from collections.abc import Callable
from typing import Any

import numpy as np

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
def random() -> float:
    return randomness.random()


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


LIBRARY["get_list_length"] = length


@_function
def binary_list_to_integer(l: Any) -> int:
    """Integer of a list of bits, the least significant first."""
    if not isinstance(l, list) or not all(isinstance(bit, bool) for bit in l) or len(l) > 32:
        raise TypeError("expected a list of at most 32 booleans")
    value = sum(bit << i for i, bit in enumerate(l))
    return value - 2**32 if value >= 2**31 else value


@_function
def integer_to_binary_list(x: int) -> list[bool]:
    if type(x) is not int:
        raise TypeError("expected an integer")
    return [bool(x >> i & 1) for i in range(32)]


@_function
def point_dist(p_from: Any, p_to: Any) -> float:
    """Distance of the positions [m]."""
    return math.dist(six(p_from, "pose")[:3], six(p_to, "pose")[:3])


LIBRARY["pose_dist"] = point_dist


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


@_function
def interpolate_pose(p_from: Any, p_to: Any, alpha: float) -> Pose:
    """The pose at a fraction alpha of the straight path; extrapolates outside of 0 to 1."""
    return as_pose(poses.interpolated(matrix(p_from), matrix(p_to), _float(alpha)))


@_function
def wrench_trans(T_from_to: Any, w_from: Any) -> list[float]:
    """Transform a wrench from frame `from` to frame `to`."""
    X, w = matrix(T_from_to), np.array(six(w_from, "wrench"))
    R, p = X[:3, :3], X[:3, 3]
    return [*(R.T @ w[:3]).tolist(), *(R.T @ (w[3:] - np.cross(p, w[:3]))).tolist()]


@_function
def rotvec2rpy(rotation_vector: Any) -> list[float]:
    """Roll, pitch, yaw: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    R = poses.rotation([_float(each) for each in _three(rotation_vector)])
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    if math.hypot(R[0, 0], R[1, 0]) < 1e-12:
        return [math.atan2(-R[1, 2], R[1, 1]), pitch, 0.0]
    return [math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])]


@_function
def rpy2rotvec(rpy: Any) -> list[float]:
    roll, pitch, yaw = _three(rpy)
    R = poses.rotation([0, 0, yaw]) @ poses.rotation([0, pitch, 0]) @ poses.rotation([roll, 0, 0])
    return poses.rotation_vector(R)


def _three(values: Any) -> list[float]:
    if not isinstance(values, list) or len(values) != 3:
        raise TypeError("expected a list of 3 numbers")
    return [_float(each) for each in values]


def _text(value: Any) -> str:
    if type(value) is not str:
        raise TypeError(f"expected a text, not {text(value)}")
    return value


LONGEST = 1023  # characters of a text, as the controller has it


@_function
def str_cat(op1: Any, op2: Any) -> str:
    joined = text(op1) + text(op2)
    if len(joined) > LONGEST:
        raise ValueError(f"a text of more than {LONGEST} characters")
    return joined


@_function
def str_len(str: Any) -> int:
    return len(_text(str))


@_function
def str_empty(str: Any) -> bool:
    return not _text(str)


@_function
def str_at(src: Any, index: int) -> str:
    if type(index) is not int or not 0 <= index < len(_text(src)):
        raise IndexError(f"character {text(index)} is outside the text")
    return _text(src)[index]


@_function
def str_sub(src: Any, index: int, len: int = -1) -> str:
    """`len` characters from `index`, or all that follow if it is negative."""
    if type(index) is not int or type(len) is not int or index < 0:
        raise IndexError(f"character {text(index)} is outside the text")
    return _text(src)[index : index + len if len >= 0 else None]


@_function
def str_find(src: Any, target: Any, start_from: int = 0) -> int:
    """Index of the first occurrence, or -1."""
    if type(start_from) is not int or start_from < 0:
        raise IndexError(f"character {text(start_from)} is outside the text")
    return _text(src).find(_text(target), start_from)


@_function
def to_str(val: Any) -> str:
    return text(val)


@_function
def to_num(str: Any) -> float:
    return float(_text(str))

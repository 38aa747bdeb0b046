"""URScript functions that move the arm, with arguments, defaults and units of the Script Manual."""

from __future__ import annotations

from collections.abc import Callable, Generator
from math import ceil, isfinite
from typing import Any

import numpy as np

from toolee_robot import frames
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.robot import poses
from toolee_robot.sim_backend.ur_controller.robot.cartesian import (
    FREEDRIVE_GAIN,
    Compliance,
    Path,
    PathMove,
    ServoC,
    SpeedL,
    StopL,
    arc,
    line,
)
from toolee_robot.sim_backend.ur_controller.robot.kinematics import forward, inverse
from toolee_robot.sim_backend.ur_controller.robot.machine import Machine
from toolee_robot.sim_backend.ur_controller.robot.motion import (
    Brake,
    JointMove,
    Motion,
    MotionError,
    Move,
    SpeedJ,
)
from toolee_robot.sim_backend.ur_controller.robot.servoj import servoj
from toolee_robot.sim_backend.ur_controller.urscript.functions_library import Pose, matrix, numbers, six

Wait = Generator[None, None, None]


def positive(value: Any, what: str) -> float:
    """The value as a float; raises TypeError or ValueError unless it is a finite number above 0."""
    numbers(value, 0)
    if not (isfinite(value) and value > 0):
        raise ValueError(f"{what} has to be above 0, not {value}")
    return float(value)


class MotionFunctions:
    """Functions for motions; those that wait are generators with one `yield` per tick.

    Args:
        machine: The robot.
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    # -- moves

    def movej(self, q: Any, a: float = 1.4, v: float = 1.05, t: float = 0, r: float = 0) -> Wait:
        machine = self._machine
        goal = self._joints(q)
        move = JointMove(
            machine.model, machine.X_flange_tcp, goal, positive(a, "a"), positive(v, "v"), _time(t), _blend(r)
        )
        yield from self._move(move)

    def movel(self, pose: Any, a: float = 1.2, v: float = 0.25, t: float = 0, r: float = 0) -> Wait:
        X = self._pose(pose)
        yield from self._path(lambda start: line(start, X), a, v, t, r)

    def movep(self, pose: Any, a: float = 1.2, v: float = 0.25, r: float = 0) -> Wait:
        """As `movel`."""
        yield from self.movel(pose, a, v, 0, r)

    def movec(self, pose_via: Any, pose_to: Any, a: float = 1.2, v: float = 0.25, r: float = 0, mode: int = 0) -> Wait:
        """Move on a circle; mode 0: constant rotation axis, 1: orientation fixed relative to the circle."""
        via, X = self._pose(pose_via)[:3, 3], self._pose(pose_to)
        yield from self._path(lambda start: arc(start, via, X, mode == 1), a, v, 0, r)

    def _path(self, path: Callable[[Array], Path], a: float, v: float, t: float, r: float) -> Wait:
        machine = self._machine
        a, v = positive(a, "a"), positive(v, "v")
        yield from self._move(PathMove(machine.model, machine.X_flange_tcp, path, a, v, _time(t), _blend(r)))

    def _move(self, move: Move) -> Wait:
        with self._machine.moving_by(move):
            while not (move.done or move.blending):
                yield

    def _joints(self, q: Any) -> Array:
        """Joint positions of joints or a pose. Raises MotionError out of reach."""
        if isinstance(q, Pose):
            return np.array(self._reach(matrix(q)))
        goal = np.array(six(q, "joint vector"))
        if np.any(np.abs(goal) > self._machine.model.position):
            raise MotionError(f"the joints {goal.round(3).tolist()} are outside their limits")
        return goal

    def _pose(self, pose: Any) -> Array:
        """X_base_tcp, 4x4, of a pose or joints. Raises MotionError out of reach."""
        if isinstance(pose, Pose):
            X = matrix(pose)
            self._reach(X)
            return X
        return forward(self._machine.model, self._joints(pose)) @ self._machine.X_flange_tcp

    def _reach(self, X_base_tcp: Array) -> list[float]:
        machine = self._machine
        q = inverse(machine.model, X_base_tcp @ frames.inverse(machine.X_flange_tcp), machine.q_target)
        if q is None:
            raise MotionError(f"no joints reach the pose {np.round(poses.vector(X_base_tcp), 4).tolist()}")
        return q

    # -- servo and speed

    def servoj(
        self,
        q: Any,
        a: float = 0,
        v: float = 0,
        t: float = 0.002,
        lookahead_time: float = 0.1,
        gain: float = 300,
    ) -> Wait:
        """Servo to joint positions. a and v are not used, as on the robot."""
        numbers(a, v)
        numbers(lookahead_time, gain)
        goal = self._joints(list(six(q, "joint vector")))
        machine = self._machine
        motion = servoj(machine.model, machine.servo_lag, goal, positive(t, "t"), lookahead_time, gain)
        yield from self._for(motion, t)

    def servoc(self, pose: Any, a: float = 1.2, v: float = 0.25, r: float = 0) -> Wait:
        machine = self._machine
        motion = ServoC(
            machine.model, machine.X_flange_tcp, self._pose(pose), positive(a, "a"), positive(v, "v"), _blend(r)
        )
        with machine.moving_by(motion):
            yield
            while not motion.done:
                yield

    def speedj(self, qd: Any, a: float = 1.4, t: float = 0) -> Wait:
        motion = SpeedJ(self._machine.model, np.array(six(qd, "joint speeds")), positive(a, "a"))
        yield from self._for(motion, t, motion.reached)

    def speedl(self, xd: Any, a: float = 1.4, t: float = 0, aRot: Any = "a") -> Wait:
        machine = self._machine
        turning = positive(a if aRot == "a" else aRot, "aRot")
        goal = np.array(six(xd, "tool speed"))
        motion = SpeedL(machine.model, machine.X_flange_tcp, goal, positive(a, "a"), turning)
        yield from self._for(motion, t, motion.reached)

    def _for(self, motion: Motion, t: float, reached: Callable[[], bool] = bool) -> Wait:
        """Run a motion for t [s], at least a tick, or for t = 0 until its speed is reached."""
        numbers(t, 0)
        if not (isfinite(t) and t >= 0):
            raise ValueError(f"t has to be 0 or more, not {t}")
        machine = self._machine
        with machine.moving_by(motion):
            yield
            if t > 0:
                for _ in range(ceil(t * machine.model.rate - 1e-6) - 1):
                    yield
            else:
                while not (reached() or motion.done):
                    yield

    def stopj(self, a: float = 2.0) -> Wait:
        yield from self._until_rest(Brake(min(positive(a, "a"), self._machine.model.acceleration)))

    def stopl(self, a: float = 2.0, aRot: Any = "a") -> Wait:  # noqa: ARG002
        """Stop the TCP; aRot is not used, since translation and rotation stop together."""
        machine = self._machine
        yield from self._until_rest(StopL(machine.model, machine.X_flange_tcp, positive(a, "a")))

    def _until_rest(self, motion: Brake) -> Wait:
        with self._machine.moving_by(motion):
            while not motion.done:
                yield

    # -- compliance

    def force_mode(self, task_frame: Any, selection_vector: Any, wrench: Any, type: int, limits: Any) -> None:
        """Start force mode; only type 2, an unmodified task frame, is supported."""
        if type != 2:
            raise ValueError(f"force_mode of type {type}: the stand-in has type 2 only")
        machine = self._machine
        R, axes = matrix(task_frame)[:3, :3], np.array(six(selection_vector, "selection vector"))
        force, speed = np.array(six(wrench, "wrench")), np.abs(six(limits, "limits"))
        if machine.compliance is None or machine.freedrive:
            machine.compliance = Compliance(R, axes, force, speed, machine.force_gain)
            machine.freedrive = False
        else:
            now = machine.compliance
            now.R, now.axes, now.wrench, now.speed, now.gain = R, axes, force, speed, machine.force_gain

    def end_force_mode(self) -> None:
        self._machine.end_compliance()

    def force_mode_set_damping(self, damping: float) -> None:
        """Accept a damping of 0 to 1; the stand-in's time constant is fixed."""
        numbers(damping, 0)

    def force_mode_set_gain_scaling(self, scaling: float) -> None:
        """Set the gain of force mode, 0 to 2."""
        numbers(scaling, 0)
        self._machine.force_gain = max(0.0, min(2.0, float(scaling)))

    def freedrive_mode(self, freeAxes: Any = None, feature: Any = None) -> None:
        axes = [1] * 6 if freeAxes is None else freeAxes
        R = np.eye(3) if feature is None else matrix(feature)[:3, :3]
        speed = np.array([0.25] * 3 + [1.0] * 3)
        self._machine.compliance = Compliance(R, np.array(six(axes)), np.zeros(6), speed, FREEDRIVE_GAIN)
        self._machine.freedrive = True

    def end_freedrive_mode(self) -> None:
        self.end_force_mode()

    def get_freedrive_status(self) -> int:
        """Return 0: normal, also when freedrive is off."""
        return 0

    def teach_mode(self) -> None:
        self.freedrive_mode()

    def end_teach_mode(self) -> None:
        self.end_force_mode()


def _time(t: float) -> float:
    numbers(t, 0)
    return max(float(t), 0.0)


def _blend(r: float) -> float:
    numbers(r, 0)
    return max(float(r), 0.0)

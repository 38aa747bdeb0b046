"""A joint trajectory controller of ros_controllers, as far as its topics `command` and `state` go."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any


class Controller:
    """Interpolates positions of its joints on straight lines between the points of a trajectory.

    Args:
        name: Its name, such as "rh_trajectory_controller".
        joints: Its joints, in its own order.
        positions: Where they are [rad].

    Attributes:
        name: Its name.
        joints: Its joints.
        running: Whether it runs: one that is stopped publishes its state and takes no commands.
        refused: Commands that it has refused; nobody is told but the log of the hand's computer.
    """

    def __init__(self, name: str, joints: Sequence[str], positions: Sequence[float]) -> None:
        self.name, self.joints = name, tuple(joints)
        self.running = True
        self.refused = 0
        self._path: list[tuple[float, tuple[float, ...]]] = [(0.0, tuple(positions))]

    def desired(self, now: float) -> tuple[float, ...]:
        """Where it wants its joints to be.

        Args:
            now: Time [s].

        Returns:
            Positions in the order of `joints` [rad].
        """
        before = self._path[0]
        if now <= before[0]:
            return before[1]
        for after in self._path[1:]:
            if now < after[0]:
                share = (now - before[0]) / (after[0] - before[0])
                return tuple(a + share * (b - a) for a, b in zip(before[1], after[1], strict=True))
            before = after
        return before[1]

    def command(self, message: dict[str, Any], now: float) -> None:
        """Take a trajectory_msgs/JointTrajectory.

        Args:
            message: The message.
            now: Time [s].
        """
        if not self.running:
            self.refused += 1
            return
        points = message.get("points") or []
        if not points:
            self._path = [(now, self.desired(now))]
            return
        names = message.get("joint_names") or []
        stamp = (message.get("header") or {}).get("stamp") or {}
        asked = _seconds(stamp)
        start = asked if asked > 0.0 else now
        path = [(start + _seconds(point["time_from_start"]), point["positions"]) for point in points]
        times = [time for time, _ in path]
        proper = sorted(names) == sorted(self.joints) and all(len(at) == len(names) for _, at in path)
        if not proper or any(later <= earlier for earlier, later in pairwise(times)):
            self.refused += 1
            return
        order = [names.index(joint) for joint in self.joints]
        ahead = [(time, tuple(float(at[i]) for i in order)) for time, at in path if time > now]
        if not ahead:
            self.refused += 1
            return
        self._path = [(now, self.desired(now)), *ahead]


def _seconds(time: dict[str, Any]) -> float:
    return float(time.get("secs", 0)) + 1e-9 * float(time.get("nsecs", 0))

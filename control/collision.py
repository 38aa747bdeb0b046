"""Clearance between everything that moves and everything that it must not touch.

Bodies are convex; covering spheres give a lower bound of every pair's distance for a whole batch of configurations at
once, and only the pairs that come near are measured exactly (coal, GJK).
"""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
from numpy.typing import NDArray

from toolee_robot.config import StationConfig
from toolee_robot.control.collision_shapes import (
    Body,
    ToolEnvelope,
    arm_bodies,
    hand_bodies,
    station_bodies,
)
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import CollisionError
from toolee_robot.frames import Array

FAR = 0.05
"""[m]; clearance beyond this is not measured: it is reported as this."""

# Neighbours in the chain touch by construction.
_LINKS = ("base", "shoulder", "upper arm", "forearm", "wrist 1", "wrist 2", "wrist 3")
RUN_UP_EXEMPT = frozenset({("tool head", "block")})
"""Up to the contact only the head may come near the block."""
BRAKE_EXEMPT = frozenset(
    (part, body) for part in ("tool head", "tool claw", "tool handle") for body in ("block", "stand")
)
"""A missed nail ends in the block, which stops the tool; nothing but the tool may touch it."""


@dataclass(frozen=True)
class Clearance:
    """distance [m] (at most FAR) of the closest pair of bodies, its names, and the row of the batch where it occurs."""

    distance: float
    pair: tuple[str, str]
    row: int

    def __str__(self) -> str:
        return f"{self.pair[0]} and {self.pair[1]} ({self.distance * 1e3:.0f} mm)"


class CollisionWorld:
    """Arm, hand with its joints locked at q_hand (n,), the held tool if X_hand_ee (4x4) is given, and the station.

    X_hand_ee is the estimate, never the truth; `tool` encloses a nominal hammer around it. extra: further bodies.
    """

    def __init__(
        self,
        robot: RobotModel,
        config: StationConfig,
        q_hand: Array,
        X_hand_ee: Array | None = None,
        tool: ToolEnvelope | None = None,
        extra: tuple[Body, ...] = (),
    ) -> None:
        self.robot = robot
        arm = list(arm_bodies(robot))
        carried = hand_bodies(robot, q_hand)
        held: list[Body] = []
        if X_hand_ee is not None:
            X_flange_ee = robot.X_flange_hand(q_hand) @ X_hand_ee
            held = (tool or ToolEnvelope()).bodies(X_flange_ee, robot.arm.X_joint6_flange)
        station = [*station_bodies(config), *extra]
        self.bodies = [*arm, *carried, *held, *station]
        self._index = {body.name: i for i, body in enumerate(self.bodies)}
        self.pairs = np.array(list(self._pairs(arm, carried, held, station)))
        groups = np.array([body.group for body in self.bodies])
        self._groups = list(zip(groups[self.pairs[:, 0]], groups[self.pairs[:, 1]], strict=True))
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        self._sphere_joint = np.concatenate([np.full(len(b.spheres), b.joint) for b in self.bodies])
        self._spheres = np.concatenate([b.spheres for b in self.bodies])
        ends = np.cumsum([len(b.spheres) for b in self.bodies])
        self._slices = [slice(e - len(b.spheres), e) for e, b in zip(ends, self.bodies, strict=True)]
        # Every pair of spheres of every pair of bodies, flat, with the start of each body pair's run.
        first: list[NDArray[np.intp]] = []
        second: list[NDArray[np.intp]] = []
        starts: list[int] = []
        for i, j in self.pairs:
            a, b = np.arange(ends[-1])[self._slices[i]], np.arange(ends[-1])[self._slices[j]]
            starts.append(sum(len(f) for f in first))
            first.append(np.repeat(a, len(b)))
            second.append(np.tile(b, len(a)))
        self._first, self._second, self._starts = np.concatenate(first), np.concatenate(second), np.array(starts)
        self._radii = self._spheres[self._first, 3] + self._spheres[self._second, 3]
        # A box is badly covered by spheres, but a sphere's distance to an axis-aligned box is exact.
        self._boxes = {
            k: (b.X_joint_shape[:3, 3], np.asarray(b.geometry.halfSide))
            for k, b in enumerate(self.bodies)
            if isinstance(b.geometry, coal.Box) and b.joint == 0
        }

    def _pairs(
        self, arm: list[Body], carried: list[Body], held: list[Body], station: list[Body]
    ) -> list[tuple[int, int]]:
        found = []

        def add(a: Body, b: Body) -> None:
            found.append((self._index[a.name], self._index[b.name]))

        rank = {body.name: _LINKS.index(body.name) for body in arm}
        for a in arm:
            for b in arm:
                if rank[b.name] >= rank[a.name] + 3 or (rank[a.name] == 1 and rank[b.name] == 3):
                    add(a, b)
        for a in [*carried, *held]:
            for b in arm:
                # Fingers are too far down the forearm of the hand to reach the wrist they hang on.
                if rank[b.name] <= 3 or (rank[b.name] == 4 and a.group == "hand"):
                    add(b, a)
            for b in station:
                add(a, b)
        for a in arm:
            for b in station:
                if rank[a.name] >= 2:
                    add(a, b)
        return found

    def closest(
        self, q: Array, need: float = FAR, exempt: frozenset[tuple[str, str]] = frozenset(), *, first: bool = False
    ) -> Clearance:
        """The closest pair over configurations q (N, 6) or (6,), measured exactly below `need` [m].

        exempt: pairs of groups that may touch. first: stop at the first pair nearer than `need`.
        """
        q = np.atleast_2d(q)
        R, p = self.robot.arm.joints(q)
        R = np.concatenate([np.broadcast_to(np.eye(3), (len(q), 1, 3, 3)), R], axis=1)
        p = np.concatenate([np.zeros((len(q), 1, 3)), p], axis=1)
        bound = self._bounds(R, p)
        skip = np.array([g in exempt for g in self._groups])
        bound[:, skip] = np.inf
        order = np.argwhere(bound < need)
        order = order[np.argsort(bound[order[:, 0], order[:, 1]])]
        best = Clearance(need, ("nothing", "nothing"), 0)
        for row, k in order:
            if bound[row, k] >= best.distance:
                break
            i, j = self.pairs[k]
            distance = self._distance(self.bodies[i], self.bodies[j], R[row], p[row])
            if distance < best.distance:
                best = Clearance(distance, (self.bodies[i].name, self.bodies[j].name), int(row))
                if first or distance <= 0:
                    break
        return best

    def check(self, q: Array, need: float, what: str, exempt: frozenset[tuple[str, str]] = frozenset()) -> None:
        """Raise CollisionError naming the pair when anything comes nearer than `need` [m] in q (N, 6)."""
        closest = self.closest(q, need, exempt, first=True)
        if closest.distance < need:
            raise CollisionError(
                f"{what} would bring {closest} nearer than {need * 1e3:.0f} mm: nothing was moved; "
                "clear the way or move the target"
            )

    def free(self, q: Array, need: float, exempt: frozenset[tuple[str, str]] = frozenset()) -> bool:
        """Whether nothing comes nearer than `need` [m] in q (N, 6)."""
        return self.closest(q, need, exempt, first=True).distance >= need

    def _bounds(self, R: Array, p: Array) -> Array:
        """(N, pairs) lower bounds of the distances [m]."""
        c = np.einsum("nsij,sj->nsi", R[:, self._sphere_joint], self._spheres[:, :3]) + p[:, self._sphere_joint]
        apart = c[:, self._first] - c[:, self._second]
        gap = np.sqrt(np.einsum("nsi,nsi->ns", apart, apart)) - self._radii
        bound = np.minimum.reduceat(gap, self._starts, axis=1)
        for box, (centre, half) in self._boxes.items():
            outside = np.maximum(np.abs(c - centre) - half, 0.0)
            exact = np.sqrt(np.einsum("nsi,nsi->ns", outside, outside)) - self._spheres[:, 3]
            nearest = np.minimum.reduceat(exact, [part.start for part in self._slices], axis=1)
            rows = np.flatnonzero(self.pairs[:, 1] == box)
            bound[:, rows] = nearest[:, self.pairs[rows, 0]]
        return bound

    def _distance(self, a: Body, b: Body, R: Array, p: Array) -> float:
        self._result.clear()
        return float(
            coal.distance(a.geometry, _placed(a, R, p), b.geometry, _placed(b, R, p), self._request, self._result)
        )


def _placed(body: Body, R: Array, p: Array) -> coal.Transform3s:
    turn = R[body.joint]
    X = body.X_joint_shape
    return coal.Transform3s(turn @ X[:3, :3], turn @ X[:3, 3] + p[body.joint])

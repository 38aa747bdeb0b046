"""Clearance between arm, hand, tool and the bodies of the station.

Bodies are convex. Covering spheres give a lower bound of every pair's distance for a batch of configurations; only the
pairs whose bound is small are measured exactly (coal, GJK).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import coal
import numpy as np
from numpy.typing import NDArray

from toolee_robot.control.collision_shapes import (
    Body,
    arm_bodies,
    hand_bodies,
    station_bodies,
    tool_bodies,
)
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import CollisionError
from toolee_robot.frames import Array
from toolee_robot.station import StationConfig

FAR = 0.05
"""Largest clearance that is measured [m]; a larger one is reported as this value."""
REESTIMATED = 0.03
"""How far outside the workspace hand or tool may be at the start of a motion [m]: a look may find the tool elsewhere
in the hand than it was believed to be, by up to `task.abort_slip` and as much again by its rotation."""
ROUNDING = 1e-6
"""Tolerance of a comparison of places [m]."""

# Links in chain order; neighbours touch by construction and are not checked.
_LINKS = ("base", "shoulder", "upper arm", "forearm", "wrist 1", "wrist 2", "wrist 3")
RUN_UP_EXEMPT = frozenset({("tool head", "block"), ("tool head", "nail")})
"""Pairs of groups that may touch up to the contact: only the tool's head may come near the block, and near
nails beside the one that is struck: `StationConfig` keeps them apart by its radius."""
BESIDE_NAILS = frozenset((part, "nail") for part in ("tool head", "tool claw", "tool handle"))
"""Pairs of groups of which a strike only needs to keep the least clearance."""
BRAKE_EXEMPT = frozenset(
    (part, body) for part in ("tool head", "tool claw", "tool handle") for body in ("block", "stand", "nail")
)
"""Pairs of groups that may touch while braking: after a missed nail the block stops the tool."""


@dataclass(frozen=True)
class Clearance:
    """The closest pair of bodies in a batch of configurations.

    Attributes:
        distance: Distance of the pair, at most FAR [m].
        pair: Names of the two bodies.
    """

    distance: float
    pair: tuple[str, str]

    def __str__(self) -> str:
        return f"{self.pair[0]} and {self.pair[1]} ({self.distance * 1e3:.0f} mm)"


class CollisionWorld:
    """Collision model of arm, hand, held tool and station.

    Args:
        robot: Kinematic model of arm and hand.
        config: Configuration of the station.
        q_hand: Joint positions at which the hand is locked, (n,) [rad].
        X_hand_ee: Estimated pose of the end effector in the hand, (4, 4), around which the configured envelope of the
            tool lies; None without a tool.
        extra: Further bodies of the station.
        tool_off: How far the tool may be from where `X_hand_ee` has it, in every direction [m]: its envelope is so much
            larger.

    Attributes:
        robot: Kinematic model of arm and hand.
        q_hand: Joint positions at which the hand is locked, (n,) [rad].
        workspace: Lower and upper corner of the workspace in `base`, (3,) each [m].
        carried: Bodies of hand and tool.
        bodies: All bodies.
    """

    def __init__(
        self,
        robot: RobotModel,
        config: StationConfig,
        q_hand: Array,
        X_hand_ee: Array | None = None,
        extra: tuple[Body, ...] = (),
        tool_off: float = 0.0,
    ) -> None:
        self.robot, self.q_hand = robot, q_hand
        self.workspace = np.array(config.scene.workspace_lower), np.array(config.scene.workspace_upper)
        arm = list(arm_bodies(robot))
        carried = hand_bodies(robot, q_hand)
        held: list[Body] = []
        if X_hand_ee is not None:
            X_flange_ee = robot.X_flange_hand(q_hand) @ X_hand_ee
            held = tool_bodies(config.tool_envelope, X_flange_ee, robot.arm.X_joint6_flange, tool_off)
        station = [*station_bodies(config), *extra]
        self.carried = [*carried, *held]
        self.bodies = [*arm, *self.carried, *station]
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
        spheres = [np.arange(s.start, s.stop) for s in self._slices]
        first = [np.repeat(spheres[i], len(spheres[j])) for i, j in self.pairs]
        second = [np.tile(spheres[j], len(spheres[i])) for i, j in self.pairs]
        self._first, self._second = np.concatenate(first), np.concatenate(second)
        self._starts = np.cumsum([0, *(len(f) for f in first[:-1])])
        self._radii = self._spheres[self._first, 3] + self._spheres[self._second, 3]
        self._first_sphere = [part.start for part in self._slices]
        # A box is badly covered by spheres, but a sphere's distance to a box is exact.
        self._boxes: list[tuple[Array, Array, NDArray[np.intp]]] = []  # pose, half of its size, its pairs
        for k, b in enumerate(self.bodies):
            if isinstance(b.geometry, coal.Box) and b.joint == 0:
                rows = np.flatnonzero(self.pairs[:, 1] == k)
                self._boxes.append((b.X_joint_shape, np.asarray(b.geometry.halfSide), rows))

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
                # The hand's forearm keeps the fingers out of reach of the wrist that carries them.
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
        """Find the closest pair of bodies over a batch of configurations.

        Args:
            q: Joint positions of the arm, (N, 6) or (6,) [rad].
            need: Distance below which pairs are measured exactly [m].
            exempt: Pairs of groups that may touch.
            first: Whether to stop at the first pair nearer than `need`.

        Returns:
            The closest pair; distance `need` if none is nearer.
        """
        q = np.atleast_2d(q)
        R, p = self.robot.arm.joints(q)
        R = np.concatenate([np.broadcast_to(np.eye(3), (len(q), 1, 3, 3)), R], axis=1)
        p = np.concatenate([np.zeros((len(q), 1, 3)), p], axis=1)
        bound = self._bounds(R, p)
        if exempt:
            bound[:, [g in exempt for g in self._groups]] = np.inf
        order = np.argwhere(bound < need)
        order = order[np.argsort(bound[order[:, 0], order[:, 1]])]
        best = Clearance(need, ("nothing", "nothing"))
        for row, k in order:
            if bound[row, k] >= best.distance:
                break
            i, j = self.pairs[k]
            distance = self._distance(self.bodies[i], self.bodies[j], R[row], p[row])
            if distance < best.distance:
                best = Clearance(distance, (self.bodies[i].name, self.bodies[j].name))
                if first or distance <= 0:
                    break
        return best

    def check(self, q: Array, need: float, what: str, exempt: frozenset[tuple[str, str]] = frozenset()) -> None:
        """Check the clearance over a batch of configurations.

        Args:
            q: Joint positions of the arm, (N, 6) [rad].
            need: Required clearance [m].
            what: Name of the motion, for the message.
            exempt: Pairs of groups that may touch.

        Raises:
            CollisionError: Two bodies come nearer; the message names the pair.
        """
        closest = self.closest(q, need, exempt, first=True)
        if closest.distance < need:
            raise CollisionError(
                f"{what} would bring {closest} nearer than {need * 1e3:.0f} mm: nothing was moved; "
                "clear the way or move the target"
            )

    def free(self, q: Array, need: float, exempt: frozenset[tuple[str, str]] = frozenset()) -> bool:
        """Whether the clearance is sufficient over a batch of configurations.

        Args:
            q: Joint positions of the arm, (N, 6) [rad].
            need: Required clearance [m].
            exempt: Pairs of groups that may touch.
        """
        return self.closest(q, need, exempt, first=True).distance >= need

    def extremes(self, q: Array) -> Iterator[tuple[str, Array, Array]]:
        """Find the extremes of the carried bodies that the workspace might not hold.

        Args:
            q: Joint positions of the arm, (N, 6) [rad].

        Yields:
            Name of a body, and the least and greatest x, y and z of its points in `base`, (N, 3) each [m]. Bodies whose
            covering spheres lie within the workspace are left out.
        """
        lower, upper = self.workspace
        R, p = self.robot.arm.joints(q)
        R, p = np.swapaxes(R[:, 5], 1, 2), p[:, 5, None]
        for body in self.carried:
            x, radius = body.spheres[:, :3] @ R + p, body.spheres[:, 3:]
            if np.any(x - radius < lower) or np.any(x + radius > upper):
                x = body.points @ R + p
                yield body.name, x.min(axis=1), x.max(axis=1)

    def bounds(self, low: Array, high: Array) -> tuple[Array, Array]:
        """The workspace for a body in a motion: where it is slightly outside at the start, it may stay as far outside.

        Args:
            low: Least x, y and z of the body's points at the start, (3,) [m], `base`.
            high: Greatest ones, (3,) [m].

        Returns:
            Lower and upper corner, (3,) each [m].
        """
        lower, upper = self.workspace
        return (
            np.minimum(lower, np.maximum(low - ROUNDING, lower - REESTIMATED)),
            np.maximum(upper, np.minimum(high + ROUNDING, upper + REESTIMATED)),
        )

    def inside(self, q: Array, q_start: Array | None = None) -> bool:
        """Whether flange, hand and tool are within the workspace over a batch of configurations.

        Args:
            q: Joint positions of the arm, (N, 6) [rad].
            q_start: Where the motion starts, (6,) [rad]: hand and tool have the `bounds` of there; None for the
                workspace itself.
        """
        lower, upper = self.workspace
        flange = self.robot.arm.fk(q)[:, :3, 3]
        if np.any(flange < lower) or np.any(flange > upper):
            return False
        for _, low, high in self.extremes(q if q_start is None else np.vstack([q_start, q])):
            if q_start is not None:
                lower, upper = self.bounds(low[0], high[0])
            if np.any(low < lower) or np.any(high > upper):
                return False
        return True

    def _bounds(self, R: Array, p: Array) -> Array:
        """Lower bounds of the distances of all pairs, (N, pairs) [m]."""
        turns, origins = R.take(self._sphere_joint, axis=1), p.take(self._sphere_joint, axis=1)
        c = np.einsum("nsij,sj->nsi", turns, self._spheres[:, :3]) + origins
        apart = c.take(self._first, axis=1) - c.take(self._second, axis=1)
        gap = np.sqrt(np.einsum("nsi,nsi->ns", apart, apart)) - self._radii
        bound = np.minimum.reduceat(gap, self._starts, axis=1)
        for X, half, rows in self._boxes:
            outside = np.maximum(np.abs((c - X[:3, 3]) @ X[:3, :3]) - half, 0.0)
            exact = np.sqrt(np.einsum("nsi,nsi->ns", outside, outside)) - self._spheres[:, 3]
            nearest = np.minimum.reduceat(exact, self._first_sphere, axis=1)
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

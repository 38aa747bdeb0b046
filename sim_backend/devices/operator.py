"""The simulated person: hands the tool over, releases it, steps back."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, transform
from toolee_robot.hal import wait_until_clear
from toolee_robot.sim_backend.options import InHandOffset
from toolee_robot.sim_backend.physics.bodies import fixed_box, pb, set_body_pose
from toolee_robot.sim_backend.world import SimClock, SimWorld

HOLDING_FORCE = 60.0  # [N] largest force with which the person holds the tool
APPROACH = 0.25  # [m] distance from which the tool is moved into the open hand
APPROACH_TIME = 1.0  # [s] duration of that motion
STEP_BACK = 1.2  # [m] that the person steps back
STEP_TIME = 0.5  # [s] duration of a step
GAP = 0.0005  # [m] clearance between tool and hand when it is placed
TICK = 0.02  # [s]
ELSEWHERE = (0.0, 0.02, -0.02, 0.04, -0.04)
"""Shifts along the handle with which the person hands the tool over, until the hand holds it [m]."""
TURNED = (1.0, 0.75, 0.5, 0.25, 0.0)
"""Shares of the in-hand offset's tilt with which the person tries to place the tool."""
ASIDE = (0.0, 0.006, 0.012)
"""Shifts towards the fingertips, away from a thumb before the palm, with which they try then [m]."""
IN_PALM, LARGEST_OUT = 0.02, 0.05
"""Distances along the palm's normal [m]: below the first a person is content; the second is the largest tried."""
SAMPLES = 26
"""Of the tool's way into the hand: 10 mm apart, less than a finger is thick."""


def _directions() -> Array:
    """Directions about the palm's normal, nearest to it first, (n, 3) in the hand's axes."""
    away = [(0.0, 0.0), *((tilt, turn) for tilt in range(15, 90, 15) for turn in range(0, 360, 45))]
    tilt, turn = np.deg2rad(away).T
    return np.stack([np.sin(tilt) * np.cos(turn), -np.cos(tilt), np.sin(tilt) * np.sin(turn)], axis=1)


_DIRECTIONS = _directions()


def handed_over(X_hand_nominal: Array, offset: InHandOffset) -> Array:
    """Apply an in-hand offset to the nominal grasp.

    Args:
        X_hand_nominal: Nominal pose of the tool in the hand, 4x4.
        offset: In-hand offset.

    Returns:
        X_hand_tool, 4x4.
    """
    R = Rotation.from_euler("ZYX", [offset.spin, offset.tilt_y, offset.tilt_x])
    return X_hand_nominal @ transform(R, [0.0, 0.0, offset.along])


class SimPerson:
    """A `hal.Person` who answers promptly.

    Args:
        world: The simulated world.
        offset: In-hand offset with which the tool is handed over.
        comes: Whether the person hands a tool over at all.

    Attributes:
        body: pybullet's id of the person's body.
        center: Middle of the body, (3,) in `base` [m].
        visible_arm: Shoulder and hand, (3,) each in `base` [m], while the person holds the tool, else None.
        confirms: Whether the person confirms a swing.
        holds_switch: Whether the person takes the hold-to-run switch when asked to.
        stays: Whether the person stays within reach when asked to step back.
        lingers: Time that passes before the person steps back [s].
        intended_X_hand_tool: Pose at which the person places the tool in the open hand, 4x4; ground truth.
    """

    def __init__(self, world: SimWorld, offset: InHandOffset, comes: bool) -> None:
        self._world = world
        self._offset = offset
        self._comes = comes
        scene = world.config.scene
        self._place = np.array(scene.person_center)
        away = np.array([self._place[0], self._place[1], 0.0])
        self._back = self._place + STEP_BACK * away / np.linalg.norm(away)
        self.body = fixed_box(world.client, scene.person_size, self._place, (0.25, 0.3, 0.45))
        self.center = self._place.copy()
        self.visible_arm: tuple[Array, Array] | None = None
        self.confirms, self.holds_switch, self.stays, self.lingers = True, True, False, 0.0
        self._clock = SimClock(world)
        self._switch_taken, self._asked = False, 0
        self._constraint: int | None = None
        tool = world.tool.tool
        self._X_hand_nominal = world.robot.robot.hand.grasp.X_hand_tool(tool.handle.grip_radius)
        self.intended_X_hand_tool = handed_over(self._X_hand_nominal, offset)
        self._grasp(world.X_base_tool())

    def request_handover(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """Place the tool into the open hand at the palm's current pose; asked again, at another place of the handle.

        Args:
            prompt: Ignored.
            timeout: Longest duration [s].

        Returns:
            Whether the tool was handed over.
        """
        self._switch_taken = False  # both hands bring the tool
        if not self._comes or timeout < APPROACH_TIME:
            self._world.advance(timeout)
            return False
        along = self._offset.along + ELSEWHERE[self._asked % len(ELSEWHERE)]
        self._asked += 1
        X_base_tool = self._world.X_base_hand() @ self._clear_of_hand(replace(self._offset, along=along))
        way = self._way_out(X_base_tool)
        self._let_go()
        start = transform(p=APPROACH * way) @ X_base_tool
        self._world.tool.place(start)
        self._grasp(start)
        steps = round(APPROACH_TIME / TICK)
        for k in range(1, steps + 1):
            s = 1 - k / steps
            self._hold(transform(p=APPROACH * s**2 * (3 - 2 * s) * way) @ X_base_tool)
            self._world.advance(TICK)
        return True

    def release(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """See `hal.Person`."""
        if self.stays or timeout < self.lingers + STEP_TIME:
            self._world.advance(timeout)
            return False
        end, self._asked = self._clock.now() + timeout, 0
        self._let_go()
        self.visible_arm = None
        self._world.advance(self.lingers)
        self._walk(self._back)
        return wait_until_clear(self.zone_occupied, self._clock, end - self._clock.now())

    def step_in(self) -> None:
        """Appear at the arm at once: a violation while it swings."""
        self._stand(self._place)

    def take_tool(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """See `hal.Person`: come to the arm and hold the tool in the hand."""
        if self.stays or timeout < STEP_TIME:
            self._world.advance(timeout)
            return False
        self._walk(self._place)
        self._let_go()
        self._grasp(self._world.X_base_tool())
        return True

    def confirm_swing(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """See `hal.Person`."""
        return self.confirms

    def confirm_inspection(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """See `hal.Person`."""
        return self.confirms

    def hold_switch(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """See `hal.Person`: the switch is released for a tick, then held until the hands are needed."""
        self._switch_taken = False
        self._world.advance(TICK)
        self._switch_taken = self.holds_switch
        return self.hold_to_run_held()

    def zone_occupied(self) -> bool:
        """Whether the person is nearer than half a step to their place at the arm."""
        return bool(np.linalg.norm(self.center - self._place) < 0.5 * STEP_BACK)

    def readings_certain(self) -> bool:
        """See `hal.Person`."""
        return True

    def hold_to_run_held(self) -> bool:
        """Whether the person holds the hold-to-run switch."""
        return self.holds_switch and self._switch_taken

    def _walk(self, to: Array) -> None:
        start, steps = self.center.copy(), round(STEP_TIME / TICK)
        for k in range(1, steps + 1):
            self._stand(start + k / steps * (to - start))
            self._world.advance(TICK)

    def _stand(self, center: Array) -> None:
        self.center = center.copy()
        set_body_pose(self._world.client, self.body, transform(p=self.center))

    def _clear_of_hand(self, offset: InHandOffset) -> Array:
        """X_hand_tool with an in-hand offset, moved along the palm's normal until hand and tool do not overlap.

        Where they overlap all the same, a finger stands across the handle: the person turns the tool less, and then
        lays it nearer to the fingertips. A mount's clamp lies around the handle: there it is the intended one.
        """
        world, X = self._world, handed_over(self._X_hand_nominal, offset)
        if world.robot.robot.hand.clamps:
            return X
        kept, best, least = world.X_base_tool(), X, np.inf
        for aside, share in product(ASIDE, TURNED):
            turned = replace(offset, tilt_x=share * offset.tilt_x, tilt_y=share * offset.tilt_y)
            X = handed_over(self._X_hand_nominal, turned)
            X[2, 3] += aside
            for out in np.arange(0.0, LARGEST_OUT, 0.0005):
                if self._room(world.X_base_hand() @ X) >= GAP:
                    best, least = (X, out) if out < least else (best, least)
                    break
                X[1, 3] -= 0.0005
            if least < IN_PALM:
                break
        world.tool.place(kept)
        return best

    def _way_out(self, X_base_tool: Array) -> Array:
        """The direction, (3,) in `base`, from which the tool comes to its place.

        It is the palm's normal, or the nearest one to it on which no finger stands in the way. A mount's clamp lies
        around the handle, whatever the direction.
        """
        world = self._world
        X_base_hand, kept = world.X_base_hand(), world.X_base_tool()
        best, most = -X_base_hand[:3, 1], -np.inf
        if world.robot.robot.hand.clamps:
            return best
        for direction in _DIRECTIONS @ X_base_hand[:3, :3].T:
            way = (transform(p=distance * direction) for distance in np.linspace(0.0, APPROACH, SAMPLES))
            room = min(self._room(X @ X_base_tool) for X in way)
            if room > most:
                best, most = direction, room
            if room >= GAP:
                break
        world.tool.place(kept)
        return best

    def _room(self, X_base_tool: Array) -> float:
        """Place the tool; return its distance from arm and hand [m], GAP at most."""
        world = self._world
        world.tool.place(X_base_tool)
        near = pb.getClosestPoints(world.robot.body, world.tool.body, GAP, physicsClientId=world.client)
        return min([GAP, *(point[8] for point in near)])

    def _grasp(self, X_base_tool: Array) -> None:
        world = self._world
        X = X_base_tool @ world.tool.X_tool_inertial
        q = Rotation.from_matrix(X[:3, :3]).as_quat().tolist()
        self._constraint = int(
            pb.createConstraint(
                world.tool.body, -1, -1, -1, pb.JOINT_FIXED, [0, 0, 0], [0, 0, 0], X[:3, 3].tolist(),
                childFrameOrientation=q, physicsClientId=world.client,
            )
        )  # fmt: skip
        self._hold(X_base_tool)

    def _hold(self, X_base_tool: Array) -> None:
        world = self._world
        X = X_base_tool @ world.tool.X_tool_inertial
        q = Rotation.from_matrix(X[:3, :3]).as_quat().tolist()
        pb.changeConstraint(
            self._constraint, X[:3, 3].tolist(), q, maxForce=HOLDING_FORCE, physicsClientId=world.client
        )
        head = X_base_tool @ transform(p=[0.0, 0.0, world.tool.tool.handle.z_max])
        shoulder = self.center + np.array([0.0, 0.0, 0.45])
        self.visible_arm = (shoulder, head[:3, 3])

    def _let_go(self) -> None:
        if self._constraint is not None:
            pb.removeConstraint(self._constraint, physicsClientId=self._world.client)
            self._constraint = None

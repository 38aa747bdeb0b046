"""The simulated person: brings the tool, holds it in the open hand, lets go, steps back."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from toolee_robot.frames import Array, transform
from toolee_robot.sim_backend.options import InHandOffset
from toolee_robot.sim_backend.physics.bodies import fixed_box, set_body_pose
from toolee_robot.sim_backend.physics.bullet import pb
from toolee_robot.sim_backend.world import SimWorld

HOLDING_FORCE = 60.0  # [N] with which the person holds the tool against pushes
APPROACH = 0.25  # [m] from which the tool comes into the open hand
APPROACH_TIME = 1.0  # [s]
STEP_BACK = 1.2  # [m]
STEP_TIME = 0.5  # [s]
GAP = 0.0005  # [m] between tool and hand when it is laid in
TICK = 0.02  # [s]


def handed_over(X_hand_nominal: Array, offset: InHandOffset) -> Array:
    """X_hand_tool of a tool held out with an offset from its nominal pose."""
    R = Rotation.from_euler("ZYX", [offset.spin, offset.tilt_y, offset.tilt_x])
    return X_hand_nominal @ transform(R, [0.0, 0.0, offset.along])


class SimPerson:
    """A `hal.Person` who is always prompt. comes: whether they have a tool to give.

    visible_arm: elbow and hand (3,) in `base` while the person holds the tool, else None. confirms, attends: whether
    they confirm a swing, and hold the enabling switch; stays: whether they stay in reach when asked to step back.
    intended_X_hand_tool: where they mean to put the tool in the hand, before the hand closes: ground truth.
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
        self.confirms, self.attends, self.stays = True, True, False
        self._constraint: int | None = None
        tool = world.tool.tool
        X_nominal = world.robot.robot.hand.grasp.X_hand_tool(tool.handle.grip_radius)
        self.intended_X_hand_tool = handed_over(X_nominal, offset)
        self._grasp(world.X_base_tool())

    def request_handover(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002  (knows what to do)
        """Lay the tool into the open hand, where the palm is now."""
        if not self._comes or timeout < APPROACH_TIME:
            self._world.advance(timeout)
            return False
        X_base_tool = self._world.X_base_hand() @ self._clear_of_hand()
        palmar = -self._world.X_base_hand()[:3, 1]
        self._let_go()
        start = transform(p=APPROACH * palmar) @ X_base_tool
        self._world.tool.place(start)
        self._grasp(start)
        steps = round(APPROACH_TIME / TICK)
        for k in range(1, steps + 1):
            s = 1 - k / steps
            self._hold(transform(p=APPROACH * s**2 * (3 - 2 * s) * palmar) @ X_base_tool)
            self._world.advance(TICK)
        return True

    def release(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """Let go and step back."""
        if self.stays or timeout < STEP_TIME:
            self._world.advance(timeout)
            return False
        self._let_go()
        self.visible_arm = None
        self._walk(self._back)
        return True

    def step_in(self) -> None:
        """Come back to the arm, from one moment to the next: what nobody may do while it swings."""
        self._stand(self._place)

    def take_tool(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        """Come to the arm and take hold of the tool where the hand has it."""
        if self.stays or timeout < STEP_TIME:
            self._world.advance(timeout)
            return False
        self._walk(self._place)
        self._let_go()
        self._grasp(self._world.X_base_tool())
        return True

    def confirm_swing(self, prompt: str, timeout: float) -> bool:  # noqa: ARG002
        return self.confirms

    def inside(self) -> bool:
        """Whether they stand nearer than half a step back from their place at the arm."""
        return bool(np.linalg.norm(self.center - self._place) < 0.5 * STEP_BACK)

    def attending(self) -> bool:
        return self.attends

    def _walk(self, to: Array) -> None:
        start, steps = self.center.copy(), round(STEP_TIME / TICK)
        for k in range(1, steps + 1):
            self._stand(start + k / steps * (to - start))
            self._world.advance(TICK)

    def _stand(self, center: Array) -> None:
        self.center = center.copy()
        set_body_pose(self._world.client, self.body, transform(p=self.center))

    def _clear_of_hand(self) -> Array:
        """X_hand_tool moved out of the palm, along its normal, until nothing of the hand overlaps the tool."""
        world = self._world
        X = self.intended_X_hand_tool.copy()
        kept = world.X_base_tool()
        for _ in range(100):
            world.tool.place(world.X_base_hand() @ X)
            near = pb.getClosestPoints(world.robot.body, world.tool.body, GAP, physicsClientId=world.client)
            if not near:
                break
            X[1, 3] -= 0.0005
        world.tool.place(kept)
        return X

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

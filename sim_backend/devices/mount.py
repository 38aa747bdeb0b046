"""The simulated tool mount: a clamp that a person closes around the handle and opens again."""

from __future__ import annotations

from typing import Self

import numpy as np

from toolee_robot.errors import DeviceError
from toolee_robot.frames import inverse
from toolee_robot.hal import HandState
from toolee_robot.sim_backend.physics.grip import AssistedGrip, GripLimits
from toolee_robot.sim_backend.world import NORMAL, SimWorld
from toolee_robot.types import JointState


class SimMount:
    """A `hal.Hand` that is a tool mount: what a person has fixed in it stays where it was fixed.

    Like a real one it measures nothing: its hinge is reported at rest, also while it yields, and it holds what it was
    last told that it holds.

    Args:
        world: The simulated world, with a tool mount on the flange.
    """

    def __init__(self, world: SimWorld) -> None:
        self._world = world
        self._robot = world.robot.robot
        self._open_device = True
        # The clamp lies around the handle, which touches nothing else of the arm.
        world.robot.ignore_collisions(world.tool.body)

    def __enter__(self) -> Self:
        self._open_device = True
        return self

    def __exit__(self, *_: object) -> None:
        self._open_device = False

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The name of the hinge."""
        return self._robot.hand_joints

    def state(self, max_age: float = 0.1) -> HandState:  # noqa: ARG002
        """The state as far as it is known.

        Args:
            max_age: Ignored: nothing is measured.

        Returns:
            The hinge at rest, and whether a person was last said to have fixed a tool.

        Raises:
            DeviceError: The mount is closed.
        """
        self._check_open()
        rest = self._robot.hand_open
        return HandState(JointState(rest, np.zeros_like(rest), self._world.time), {}, self._world.grip is not None)

    def open(self, timeout: float = 5.0) -> None:  # noqa: ARG002
        """Let the person who holds the tool take it out.

        Args:
            timeout: Ignored.

        Raises:
            DeviceError: The mount is closed.
        """
        self._check_open()
        if self._world.grip is not None:
            self._world.grip.release()
            self._world.grip = None

    def close(self, timeout: float = 5.0) -> None:  # noqa: ARG002
        """Fix the tool where the person holds it.

        Args:
            timeout: Ignored.

        Raises:
            DeviceError: The mount is closed.
        """
        self._check_open()
        world = self._world
        if world.grip is not None:
            return
        X_mount_tool = inverse(world.X_base_hand()) @ world.X_base_tool()
        handle = world.tool.tool.handle
        z = float(np.clip(-X_mount_tool[0, 3] / X_mount_tool[0, 2], handle.z_min, handle.z_max))
        world.grip = AssistedGrip(
            world.client,
            world.robot.body,
            world.robot.palm,
            world.tool.body,
            inverse(world.tool.X_tool_inertial),
            X_mount_tool[:3, 3] + z * X_mount_tool[:3, 2],
            GripLimits.clamped(),
            NORMAL.time_step,
        )

    def stop(self) -> None:
        """Do nothing: a mount does not move by itself."""

    def _check_open(self) -> None:
        if not self._open_device:
            raise DeviceError("the mount is closed: use it inside its `with` block", code="device.closed")

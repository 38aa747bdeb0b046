"""The simulated fingers as those of an emulated hand in another process."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from toolee_robot.frames import Array
from toolee_robot.sim_backend.devices.hand import CONTACT_FORCE, LEAD, SimHand


@dataclass(frozen=True)
class Touched:
    """What the simulated fingers feel.

    Attributes:
        fingers: Names of the fingers that touch the tool.
        gripped: Whether the assisted grip holds the tool.
    """

    fingers: tuple[str, ...]
    gripped: bool


class CoupledFingers(SimHand):
    """The simulated hand, moved to where an emulated hand's motors are."""

    def follow(self, q: Array) -> Touched:
        """Let the fingers go on towards the emulated hand's.

        Args:
            q: Positions of the emulated hand's joints, in the order of the model's [rad].

        Returns:
            What they feel now.
        """
        if not self.gripped:  # a grip carries the load through the palm, and the fingers keep their places
            now = self._world.robot.hand_state()[0]
            self._target = now + np.clip(q - now, -LEAD, LEAD)
            self._world.robot.command_hand(self._target)
        forces, _ = self._contact_forces()
        touching = (name for name, force in forces.items() if force > CONTACT_FORCE)
        return Touched(tuple(touching), self.gripped)

    def grip(self) -> bool:
        """Begin the assisted grip, if thumb and fingers hold the tool by real contact; takes some time.

        Returns:
            Whether it holds.
        """
        self._hold()
        return self.gripped

    def let_go(self) -> None:
        """End the assisted grip."""
        if self._world.grip is not None:
            self._world.grip.release()
        self._holding_forces = None

"""A tool mount as a hand: it has no sensor and no motor, a person opens and closes it."""

from __future__ import annotations

from typing import Self

import numpy as np

from toolee_robot.hal import Clock, HandState
from toolee_robot.robots import HandModel
from toolee_robot.types import JointState


class MountedTool:
    """A `hal.Hand` that is a tool mount.

    Its state is what a person said last, never a measurement: `holding` from `close` to `open`, the hinge at rest. It
    cannot tell that a tool came loose. The looks at the tool, the touches, and strikes that miss do.

    Args:
        model: The mount: `hand_model(config.hand)`.
        clock: Clock of the station.
    """

    def __init__(self, model: HandModel, clock: Clock) -> None:
        self._model, self._clock = model, clock
        self._rest = model.posture("open")
        self._holding = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is held by power: the tool stays where it is."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The name of the hinge."""
        return self._model.joints

    def state(self, max_age: float = 0.1) -> HandState:  # noqa: ARG002
        """The state as far as it is known.

        Args:
            max_age: Ignored: nothing is measured.

        Returns:
            The hinge at rest, no forces, and whether a tool is in the mount as a person said last.
        """
        return HandState(JointState(self._rest, np.zeros_like(self._rest), self._clock.now()), {}, self._holding)

    def open(self, timeout: float = 5.0) -> None:  # noqa: ARG002
        """Note that a person has taken the tool out.

        Args:
            timeout: Ignored.
        """
        self._holding = False

    def close(self, timeout: float = 5.0) -> None:  # noqa: ARG002
        """Note that a person has fixed a tool.

        Args:
            timeout: Ignored.
        """
        self._holding = True

    def stop(self) -> None:
        """Do nothing: a mount does not move by itself."""

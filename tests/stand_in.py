"""The controller stand-in as tests want it: at home, and first in line for a busy machine's time, as a robot's own
controller is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Final

import numpy as np

from toolee_robot.sim_backend.ur_controller.joint_plant import JointPlant
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.types import ArmModel

HOME = np.array([-0.6, -1.7, 1.6, -1.47, -1.57, 0.0])
PACE: Final = {ArmModel.UR10: 1.0, ArmModel.UR10E: 0.25}
"""A cycle takes 8 ms of the wall's clock for both: a machine that is busy with other things then keeps a real robot's
bounds, the one on late data too."""


@contextmanager
def stand_in(model: ArmModel, host: str, pace: float = 1.0) -> Iterator[ControllerProcess]:
    with ControllerProcess(
        model=model.value, host=host, plant=partial(JointPlant, q=HOME), realtime=True, pace=pace
    ) as controller:
        yield controller

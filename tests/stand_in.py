"""The controller stand-in as tests want it: at home, and first in line for a busy machine's time, as a robot's own
controller is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np

from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.frames import Array
from toolee_robot.hal import Arm, MotionWatch
from toolee_robot.sim_backend.ur_controller.process import ControllerProcess
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.sim_backend.ur_controller.robot.plant import JointPlant
from toolee_robot.station import ServoConfig
from toolee_robot.types import ArmModel

HOME = np.array([-0.6, -1.7, 1.6, -1.47, -1.57, 0.0])
# For a machine that is busy with other things: nothing but what a test brings about may stop a motion.
PATIENT = MotionWatch(tracking_error=0.5, data_cycles=100.0, overruns=100)


SERVO = ServoConfig(
    lag=0.05, watchdog=5.0, connect_timeout=15.0, handshake_timeout=5.0, hang_timeout=1.0, heartbeat_timeout=1.0
)
"""Of the ideal stand-in, which lags by a cycle and the network."""


def patient(host: str) -> UrArmConfig:
    """For a machine that is busy with other things; `benchmarks.servo` says what the driver can do on an idle one."""
    return UrArmConfig(host, SERVO)


def held(arm: Arm) -> Array:
    """(6,) [rad] where the arm's next motion starts, however old its newest state is."""
    return arm.state(np.inf).q_commanded


@contextmanager
def stand_in(
    model: ArmModel, host: str, real_time_factor: float = 1.0, profile: ProfileName = "ideal"
) -> Iterator[ControllerProcess]:
    with ControllerProcess(
        model=model.value,
        host=host,
        plant=partial(JointPlant, q=HOME),
        realtime=True,
        real_time_factor=real_time_factor,
        profile=profile,
    ) as controller:
        yield controller

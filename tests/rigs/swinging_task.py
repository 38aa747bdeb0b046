"""A task in a process of its own, for faults that kill or stall the process.

    python -m tests.rigs.swinging_task HOST MODEL PROFILE

It prints "ready" at the start of the swing, swings when it reads a line from standard input, and prints the outcome.
"""

from __future__ import annotations

import signal
import sys

from tests.rigs.setting import Setting
from tests.rigs.strikes import plan_swing
from tests.rigs.time_bounds import PATIENT
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.errors import DeviceError
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.types import ArmModel


def main() -> None:
    """Connect the arm, wait for the line, swing."""
    # A process that a shell started in the background inherits that Ctrl-C is ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    profile: ProfileName = "harsh" if sys.argv[3] == "harsh" else "ideal"
    setting = Setting(ArmModel(sys.argv[2]), sys.argv[1], profile)
    swing = plan_swing(setting.model)
    with UnsupervisedUrArm(UrArmConfig(setting.host, setting.servo), swing.config.arm) as arm:
        print("ready", flush=True)
        sys.stdin.readline()
        try:
            print(arm.execute(swing.plan.strike, None, PATIENT).outcome, flush=True)
        except DeviceError as error:
            print(type(error).__name__, flush=True)


if __name__ == "__main__":
    main()

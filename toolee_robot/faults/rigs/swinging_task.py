"""A task in a process of its own, for faults that kill or stall the process.

    python -m toolee_robot.faults.rigs.swinging_task HOST MODEL

It prints "ready" at the start of the swing, swings when it reads a line from standard input, and prints the outcome.
"""

from __future__ import annotations

import sys

from toolee_robot.errors import DeviceError
from toolee_robot.faults.rigs.strikes import plan_swing
from toolee_robot.faults.rigs.time_bounds import PATIENT, SERVO
from toolee_robot.hardware.ur.config import UrArmConfig
from toolee_robot.hardware.ur.driver import UnsupervisedUrArm
from toolee_robot.types import ArmModel


def main() -> None:
    """Connect the arm, wait for the line, swing."""
    host, model = sys.argv[1], ArmModel(sys.argv[2])
    swing = plan_swing(model)
    with UnsupervisedUrArm(UrArmConfig(host, SERVO), swing.config.arm) as arm:
        print("ready", flush=True)
        sys.stdin.readline()
        try:
            print(arm.execute(swing.plan.strike, None, PATIENT).outcome, flush=True)
        except DeviceError as error:
            print(type(error).__name__, flush=True)


if __name__ == "__main__":
    main()

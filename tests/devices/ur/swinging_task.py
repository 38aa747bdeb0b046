"""A task of its own process that swings the arm until something happens to it: `python -m
tests.devices.ur.swinging_task HOST MODEL`. Says "swinging" and the id of the servo process when
the arm is under way, and how it ended."""

from __future__ import annotations

import sys
import threading
from dataclasses import replace

from tests.devices.ur.swings import LONG, swing, wait_for_mid_swing
from tests.stand_in import PATIENT, held, patient
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.errors import DeviceError
from toolee_robot.station import sim_station
from toolee_robot.types import ArmModel


def main() -> None:
    host, model = sys.argv[1], ArmModel(sys.argv[2])
    with UnsupervisedUrArm(patient(host), replace(sim_station().arm, model=model)) as arm:
        trajectory = swing(held(arm), LONG)

        def say() -> None:
            wait_for_mid_swing(arm, trajectory)
            print("swinging", arm.servo_pid, flush=True)

        threading.Thread(target=say, daemon=True).start()
        try:
            arm.execute(trajectory, None, PATIENT)
            print("completed", flush=True)
        except KeyboardInterrupt:
            print("interrupted", float(abs(arm.state(1.0).joints.qd).max()), flush=True)
            raise
        except DeviceError as error:
            print(type(error).__name__, flush=True)


if __name__ == "__main__":
    main()

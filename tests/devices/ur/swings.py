"""A fast swing, and what the stand-in's joints did after something happened to it."""

from __future__ import annotations

import sys
import threading
import time
from dataclasses import dataclass, replace

import numpy as np

from tests.sim_backend.kinematics import line
from tests.stand_in import HOME, PATIENT, held, patient
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.errors import DeviceError
from toolee_robot.frames import Array
from toolee_robot.sim_backend.ur_controller.faults.fault_port import Trace
from toolee_robot.station import ArmLimits, sim_station
from toolee_robot.types import ArmModel, Trajectory

WAY = np.array([0.9, 0.5, -0.6, 0.3, -0.4, 0.8])
MOVING = 2e-3  # [rad/s]
FAST = 1.2  # [s] from end to end
LONG = 3.0  # [s] of a swing that lasts longer than a task may be silent
SLACK = 0.35  # [s] for a machine that is busy with other things


def swing(q: Array, duration: float | None = None) -> Trajectory:
    """To the further end of the way between HOME and HOME + WAY, wherever on it the last one has stopped."""
    end = max((HOME, HOME + WAY), key=lambda end: float(np.abs(end - q).max()))
    share = float(np.abs(end - q).max() / np.abs(WAY).max())
    return line([q, end], share * FAST if duration is None else duration)


def shortest_stop(limits: ArmLimits, speed: float) -> float:
    """[s] From a joint's speed [rad/s] at constant velocity, with the limits' jerk and deceleration."""
    a, j = float(limits.stop_acceleration.max()), limits.stop_jerk
    return speed / a + a / j if speed * j >= a * a else 2.0 * float(np.sqrt(speed / j))


def wait_for_mid_swing(arm: UnsupervisedUrArm, trajectory: Trajectory) -> None:
    """Until the arm is 30 to 50 % on its way."""
    way = trajectory.q[-1] - trajectory.q[0]
    deadline = time.monotonic() + 10.0
    while (arm.state(5.0).joints.q - trajectory.q[0]) @ way / (way @ way) < 0.3:
        assert time.monotonic() < deadline, "the arm does not swing"
        time.sleep(0.002)


@dataclass(frozen=True)
class Stop:
    """Speed of the fastest joint at the fault [rad/s], time to standstill [s], motion and deviation after it [rad]."""

    speed: float
    time: float
    overshoot: float
    off_path: float


def stop_after(trace: Trace, trajectory: Trajectory, event: float) -> Stop:
    """What the joints did from the time `event` [s] on; asserts that they stand at the trace's end."""
    i = int(np.searchsorted(trace.stamps, event))
    assert 0 < i < len(trace.stamps) - 1, "the trace does not cover the event"
    qd = np.abs(trace.qd).max(axis=1)
    moving = np.flatnonzero(qd > MOVING)
    last = int(moving[-1]) if len(moving) else 0
    assert last < len(qd) - 10, "the arm still moves"
    way = trajectory.q[-1] - trajectory.q[0]
    since = trace.q[i:] - trajectory.q[0]
    share = since @ way / (way @ way)
    return Stop(
        speed=float(qd[i - 1]),
        time=max(float(trace.stamps[last] - event), 0.0),
        overshoot=float(np.abs(trace.q[i:] - trace.q[i - 1]).max()),
        off_path=float(np.abs(since - share[:, None] * way).max()),
    )


def braked(stop: Stop, limits: ArmLimits, extra: float = 0.0, *, timed: bool = True) -> None:
    """On the path, and if timed as soon as the joints' limits allow, the servo's lag and `extra` [s] besides."""
    assert not timed or stop.time < shortest_stop(limits, stop.speed) + extra + SLACK
    # Where each joint stopped for itself they would be some 0.05 rad apart.
    assert stop.off_path < 0.01


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

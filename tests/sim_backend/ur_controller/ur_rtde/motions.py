"""Loops that run in ur_rtde's process (imports nothing but the standard library, so that it starts quickly)."""

from __future__ import annotations

import time
from math import pi, sin
from typing import Any


def servo_sine(interfaces: dict[str, Any], duration: float, amplitude: float, period: float) -> bool:
    """The base joint there and back, on an absolute schedule; whether every call was accepted."""
    control, receive = interfaces["control"], interfaces["receive"]
    start = receive.getActualQ()
    begin, done = time.monotonic(), True
    for i in range(1, round(duration / period) + 1):
        q = [start[0] + amplitude * sin(pi * i * period / duration) ** 2, *start[1:]]
        done &= control.servoJ(q, 0.0, 0.0, period, 0.05, 500)
        time.sleep(max(0.0, begin + i * period - time.monotonic()))
    time.sleep(0.2)
    control.servoStop(10.0)
    return bool(done)


def servo_up(interfaces: dict[str, Any], duration: float, height: float, period: float) -> None:
    """Straight up, on an absolute schedule."""
    control, receive = interfaces["control"], interfaces["receive"]
    pose = receive.getActualTCPPose()
    begin = time.monotonic()
    for i in range(1, round(duration / period) + 1):
        goal = list(pose)
        goal[2] += height * i * period / duration
        control.servoL(goal, 0.0, 0.0, period, 0.05, 500)
        time.sleep(max(0.0, begin + i * period - time.monotonic()))
    time.sleep(0.3)
    control.servoStop(10.0)


def speed_with_kicks(interfaces: dict[str, Any], duration: float) -> bool:
    """A joint at a constant speed, kicked for a while and then left alone."""
    control = interfaces["control"]
    begin = time.monotonic()
    while time.monotonic() < begin + duration:
        control.speedJ([0.0, 0.0, 0.0, 0.0, 0.0, 0.5], 5.0, 0.0)
        control.kickWatchdog()
        time.sleep(0.02)
    return True

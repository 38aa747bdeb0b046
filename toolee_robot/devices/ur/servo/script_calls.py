"""The calls that the control script acknowledges: TCP, payload, zero of the force reading, freedrive.

What a call sets is read back from the robot's state, since ur_rtde's return values say little. Each call feeds the
watchdog and publishes the state while it waits, and ends in a bounded time.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Final

import numpy as np

from toolee_robot.arm_data import CB3_RATE
from toolee_robot.control.motion.touch_force import check_offset
from toolee_robot.control.motion.trajectory_checks import START_TOLERANCE
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.servo.rtde_link import AT_REST, UrLink, bounded
from toolee_robot.devices.ur.servo.shared_memory import StateColumn
from toolee_robot.errors import DeviceError, NotReadyError
from toolee_robot.frames import Array
from toolee_robot.hal import ZERO_TIME, ArmStatus

PAYLOAD_TOLERANCE: Final = 1e-3
"""[kg], [m] Largest difference between the payload set and the payload reported by the controller."""
TCP_TOLERANCE: Final = 1e-5
"""[m], [rad] Largest difference between the TCP set and the TCP reported by the controller."""
ZEROED: Final = 5.0
"""[N] Largest mean force after the controller has zeroed its sensor; the precision that a UR10e is said to have."""
_HELD_READINGS = 5  # consecutive readings with one set-point, after which the arm counts as held


class ScriptCalls:
    """The calls of one connection, made at rest.

    Args:
        link: Connection to the robot.
        config: The driver's settings.
        publish: Called in every cycle of a wait, with the new state in the link.
    """

    def __init__(self, link: UrLink, config: UrArmConfig, publish: Callable[[], None]) -> None:
        self._link, self._publish, self._clock = link, publish, config.clock
        self._timeout = config.servo.handshake_timeout

    def set_tcp(self) -> None:
        """Set the TCP to the flange, at which wrenches are then reported, and wait until the controller reports it.

        Raises:
            DeviceError: The robot's program does not run, or the controller reports another TCP.
        """
        with self._bounded():
            self._accepted(self._link.control.setTcp([0.0] * 6), "the TCP")

        def reported() -> Array | None:
            return self._link.newest.tcp

        if (other := self._await(reported, np.zeros(6), TCP_TOLERANCE)) is not None:
            raise DeviceError(
                f"the TCP was set to the flange, but the robot reports {np.round(other, 4)}: find the program or "
                "installation that changes it",
                code="device.tcp_mismatch",
            )

    def set_payload(self, mass: float, center_of_mass: list[float]) -> None:
        """Set the payload and wait until the controller reports it, if its version does.

        Args:
            mass: Mass [kg].
            center_of_mass: x, y, z [m] in the flange frame.

        Raises:
            DeviceError: The robot's program does not run, or the controller reports another payload.
        """
        with self._bounded():
            self._accepted(self._link.control.setPayload(mass, center_of_mass), "the payload")

        def reported() -> Array | None:
            payload = self._link.newest.payload
            return None if payload is None else np.array(payload)

        if (other := self._await(reported, np.array([mass, *center_of_mass]), PAYLOAD_TOLERANCE)) is not None:
            raise DeviceError(
                f"the payload was set to {mass:.3f} kg at {np.round(center_of_mass, 3)} m, but the robot reports "
                f"{other[0]:.3f} kg at {np.round(other[1:], 3)} m",
                code="device.payload_mismatch",
            )

    def zero_wrench(self) -> None:
        """Zero the force reading of an arm that stands and touches nothing.

        An e-Series controller zeroes its sensor, which is then looked at; a CB3, which estimates the force from the
        joints' currents, cannot. What the reading is on average over ZERO_TIME is then subtracted from all readings
        to come, also from those that a contact guard sees. A CB3's offset changes with the pose: its zero is good near
        the pose at which it was taken.

        Raises:
            NotReadyError: The arm moves.
            DeviceError: The force is too large for an offset, the controller did not zero its sensor, or the robot's
                program does not run.
        """
        link = self._link
        self._expect_standstill(link.reading[StateColumn.QD])
        e_series = link.rate > CB3_RATE
        if e_series:
            check_offset(link.reading[StateColumn.WRENCH] + link.wrench_offset)
            with self._bounded():
                self._accepted(link.control.zeroFtSensor(), "the zero of its force sensor")
            link.catch_up()
        link.unread()
        wrenches, end = list[Array](), self._clock.now() + 2.0 * ZERO_TIME
        while len(wrenches) < round(ZERO_TIME * link.rate):
            self._wait_cycle()
            for reading in link.unread():
                self._expect_standstill(reading.qd)
                wrenches.append(reading.wrench + link.wrench_offset)
            if not link.playing or link.status is not ArmStatus.READY or self._clock.now() > end:
                message = "the robot's data or its program stopped while the force was zeroed: reset the arm"
                raise DeviceError(message)
        mean = np.mean(wrenches, axis=0)
        check_offset(mean)
        if e_series and np.linalg.norm(mean[:3]) > ZEROED:
            raise DeviceError(
                f"the controller zeroed its force sensor, but still reports {np.linalg.norm(mean[:3]):.1f} N on "
                "average: does something pull at the tool? Otherwise restart the controller"
            )
        link.wrench_offset = mean
        timestamp = link.newest.timestamp
        while link.newest.timestamp == timestamp and self._clock.now() < end:
            self._wait_cycle()

    def start_freedrive(self) -> None:
        """Enter freedrive.

        Raises:
            DeviceError: The robot's program does not run.
        """
        link = self._link
        with self._bounded():
            if link.servoing:
                link.control.servoStop()
                link.servoing = False
            self._accepted(link.control.teachMode(), "freedrive")

    def end_freedrive(self) -> None:
        """Leave freedrive and wait until the controller holds the arm; an arm that still moves brakes first."""
        link = self._link
        with self._bounded():
            link.control.endTeachMode()
            link.catch_up()
            held = 0
            while held < _HELD_READINGS:
                before = link.reading[StateColumn.COMMANDED].copy()
                if self._wait_cycle():
                    moved = np.abs(link.reading[StateColumn.COMMANDED] - before).max()
                    held = held + 1 if moved <= START_TOLERANCE else 0

    def _bounded(self) -> AbstractContextManager[None]:
        return bounded(self._clock.to_wall_time(self._timeout))

    @staticmethod
    def _accepted(accepted: bool, what: str) -> None:
        if not accepted:
            message = f"the robot did not accept {what}: its program does not run; reset the arm"
            raise DeviceError(message)

    def _wait_cycle(self) -> bool:
        """Feed the watchdog and wait for a cycle. Returns whether there was a new reading."""
        self._link.kick()
        self._clock.sleep(1.0 / self._link.rate)
        new = self._link.read()
        self._link.expect_plausible()
        self._publish()
        return new

    def _await(self, reported: Callable[[], Array | None], wanted: Array, tolerance: float) -> Array | None:
        """Wait until the robot reports what was set; what it reports instead in the end, None if it does or cannot."""
        deadline = self._clock.now() + self._timeout
        while True:
            self._wait_cycle()
            values = reported()
            if values is None or np.abs(values - wanted).max() < tolerance:
                return None
            if self._clock.now() > deadline:
                return values

    @staticmethod
    def _expect_standstill(qd: Array) -> None:
        if (fastest := float(np.abs(qd).max())) > AT_REST:
            message = f"the arm moves ({fastest:.2f} rad/s): the force can be zeroed at standstill only"
            raise NotReadyError(message, code="not_ready.moving")

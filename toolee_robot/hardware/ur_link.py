"""The ur_rtde wheel's two objects, in the servo process, and the stream of forces beside them: nothing else in the
project touches the wheel.

What the wheel returns is not believed: its calls answer True, and its getters give old values, long after the link is
gone. Only the advance of the controller's timestamp says that a reading is new. Calls that shake hands with the control
script can block for minutes, so each runs under a timer whose signal ends this process: nothing here is worth waiting
for, and the robot's watchdog stops the robot.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

from toolee_robot.errors import DeviceError, NotReadyError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmStatus
from toolee_robot.hardware.rtde_reader import RTDE_PORT
from toolee_robot.hardware.servo_memory import StateColumn
from toolee_robot.hardware.ur_config import UrArmConfig
from toolee_robot.hardware.ur_status import RUNTIME_PLAYING, advice, arm_status
from toolee_robot.hardware.wheel_sockets import WheelSockets
from toolee_robot.hardware.wrench_stream import WrenchStream

PAYLOAD_TOLERANCE = 1e-3
"""[kg], [m] Between what was set and what the controller reports."""

_ABSURD = 100.0
"""[rad], [rad/s] No joint of a robot reads so much, nor what is not a number."""

_JOINTS = slice(StateColumn.Q.start, StateColumn.QD.stop)


@contextmanager
def bounded(seconds: float) -> Iterator[None]:
    """End this process, by SIGALRM's own default action, if the body takes longer: no interpreter is needed for it."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


class UrLink:
    """rate [Hz]: the controller's. reading: (StateColumn.COUNT,), the newest; its commanded position is what went out
    last, or, before anything did, where the controller holds the arm. refused: True for good once the wheel did not
    send a position, since it believes that the robot's program has ended, whatever the receiving end says. status,
    playing: what the robot says of its safety and of its program. servoing: the control script's servo thread runs, and
    holds the last position sent."""

    def __init__(self, config: UrArmConfig, rate: float) -> None:
        """Connect; nothing moves. Raises NotReadyError while the robot's safety system or mode forbids motion, and
        DeviceError for what the wheel throws."""
        self._config, self.rate, self._clock = config, rate, config.clock
        self.reading: Array = np.zeros(StateColumn.COUNT)
        self._sane, self.refused, self._lost = True, False, False
        self.status, self.playing, self.servoing = ArmStatus.NOT_READY, False, False
        with bounded(self._clock.wall(config.connect_timeout)):
            try:
                self._receive = RTDEReceiveInterface(config.host)
                self._wrenches = WrenchStream(config.host, rate, self._clock.wall(config.connect_timeout), self._clock)
                while not self.read():
                    self._expect(self.sane)
                    time.sleep(1e-3)
                if self.status is not ArmStatus.READY:
                    raise NotReadyError(advice(self.status))
                self._control = RTDEControlInterface(config.host)
                # Forces are wanted at the flange: whatever tool the pendant has set is taken off.
                self._control.setTcp([0.0] * 6)
                while not self.playing:
                    self.read()
                    self._expect(self.sane)
                    time.sleep(1e-3)
                self._control.setWatchdog(config.watchdog)
                self._take_target()
                self._sockets = WheelSockets(RTDE_PORT)
            except (RuntimeError, ValueError, IndexError, MemoryError) as error:  # whatever C++ may throw
                raise DeviceError(_explain(str(error), config.host)) from error

    @property
    def connected(self) -> bool:
        """Whether all connections are there, the ones of the beginning. True says nothing; False is the truth."""
        return not (self._lost or self._wrenches.lost) and bool(
            self._receive.isConnected() and self._control.isConnected() and self._sockets.same
        )

    @property
    def sane(self) -> bool:
        """False for good once data made no sense; they are never taken in."""
        return self._sane and self._wrenches.sane

    @property
    def age(self) -> float:
        """[s] Of the newest reading, of joints or of force, whichever is older."""
        return self._clock.now() - min(float(self.reading[StateColumn.SEEN]), self._wrenches.seen)

    def unread_wrenches(self) -> list[Array]:
        """All (6,) that have come since this was last asked, the oldest first."""
        return self._wrenches.unread()

    def read(self) -> bool:
        """Take the newest data in; False when nothing new of the joints has come, or nothing that makes sense. Never
        waits."""
        self._wrenches.read()
        self.reading[StateColumn.WRENCH] = self._wrenches.newest
        receive, reading = self._receive, self.reading.copy()
        timestamp = receive.getTimestamp()
        if timestamp == reading[StateColumn.TIMESTAMP]:
            return False
        for _ in range(3):  # until all of it is of one packet
            reading[StateColumn.Q] = receive.getActualQ()
            reading[StateColumn.QD] = receive.getActualQd()
            safety, mode, runtime = receive.getSafetyStatusBits(), receive.getRobotMode(), receive.getRuntimeState()
            before, timestamp = timestamp, receive.getTimestamp()
            if timestamp == before:
                break
        # The controller's clock only goes forward. NaN fails every comparison.
        forward = self.reading[StateColumn.TIMESTAMP] < timestamp < np.inf
        if not (forward and np.all(np.abs(reading[_JOINTS]) < _ABSURD)):
            self._sane = False
            return False
        reading[:5] = self._clock.now(), timestamp, safety, mode, runtime
        self.reading[:] = reading
        self.status = arm_status(safety, mode)
        self.playing = runtime == RUNTIME_PLAYING
        return True

    def servo(self, q: Array) -> None:
        """Send one position (6,) [rad]; feeds the robot's watchdog as well."""
        with self._while_connected():
            sent = self._control.servoJ(
                q.tolist(), 0.0, 0.0, 1.0 / self.rate, self._config.lookahead, self._config.gain
            )
            self.refused = self.refused or not sent
        self.reading[StateColumn.COMMANDED] = q
        self.servoing = True

    def kick(self) -> None:
        """Feed the robot's watchdog. Not in a cycle that has sent a position: of two commands that reach the robot in
        one of its cycles it takes the later. Not without a program: the wheel may wait 3 s for it to get ready."""
        with self._while_connected():
            self._control.kickWatchdog()

    def set_payload(self, mass: float, center_of_mass: list[float]) -> None:
        """[kg], [m] in the flange. Raises DeviceError unless the controller reports it back, where its version can."""
        with bounded(self._clock.wall(self._config.handshake_timeout)):
            accepted = self._control.setPayload(mass, center_of_mass)
        if not accepted:
            raise DeviceError("the robot did not take the payload: its program does not run; reset the arm")
        deadline = self._clock.now() + self._config.handshake_timeout
        while True:
            self.kick()
            self._clock.sleep(1.0 / self.rate)
            reported = self._reported_payload()
            if reported is None or np.abs(np.subtract(reported, [mass, *center_of_mass])).max() < PAYLOAD_TOLERANCE:
                return
            if self._clock.now() > deadline:
                raise DeviceError(
                    f"the payload was set to {mass:.3f} kg at {np.round(center_of_mass, 3)} m, but the robot reports "
                    f"{reported[0]:.3f} kg at {np.round(reported[1:], 3)} m"
                )

    def start_freedrive(self) -> None:
        with bounded(self._clock.wall(self._config.handshake_timeout)):
            if self.servoing:
                self._control.servoStop()
                self.servoing = False
            if not self._control.teachMode():
                raise DeviceError("the robot did not go into freedrive: its program does not run; reset the arm")

    def end_freedrive(self) -> None:
        with bounded(self._clock.wall(self._config.handshake_timeout)):
            self._control.endTeachMode()
        self._take_target()

    def close(self) -> None:
        """End the robot's program, at rest, and the connections; whatever does not end by itself ends the process."""
        with bounded(self._clock.wall(self._config.handshake_timeout)):
            if self.connected and self.playing and self.status is ArmStatus.READY:
                if self.servoing:
                    self._control.servoStop()
                self._control.stopScript()
        # The wheel's own clean-up may hang, reconnect or crash; the kernel's does not.
        os._exit(0)

    @contextmanager
    def _while_connected(self) -> Iterator[None]:
        """A command that finds the connection gone makes the wheel try for another one, which it cannot have."""
        try:
            yield
        except RuntimeError:
            self._lost = True

    def _take_target(self) -> None:
        """Where the controller holds the arm is where the next motion starts."""
        target = np.array(self._receive.getTargetQ())
        self._expect(bool(np.all(np.abs(target) < _ABSURD)))
        self.reading[StateColumn.COMMANDED] = target

    @staticmethod
    def _expect(sane: bool) -> None:
        if not sane:
            raise DeviceError("the robot's data make no sense (joints, forces or time): restart its controller")

    def _reported_payload(self) -> list[float] | None:
        """Mass and centre of gravity, or None from a controller that does not report them."""
        try:
            return [self._receive.getPayload(), *self._receive.getPayloadCog()]
        except RuntimeError:
            return None


def _explain(message: str, host: str) -> str:
    if "in use" in message.lower() or "IN_USE" in message:
        return f"another program controls the robot at {host} over RTDE: end it first ({message})"
    if "remote" in message.lower():
        return f"the robot at {host} is not in remote control: switch it over at the pendant ({message})"
    return f"the robot at {host} refuses the connection: {message}"

"""ur_rtde's control interface, in the servo process, and the stream of the robot's state beside it: nothing
else in the project touches ur_rtde.

What ur_rtde returns is not believed: its calls answer True long after the link is gone. Only the advance of the
controller's timestamp says that a reading is new. Calls that shake hands with the control script can block for minutes,
so each runs under a timer whose signal ends this process: nothing here is worth waiting for, and the robot's watchdog
stops the robot.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from rtde_control import RTDEControlInterface

from toolee_robot.errors import DeviceError, NotReadyError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmStatus
from toolee_robot.hardware.ur.config import UrArmConfig
from toolee_robot.hardware.ur.protocols.rtde import RTDE_PORT
from toolee_robot.hardware.ur.servo.rtde_sockets import UrRtdeSockets
from toolee_robot.hardware.ur.servo.shared_memory import StateColumn
from toolee_robot.hardware.ur.servo.state_stream import StateStream
from toolee_robot.hardware.ur.status import RUNTIME_PLAYING, advice, arm_status
from toolee_robot.motion.trajectory_checks import START_TOLERANCE

PAYLOAD_TOLERANCE = 1e-3
"""[kg], [m] Between what was set and what the controller reports."""

_CATCH_UP = 100  # times, of what has come during a handshake
_HELD = 5  # readings with one set-point


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
    last, or, while nothing is servoed, where the controller holds the arm. refused: True for good once ur_rtde did
    not send a position, since it believes that the robot's program has ended, whatever the receiving end says. status,
    playing: what the robot says of its safety and of its program. servoing: the control script's servo thread runs, and
    holds the last position sent."""

    def __init__(self, config: UrArmConfig, rate: float) -> None:
        """Connect; nothing moves. Raises NotReadyError while the robot's safety system or mode forbids motion, and
        DeviceError for what ur_rtde throws."""
        self._config, self.rate, self._clock = config, rate, config.clock
        self.reading: Array = np.zeros(StateColumn.COUNT)
        self.refused, self._lost = False, False
        self._wrenches: list[Array] = []
        self.status, self.playing, self.servoing = ArmStatus.NOT_READY, False, False
        with bounded(self._clock.to_wall_time(config.connect_timeout)):
            try:
                self._stream = StateStream(
                    config.host, rate, self._clock.to_wall_time(config.connect_timeout), self._clock
                )
                self._show_newest()
                if self.status is not ArmStatus.READY:
                    raise NotReadyError(advice(self.status))
                self._control = RTDEControlInterface(config.host)
                # Forces are wanted at the flange: whatever tool the pendant has set is taken off.
                self._control.setTcp([0.0] * 6)
                while not self.playing:
                    self.read()
                    self._expect_plausible()
                    time.sleep(1e-3)
                self._control.setWatchdog(config.watchdog)
                self._catch_up()
                self._sockets = UrRtdeSockets(RTDE_PORT)
            except (RuntimeError, ValueError, IndexError, MemoryError) as error:  # whatever C++ may throw
                raise DeviceError(_explain(str(error), config.host)) from error

    @property
    def connected(self) -> bool:
        """Whether all connections are there, the ones of the beginning. True says nothing; False is the truth."""
        return not (self._lost or self._stream.lost) and bool(self._control.isConnected() and self._sockets.same)

    @property
    def plausible(self) -> bool:
        """False for good once data made no sense; they are never taken in."""
        return self._stream.plausible

    @property
    def age(self) -> float:
        """[s] Of the newest reading."""
        return self._clock.now() - self._stream.seen

    @property
    def arrived(self) -> float:
        """[s] When the newest reading came in, not when it was taken: by it, the controller's cycle."""
        return self._stream.arrived

    def unread_wrenches(self) -> list[Array]:
        """All (6,) that have come since this was last asked, the oldest first."""
        unread, self._wrenches = self._wrenches, []
        return unread

    def read(self) -> bool:
        """Take in what has come; False when nothing new has, or something that makes no sense. Never waits."""
        readings = self._stream.take()
        if not readings:
            return False
        self._wrenches += [reading.wrench for reading in readings]
        self._show_newest()
        return True

    def _show_newest(self) -> None:
        newest, reading = self._stream.newest, self.reading
        safety, mode, runtime = newest.safety_bits, newest.robot_mode, newest.runtime_state
        reading[:5] = self._stream.seen, newest.timestamp, safety, mode, runtime
        reading[StateColumn.Q], reading[StateColumn.QD] = newest.q, newest.qd
        reading[StateColumn.WRENCH] = newest.wrench
        if not self.servoing:  # a person may move it, and it may still come to rest after a program's end
            reading[StateColumn.COMMANDED] = newest.target
        self.status = arm_status(safety, mode)
        self.playing = runtime == RUNTIME_PLAYING

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
        one of its cycles it takes the later. Not without a program: ur_rtde may wait 3 s for it to get ready."""
        with self._while_connected():
            self._control.kickWatchdog()

    def set_payload(self, mass: float, center_of_mass: list[float]) -> None:
        """[kg], [m] in the flange. Raises DeviceError unless the controller reports it back, where its version can."""
        with bounded(self._clock.to_wall_time(self._config.handshake_timeout)):
            accepted = self._control.setPayload(mass, center_of_mass)
        if not accepted:
            raise DeviceError("the robot did not take the payload: its program does not run; reset the arm")
        deadline = self._clock.now() + self._config.handshake_timeout
        while True:
            self.kick()
            self._clock.sleep(1.0 / self.rate)
            self.read()
            self._expect_plausible()
            reported = self._stream.newest.payload
            if reported is None or np.abs(np.subtract(reported, [mass, *center_of_mass])).max() < PAYLOAD_TOLERANCE:
                return
            if self._clock.now() > deadline:
                raise DeviceError(
                    f"the payload was set to {mass:.3f} kg at {np.round(center_of_mass, 3)} m, but the robot reports "
                    f"{reported[0]:.3f} kg at {np.round(reported[1:], 3)} m"
                )

    def start_freedrive(self) -> None:
        with bounded(self._clock.to_wall_time(self._config.handshake_timeout)):
            if self.servoing:
                self._control.servoStop()
                self.servoing = False
            if not self._control.teachMode():
                raise DeviceError("the robot did not go into freedrive: its program does not run; reset the arm")

    def end_freedrive(self) -> None:
        """Returns when the controller holds the arm at one place: let go of in mid-motion, it brakes first."""
        with bounded(self._clock.to_wall_time(self._config.handshake_timeout)):
            self._control.endTeachMode()
            self._catch_up()
            held = 0
            while held < _HELD:
                before = self.reading[StateColumn.COMMANDED].copy()
                self.kick()
                self._clock.sleep(1.0 / self.rate)
                if self.read():
                    moved = np.abs(self.reading[StateColumn.COMMANDED] - before).max()
                    held = held + 1 if moved <= START_TOLERANCE else 0
                self._expect_plausible()

    def close(self) -> None:
        """End the robot's program, at rest, and the connections; whatever does not end by itself ends the process."""
        with bounded(self._clock.to_wall_time(self._config.handshake_timeout)):
            if self.connected and self.playing and self.status is ArmStatus.READY:
                if self.servoing:
                    self._control.servoStop()
                self._control.stopScript()
        # ur_rtde's own clean-up may hang, reconnect or crash; the kernel's does not.
        os._exit(0)

    @contextmanager
    def _while_connected(self) -> Iterator[None]:
        """A command that finds the connection gone makes ur_rtde try for another one, which it cannot have."""
        try:
            yield
        except RuntimeError:
            self._lost = True

    def _catch_up(self) -> None:
        """Take in all that came during a handshake."""
        for _ in range(_CATCH_UP):
            if not self.read():
                break
        self._expect_plausible()

    def _expect_plausible(self) -> None:
        if not self.plausible:
            raise DeviceError("the robot's data make no sense (joints, forces or time): restart its controller")


def _explain(message: str, host: str) -> str:
    if "in use" in message.lower() or "IN_USE" in message:
        return f"another program controls the robot at {host} over RTDE: end it first ({message})"
    if "remote" in message.lower():
        return f"the robot at {host} is not in remote control: switch it over at the pendant ({message})"
    return f"the robot at {host} refuses the connection: {message}"

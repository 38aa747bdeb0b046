"""The servo process's link to the robot: ur_rtde's control interface and a separate stream of the robot's state.

This module and `script_calls` alone use ur_rtde. Its return values are not relied on: calls return True long after the
link is lost. A reading is new only if the controller's timestamp has advanced. Calls that wait for the control script
can block for minutes, so each runs under a timer whose signal ends this process; the robot's watchdog then stops the
robot.
"""

from __future__ import annotations

import os
import resource
import signal
import socket
import stat
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from rtde_control import RTDEControlInterface

from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.protocols.rtde import RTDE_PORT
from toolee_robot.devices.ur.servo.program_watch import ProgramStop, WatchedProgram
from toolee_robot.devices.ur.servo.shared_memory import StateColumn
from toolee_robot.devices.ur.servo.state_stream import Reading, StateStream
from toolee_robot.devices.ur.status import RUNTIME_PAUSED, RUNTIME_PLAYING, RUNTIME_STOPPED, advice, arm_status
from toolee_robot.errors import DeviceError, NotReadyError
from toolee_robot.frames import Array
from toolee_robot.hal import ArmStatus

_KICK = struct.pack(">HBBi", 8, ord("U"), 4, 0)
"""A data packet of ur_rtde's fourth input recipe, which is input_int_register_0 alone, with 0: no command."""

_OPEN_FILES = 1  # not 0: poll() refuses more descriptors than the limit. Descriptor 0 itself is in use.


class UrRtdeSocket:
    """The one socket of ur_rtde that is connected to the robot's RTDE server at the time of construction.

    ur_rtde's control interface reconnects silently when it has lost the robot: within a few milliseconds it ends the
    robot's program and starts another. But a lost connection must end a motion, and nothing may resume by itself. So
    the original socket is monitored, and the process is prevented from opening others.

    ur_rtde's own `kickWatchdog` waits until the control script has taken the kick. If the robot is stopped or its
    program paused in that cycle, the script never does, and the call keeps this process busy for seconds. The kick is
    therefore written as the RTDE packet that it is.

    ur_rtde also disables Nagle's algorithm on a socket that it replaces when it connects, so it stays enabled. A
    command then waits for the acknowledgement of the previous one, which a controller sends with its next packet: after
    one late command, every later one would arrive a cycle late.

    Construction disables Nagle's algorithm on it and prevents this process from opening any more files or sockets; a
    new connection needs a new process.

    Args:
        port: TCP port of the RTDE server.
        ours: Descriptor of this process's own connection to it, which is not ur_rtde's.

    Raises:
        DeviceError: ur_rtde has another number of connections than the one that is known here.
    """

    def __init__(self, port: int, ours: int) -> None:
        found: dict[int, int] = {}
        for entry in Path("/proc/self/fd").iterdir():
            with suppress(OSError):  # not connected, or the descriptor of the listing itself
                fd, state = int(entry.name), os.fstat(int(entry.name))
                if fd != ours and stat.S_ISSOCK(state.st_mode) and _claim(fd, port):
                    found[fd] = state.st_ino
        if len(found) != 1:
            message = f"ur_rtde has {len(found)} RTDE connections instead of one: install the version in pyproject"
            raise DeviceError(message)
        ((self._fd, self._inode),) = found.items()
        resource.setrlimit(resource.RLIMIT_NOFILE, (_OPEN_FILES, _OPEN_FILES))

    @property
    def same(self) -> bool:
        """Whether it is still the original one; takes some microseconds."""
        try:
            return os.fstat(self._fd).st_ino == self._inode
        except OSError:
            return False

    def kick(self) -> bool:
        """Reset the robot's watchdog; never waits. Returns whether the connection took the packet."""
        try:
            return self.same and os.write(self._fd, _KICK) == len(_KICK)
        except OSError:
            return False


def _claim(fd: int, port: int) -> bool:
    """Disable Nagle's algorithm if the socket is connected to this port; returns whether it is."""
    with socket.socket(fileno=os.dup(fd)) as sock:
        if sock.family not in (socket.AF_INET, socket.AF_INET6) or sock.getpeername()[1] != port:
            return False
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return True


AT_REST = 0.02
"""[rad/s] Joint speed below which the arm counts as standing, where nothing moves it and encoders are noisy."""

_CATCH_UP_READS = 100  # reads after a handshake, at most


@contextmanager
def bounded(seconds: float) -> Iterator[None]:
    """Kill this process if the body takes longer than `seconds` on the wall clock.

    SIGALRM's default action needs no interpreter.
    """
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


class UrLink:
    """A connection to the robot for commands and state. Connecting moves nothing.

    Args:
        config: The driver's settings.
        rate: The controller's rate [Hz].
        watched: Notes for the process that ends the program if this one cannot.

    Attributes:
        rate: The controller's rate [Hz].
        reading: Newest state, (StateColumn.COUNT,). Its commanded position is the one sent last or, while the arm is
            not servoed, the one at which the controller holds it.
        control: ur_rtde's control interface, for the calls that the control script acknowledges.
        refused: Whether ur_rtde has refused to send a position because it takes the robot's program as ended; stays
            True.
        status: Status of the robot's safety system and mode.
        playing: Whether the robot's program runs.
        paused: Whether the robot's program is paused: Play, or a safeguard that closes, would resume its last motion.
        servoing: Whether the control script's servo thread runs, which holds the last position sent.

    Raises:
        NotReadyError: The robot's safety system or mode forbids motion.
        DeviceError: ur_rtde cannot connect, or the robot's data are implausible.
    """

    def __init__(self, config: UrArmConfig, rate: float, watched: WatchedProgram) -> None:
        self._config, self.rate, self._clock = config, rate, config.clock
        self._watched = watched
        self.reading: Array = np.zeros(StateColumn.COUNT)
        self.refused, self._lost = False, False
        self._unread: list[Reading] = []
        self.status, self.playing, self.paused, self.servoing = ArmStatus.NOT_READY, False, False, False
        self._program_exists = False  # since this connection uploaded it
        with bounded(self._clock.to_wall_time(config.servo.connect_timeout)):
            try:
                self._stream = StateStream(
                    config.host, rate, self._clock.to_wall_time(config.servo.connect_timeout), self._clock
                )
                self._show_newest()
                if self.status is not ArmStatus.READY:
                    raise NotReadyError(advice(self.status), code=f"not_ready.{self.status}")
                self._program_stop = ProgramStop(
                    config.host, time.monotonic() + self._clock.to_wall_time(config.servo.connect_timeout)
                )
                self.control = RTDEControlInterface(config.host)
                while not self.playing:
                    self.read()
                    self.expect_plausible()
                    time.sleep(1e-3)
                self._program_exists = True
                self._watched.begun()
                self.control.setWatchdog(config.servo.watchdog)
                self.catch_up()
                self._socket = UrRtdeSocket(RTDE_PORT, self._stream.fileno())
            except (RuntimeError, ValueError, IndexError, MemoryError) as error:  # C++ exceptions
                raise DeviceError(_explain(str(error), config.host), code="device.connection_refused") from error

    @property
    def connected(self) -> bool:
        """Whether all connections seem to be the original ones. Only False is certain."""
        return not (self._lost or self._stream.lost) and bool(self.control.isConnected() and self._socket.same)

    @property
    def plausible(self) -> bool:
        """Whether all data so far were plausible; once False it stays False. Implausible data are discarded."""
        return self._stream.plausible

    @property
    def age(self) -> float:
        """Age of the newest reading [s]."""
        return self._clock.now() - self._stream.seen

    @property
    def arrived(self) -> float:
        """When the newest reading arrived at this machine [s], which shows the controller's cycle."""
        return self._stream.arrived

    @property
    def newest(self) -> Reading:
        """The newest reading, with what `reading` has no elements for."""
        return self._stream.newest

    @property
    def wrench_offset(self) -> Array:
        """What is subtracted from the wrench of the readings to come, (6,) [N, Nm], axes of `base`."""
        return self._stream.wrench_offset

    @wrench_offset.setter
    def wrench_offset(self, offset: Array) -> None:
        self._stream.wrench_offset = offset

    def unread(self) -> list[Reading]:
        """All readings since the last call, the oldest first."""
        unread, self._unread = self._unread, []
        return unread

    def read(self) -> bool:
        """Take the readings that have arrived; never waits.

        Returns:
            Whether there were new and plausible readings.
        """
        readings = self._stream.take()
        if not readings:
            return False
        self._unread += readings
        self._show_newest()
        return True

    def _show_newest(self) -> None:
        newest, reading = self._stream.newest, self.reading
        safety, mode, runtime = newest.safety_bits, newest.robot_mode, newest.runtime_state
        reading[:5] = self._stream.seen, newest.timestamp, safety, mode, runtime
        reading[StateColumn.Q], reading[StateColumn.QD] = newest.q, newest.qd
        reading[StateColumn.WRENCH] = newest.wrench
        reading[StateColumn.SPEED_SLIDER], reading[StateColumn.SPEED_SCALING] = (
            newest.speed_slider,
            newest.speed_scaling,
        )
        reading[StateColumn.RATIOS] = newest.position_deviation_ratio, newest.collision_ratio
        reading[StateColumn.DIGITAL_INPUTS] = newest.digital_inputs
        reading[StateColumn.TORQUES], reading[StateColumn.CURRENTS] = newest.torques, newest.currents
        if not self.servoing:  # a person may move it, or it may still be decelerating after a program's end
            reading[StateColumn.COMMANDED] = newest.target
        self.status = arm_status(safety, mode)
        self.playing, self.paused = runtime == RUNTIME_PLAYING, runtime in RUNTIME_PAUSED
        if self._program_exists and runtime == RUNTIME_STOPPED:
            self._program_exists = False
            self._watched.ended()

    def end_halted_program(self) -> None:
        """Ask the dashboard server to end this connection's program if the robot was stopped or the program paused.

        To be called in every cycle. Never waits, releases nothing, and touches no other program.
        """
        # A pause at the pendant stops on the path; ended in the middle of it, the program would leave the path.
        pausing = self.status is ArmStatus.READY and np.abs(self.reading[StateColumn.QD]).max() > AT_REST
        if self._program_halted and not pausing:
            self._program_stop.request()

    @property
    def _program_halted(self) -> bool:
        """Whether this connection's program waits behind a stop or a pause, and could be resumed."""
        return self._program_exists and (self.paused or self.status is not ArmStatus.READY)

    def servo(self, q: Array) -> None:
        """Send a joint position (6,) [rad]; this resets the robot's watchdog as well."""
        with self._while_connected():
            sent = self.control.servoJ(
                q.tolist(), 0.0, 0.0, 1.0 / self.rate, self._config.servo.lookahead, self._config.servo.gain
            )
            self.refused = self.refused or not sent
        self.reading[StateColumn.COMMANDED] = q
        self.servoing = True

    def kick(self) -> None:
        """Reset the robot's watchdog.

        Not in a cycle that has sent a position: of two commands in one of its cycles the robot takes the later.
        """
        self._lost = self._lost or not self._socket.kick()

    def close(self) -> None:
        """End the robot's program, at rest, and this process with all its connections.

        Where the program's end is not seen in time, `ProgramWatch` sees to it.
        """
        with bounded(self._clock.to_wall_time(self._config.servo.handshake_timeout)):
            if self.connected and self.playing and self.status is ArmStatus.READY:
                if self.servoing:
                    self.control.servoStop()
                self.control.stopScript()
            while self.connected and self.plausible and self._program_exists:
                self.end_halted_program()
                self._clock.sleep(1.0 / self.rate)
                self.read()
        # No destructors: ur_rtde's may hang, reconnect or crash. The kernel closes the connections.
        os._exit(0)

    @contextmanager
    def _while_connected(self) -> Iterator[None]:
        """Record a lost connection.

        A command on one makes ur_rtde try to reconnect, which `UrRtdeSocket` prevents, and so raises RuntimeError.
        """
        try:
            yield
        except RuntimeError:
            self._lost = True

    def catch_up(self) -> None:
        """Take all readings that arrived during a handshake."""
        for _ in range(_CATCH_UP_READS):
            if not self.read():
                break
        self.expect_plausible()

    def expect_plausible(self) -> None:
        """Check that all data so far were plausible.

        Raises:
            DeviceError: They were not.
        """
        if not self.plausible:
            message = "the robot's data are implausible (joints, forces or time): restart its controller"
            raise DeviceError(message)


def _explain(message: str, host: str) -> str:
    if "in use" in message.lower() or "IN_USE" in message:
        return f"another program controls the robot at {host} over RTDE: end it first ({message})"
    if "remote" in message.lower():
        return f"the robot at {host} is not in remote control: switch it over at the pendant ({message})"
    return f"the robot at {host} refuses the connection: {message}"

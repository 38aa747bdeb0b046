"""The servo process: the only process that talks to the robot, at the controller's rate; handles the task's requests.

Started by `ServoClient`. If it crashes, hangs or is killed, the robot's watchdog stops the robot and the task gets a
typed error. If the task's process ends or stalls, this process stops the arm on its path.
"""

from __future__ import annotations

import faulthandler
import os
import select
import signal
import sys
import time
import traceback
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.servo.clock import SEEK, Realtime, Schedule, become_realtime
from toolee_robot.devices.ur.servo.messages import (
    Cause,
    Close,
    Connect,
    Connected,
    Done,
    Freedrive,
    MotionEnded,
    MotionRequest,
    Refused,
    Reply,
    Request,
    SetPayload,
    ZeroWrench,
)
from toolee_robot.devices.ur.servo.motion import Motion
from toolee_robot.devices.ur.servo.program_watch import WatchedProgram
from toolee_robot.devices.ur.servo.rtde_link import UrLink
from toolee_robot.devices.ur.servo.script_calls import ScriptCalls
from toolee_robot.devices.ur.servo.shared_memory import ServoMemory, StateColumn, Word
from toolee_robot.errors import DeviceError
from toolee_robot.hal import ArmStatus

EXIT_LINK_LOST = 3
_FRESH_READINGS = 3  # new readings before a motion begins
_FRESH_CYCLES = 5  # cycles to wait for them, at most


class ServoProcess:
    """The servo loop at rest; motions run in `Motion`.

    Args:
        pipe: Connection to the task's process.
        memory: Memory shared with the task's process.
        link: Connection to the robot.
        config: The driver's settings.
    """

    def __init__(self, pipe: Connection, memory: ServoMemory, link: UrLink, config: UrArmConfig) -> None:
        self._pipe, self._memory, self._link, self._config = pipe, memory, link, config
        self._poll = select.poll()
        self._poll.register(pipe.fileno(), select.POLLIN | select.POLLHUP)
        self._calls = ScriptCalls(link, config, self._publish)
        self._beat, self._since = -1, 0.0
        self._clock = config.clock
        self._fault = Cause.NONE
        self._terminated = False
        signal.signal(signal.SIGTERM, self._terminate)

    def run(self) -> None:
        """Run until the task requests the end or is gone, or the link is lost. Does not return: the process exits."""
        link = self._link
        schedule = Schedule(self._clock.now(), 1.0 / link.rate, self._clock)
        schedule.follow(link.arrived, 0.5)
        answered = 0.0
        while True:
            schedule.wait()
            link.read()
            schedule.follow(link.arrived, SEEK)
            link.unread()
            link.end_halted_program()
            self._judge()
            # At most one for each reading: what is sent to a controller that stalls queues up there and delays every
            # later command.
            if self._fault < Cause.PROGRAM_ENDED and link.playing and link.reading[StateColumn.TIMESTAMP] > answered:
                link.kick()
                answered = float(link.reading[StateColumn.TIMESTAMP])
            self._publish()
            if self._terminated:
                link.close()
            if self._poll.poll(0):
                self._handle(schedule)

    def connected(self, realtime: Realtime) -> None:
        """Set the TCP and tell the task's process that the robot is connected.

        Args:
            realtime: Real-time privileges that the operating system granted.

        Raises:
            DeviceError: The robot does not take the TCP.
        """
        self._calls.set_tcp()
        self._publish()
        self._pipe.send(Connected(realtime))

    def _publish(self) -> None:
        self._memory.words[Word.CYCLES] += 1
        self._memory.write_state(self._link.reading)

    def _judge(self) -> None:
        """Latch faults at rest as well: nothing moves before a reset."""
        link = self._link
        if not link.connected or self._clock.to_wall_time(link.age) > self._config.servo.link_timeout:
            self._latch(Cause.LINK)
            os._exit(EXIT_LINK_LOST)
        elif link.status is not ArmStatus.READY:
            self._latch(Cause.STOPPED_BY_ROBOT)
        elif link.paused:
            self._latch(Cause.PROGRAM_PAUSED)
        elif not link.playing:
            self._latch(Cause.PROGRAM_ENDED)
        elif not link.plausible:
            self._latch(Cause.DATA)

    def _latch(self, cause: Cause) -> None:
        if self._fault is Cause.NONE or Cause.PROGRAM_ENDED <= self._fault < cause:
            self._fault = cause
            self._memory.words[Word.CAUSE] = cause

    def _handle(self, schedule: Schedule) -> None:
        link = self._link
        try:
            request: Request = self._pipe.recv()
            reply: Reply
            if isinstance(request, Close):
                link.close()
            elif self._fault is not Cause.NONE:
                reply = (
                    MotionEnded(self._fault)
                    if isinstance(request, MotionRequest)
                    else Refused("the arm is latched", False, "device.latched")
                )
            elif isinstance(request, MotionRequest):
                self._await_data(schedule)
                reply = MotionEnded(self._move(request, schedule))
            else:
                reply = self._handshake(request)
            schedule.resume()
            self._pipe.send(reply)
        except (EOFError, OSError):
            # The task's process is gone and the arm is at rest.
            link.close()

    def _move(self, request: MotionRequest, schedule: Schedule) -> Cause:
        cause = Motion(self._link, self._memory, request, schedule, self, self._clock).run()
        if cause is Cause.TASK_ENDED:
            self._link.close()
        if cause >= Cause.DATA:
            self._fault = cause
        if cause is Cause.LINK:
            self._pipe.send(MotionEnded(cause))
            os._exit(EXIT_LINK_LOST)
        return cause

    def _handshake(self, request: Request) -> Reply:
        try:
            if isinstance(request, SetPayload):
                self._calls.set_payload(request.mass, request.center_of_mass)
            elif isinstance(request, ZeroWrench):
                self._calls.zero_wrench()
            elif isinstance(request, Freedrive):
                if request.on:
                    self._calls.start_freedrive()
                else:
                    self._calls.end_freedrive()
        except DeviceError as error:
            return Refused.from_error(error)
        self._memory.write_state(self._link.reading)  # the task plans from this state once it has the reply
        return Done()

    def lost(self) -> Cause:
        """See `motion.TaskLife`: checks the owner watch, the task's end of the pipe, and its heartbeat."""
        now, beat = self._clock.now(), int(self._memory.words[Word.HEARTBEAT])
        if beat != self._beat:
            self._beat, self._since = beat, now
        hung_up = any(events & (select.POLLHUP | select.POLLERR) for _, events in self._poll.poll(0))
        if self._terminated or not self._memory.owner.owner_alive or hung_up:
            return Cause.TASK_ENDED
        return Cause.TASK_STALLED if now - self._since > self._config.servo.heartbeat_timeout else Cause.NONE

    def _await_data(self, schedule: Schedule) -> None:
        """Wait for new readings, a bounded time: a motion must not start on data from before its request."""
        end = schedule.deadline + _FRESH_CYCLES / self._link.rate
        fresh = 0
        while fresh < _FRESH_READINGS and schedule.deadline < end:
            schedule.resume()
            schedule.wait()
            if self._link.read():
                fresh += 1
                if self._fault is Cause.NONE and self._link.playing:
                    self._link.kick()
        schedule.resume()

    def _terminate(self, _signum: int, _frame: object) -> None:
        self._terminated = True


def main() -> None:
    """Run the servo process.

    Command-line arguments: file descriptor of the pipe, file descriptor of the shared memory, longest motion [s], file
    descriptor of the notes for `ProgramWatch`.
    """
    # The terminal sends Ctrl-C to all its processes; this one only follows the task's requests.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    sys.excepthook = _die
    faulthandler.enable()  # stack traces of crashes inside ur_rtde
    pipe = Connection(int(sys.argv[1]))
    memory = ServoMemory(int(sys.argv[2]), float(sys.argv[3]))
    watched = WatchedProgram(int(sys.argv[4]))
    request: Any = pipe.recv()
    if not isinstance(request, Connect):
        raise TypeError(f"the first request must be Connect, not {request!r}")
    realtime = become_realtime()
    memory.words[Word.CONNECTING] = time.monotonic_ns()
    try:
        process = ServoProcess(pipe, memory, UrLink(request.config, request.rate, watched), request.config)
        process.connected(realtime)
    except DeviceError as error:
        pipe.send(Refused.from_error(error))
        # No destructors: ur_rtde's may hang.
        os._exit(0)
    process.run()


def _die(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print an unexpected error and exit without running destructors: ur_rtde's may hang or reconnect."""
    traceback.print_exception(kind, error, trace)
    os._exit(1)


if __name__ == "__main__":
    main()

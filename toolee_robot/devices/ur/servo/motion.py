"""One motion in the servo process: sends the path, monitors the robot, stops on the path at a contact or fault."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Protocol

import numpy as np

from toolee_robot.control.motion.contact_force import ContactForce
from toolee_robot.control.motion.path_stop import stop_on_path
from toolee_robot.devices.ur.servo.clock import FOLLOW, Schedule
from toolee_robot.devices.ur.servo.messages import Cause, MotionRequest
from toolee_robot.devices.ur.servo.rtde_link import UrLink
from toolee_robot.devices.ur.servo.shared_memory import Column, ServoMemory, StateColumn, Word
from toolee_robot.devices.ur.servo.state_stream import Reading
from toolee_robot.devices.ur.status import FULL_SPEED
from toolee_robot.frames import Array
from toolee_robot.hal import ArmStatus
from toolee_robot.runtime.clock import HostClock

STANDSTILL: Final = 1e-2
"""[rad/s] Joint speed below which a joint counts as standing: three times the noise that a CB3's may have."""
SETTLE_TIME: Final = 1.0  # [s] longest wait for standstill after the last command
HOLD_TIME: Final = 0.1
"""[s] Time at standstill before the motion ends, so that no turning point of an oscillation is taken for it."""


class TaskLife(Protocol):
    """Supervision of the task's process."""

    def lost(self) -> Cause:
        """TASK_ENDED, TASK_STALLED, or NONE while the process runs."""


class Motion:
    """One motion, from the first sample to standstill.

    Args:
        link: Connection to the robot.
        memory: Shared memory with the path; the log is written to it.
        request: The motion's parameters.
        schedule: Command slots.
        alive: Supervision of the task's process.
        clock: The station's clock.
    """

    def __init__(
        self,
        link: UrLink,
        memory: ServoMemory,
        request: MotionRequest,
        schedule: Schedule,
        alive: TaskLife,
        clock: HostClock,
    ) -> None:
        self._link, self._memory, self._request, self._schedule, self._alive = link, memory, request, schedule, alive
        self._clock = clock
        self._period = 1.0 / link.rate
        self._path = memory.path(request.knots)
        self._cause, self._silent = Cause.NONE, False
        self._time, self._row, self._streak, self._brakes, self._still = 0.0, 0, 0, False, 0
        self._commands = self._reference()
        self._lag_cycles = request.lag / self._period
        self._window = int(TAIL * self._lag_cycles + request.watch.data_cycles) + 8
        self._readings: list[Reading] = []
        self._contact = None if request.guard is None else ContactForce(request.guard, self._period)

    def run(self) -> Cause:
        """Execute the motion and return why it ended."""
        words, link = self._memory.words, self._link
        words[Word.ROWS] = words[Word.COMMANDS] = words[Word.OVERRUNS] = 0
        words[Word.CAUSE], words[Word.CONTACT_ROW] = Cause.NONE, -1
        q = link.reading[StateColumn.COMMANDED].copy()
        settled = 0
        link.unread()
        while self._row < len(self._memory.rows):
            lateness, missed = self._schedule.wait()
            link.read()
            link.end_halted_program()
            self._schedule.follow(link.arrived, FOLLOW)
            self._readings = link.unread()
            self._judge(lateness, missed)
            following = None if self._silent else next(self._commands, None)
            if following is not None:
                q = following
            if not self._silent:
                link.servo(q)
                words[Word.COMMANDS] = self._row + 1
            self._log(q, lateness)
            if following is None:
                settled += 1
                if self._at_rest(settled):
                    break
        return self._cause

    def _judge(self, lateness: float, missed: int) -> None:
        """Check every reason to stop. The first one is reported, unless a later one forbids sending."""
        words, watch = self._memory.words, self._request.watch
        late = missed + (lateness >= self._period / 2)
        words[Word.OVERRUNS] += late
        self._streak = self._streak + late if late else 0
        touches = self._touches()
        if not self._link.connected:
            self._end(Cause.LINK)
        elif not self._link.plausible or self._link.age > watch.data_cycles * self._period:
            self._end(Cause.DATA)
        elif self._link.status is not ArmStatus.READY:
            self._end(Cause.STOPPED_BY_ROBOT)
        elif self._link.paused:
            self._end(Cause.PROGRAM_PAUSED)
        elif not self._link.playing or self._link.refused:
            self._end(Cause.PROGRAM_ENDED)
        elif self._link.reading[StateColumn.SPEED_SLIDER] < FULL_SPEED:
            self._end(Cause.SPEED_SLIDER)
        elif self._link.reading[StateColumn.SPEED_SCALING] < FULL_SPEED:
            self._end(Cause.SPEED_SCALING)
        if self._cause is not Cause.NONE:
            return
        if self._streak >= watch.overruns:
            # After such a gap the arm has already come to rest at the last command and is held there.
            self._end(Cause.OVERRUN, hold=missed >= watch.overruns)
        elif self._tracking_error() > watch.tracking_error:
            self._end(Cause.TRACKING)
        elif (lost := self._alive.lost()) is not Cause.NONE:
            self._end(lost)
        elif words[Word.STOP] != self._request.stop:
            self._end(Cause.STOP)
        elif touches:
            words[Word.CONTACT_ROW] = self._row
            self._end(Cause.CONTACT)

    def _end(self, cause: Cause, hold: bool = False) -> None:
        if cause >= Cause.PROGRAM_ENDED:
            self._silent = True
        if cause is Cause.PROGRAM_ENDED and self._cause >= Cause.DATA:
            return  # the program ended because of the earlier fault, which is the one to report
        if cause <= self._cause or (self._cause > Cause.NONE and cause < Cause.PROGRAM_ENDED):
            return
        self._cause = cause
        self._memory.words[Word.CAUSE] = cause
        if cause < Cause.PROGRAM_ENDED and not self._brakes:
            self._brakes = True
            self._commands = iter(()) if hold else self._brake()

    def _reference(self) -> Iterator[Array]:
        samples, reference = self._request.samples, self._memory.reference
        for k in range(samples):
            self._time = min((k + 1) * self._period, self._path.duration)
            yield reference[k].copy()

    def _brake(self) -> Iterator[Array]:
        request = self._request
        for q, _ in stop_on_path(self._path, self._time, self._period, request.acceleration, request.jerk):
            yield q

    def _touches(self) -> bool:
        """Whether the force is a contact at any of the new readings."""
        if self._contact is None:
            return False
        touches = [self._contact.add(reading.wrench[:3], self._time) for reading in self._readings]
        return any(touches) and not self._brakes

    def _tracking_error(self) -> float:
        reading = self._link.reading
        rows = self._memory.rows[max(self._row - self._window, 0) : self._row]
        seen, q = float(reading[StateColumn.SEEN]), reading[StateColumn.Q]
        return tracking_error(rows[:, Column.SENT], rows[:, Column.COMMANDED], seen, q, self._request.lag)

    def _at_rest(self, settled: int) -> bool:
        """Whether the arm stands, by fresh data and after the servo's lag, or the wait for it is over.

        An oscillating arm is at rest for a moment at each turning point, so standstill must last HOLD_TIME.
        """
        if settled > SETTLE_TIME / self._period or self._cause is Cause.LINK:
            return True
        reading = self._link.reading
        fresh = self._link.age < self._request.watch.data_cycles * self._period
        still = fresh and bool(np.abs(reading[StateColumn.QD]).max() < STANDSTILL)
        self._still = self._still + 1 if still else 0
        hold = HOLD_TIME / self._period
        return self._still >= hold and settled >= hold + self._lag_cycles

    def _log(self, q: Array, lateness: float) -> None:
        memory, reading, row = self._memory, self._link.reading, self._memory.rows[self._row]
        row[Column.SENT], row[Column.LATENESS] = self._clock.now(), lateness
        row[Column.SEEN], row[Column.TIMESTAMP] = reading[StateColumn.SEEN], reading[StateColumn.TIMESTAMP]
        row[Column.PATH_TIME], row[Column.COMMANDED] = self._time, q
        row[Column.Q], row[Column.QD] = reading[StateColumn.Q], reading[StateColumn.QD]
        row[Column.DRIVES], row[Column.SAFETY_BITS] = reading[StateColumn.DRIVES], reading[StateColumn.SAFETY_BITS]
        wrenches = [new.wrench for new in self._readings] or [reading[StateColumn.WRENCH]]
        row[Column.WRENCH] = max(wrenches, key=lambda wrench: float(wrench[:3] @ wrench[:3]))
        ratios = [(new.position_deviation_ratio, new.collision_ratio) for new in self._readings]
        row[Column.RATIOS] = np.max(ratios, axis=0) if ratios else reading[StateColumn.RATIOS]
        self._row += 1
        memory.words[Word.ROWS] = self._row
        memory.words[Word.CYCLES] += 1
        memory.write_state(reading)


TAIL = 1.1
"""How far back the commands reach that a reading may answer to, in lags. One that a servo smooths to the first order
answers to still older ones: where its time constant is the whole lag, a transfer at full speed leaves those of one lag
by 57 mrad, and those of 1.1 by 49 (computed at 125 Hz, where 50 stop the arm)."""


def tracking_error(sent: Array, commanded: Array, seen: float, q: Array, lag: float) -> float:
    """Distance of a reading from all the commands that it may answer to.

    Those are the commands sent from `TAIL` lags before the reading on, and the one in force then: a servo that delays
    the path by no more is between them, and how fast the arm moves does not matter.

    Args:
        sent: When each command was sent, increasing, (n,) [s].
        commanded: The commands, (n, 6) [rad].
        seen: When the reading was received [s].
        q: The measured joint positions, (6,) [rad].
        lag: Upper bound of the lag [s].

    Returns:
        The distance of the joint that is furthest outside its range of commands [rad]; 0 before the first command.
    """
    i, j = np.searchsorted(sent, (seen - TAIL * lag, seen))
    if j == 0:
        return 0.0
    due = commanded[max(i - 1, 0) : j]
    return float(max(np.max(q - due.max(axis=0)), np.max(due.min(axis=0) - q), 0.0))

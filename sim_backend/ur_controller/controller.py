"""The controller: its ports and its tick loop, in one thread, on an absolute schedule.

Between ticks the sockets are read as data arrive. In a tick the script's threads run with the latest inputs, the motion
and the physics advance, the safety system checks its limits, and the services (ports, a world's own) publish.
"""

from __future__ import annotations

import gc
import os
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import astuple, dataclass, replace
from math import isfinite
from typing import get_args

from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.runtime.clock import HostClock, check_real_time_factor, is_loopback, readable
from toolee_robot.sim_backend.ur_controller.faults.fault_port import FaultSession
from toolee_robot.sim_backend.ur_controller.faults.hooks import Faults
from toolee_robot.sim_backend.ur_controller.profile import (
    Profile,
    ProfileName,
    SafetyLimits,
    StopDecelerations,
    profile,
    usual_lag,
)
from toolee_robot.sim_backend.ur_controller.robot.plant import MODELS, ControllerModel, Plant
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.server.dashboard import DashboardSession
from toolee_robot.sim_backend.ur_controller.server.port import Port, Service
from toolee_robot.sim_backend.ur_controller.server.primary import ScriptSession, StateSession
from toolee_robot.sim_backend.ur_controller.server.rtde import RtdeFaults, RtdeSession
from toolee_robot.sim_backend.ur_controller.server.rtde_variables import Inputs, Outputs

CATCH_UP = 0.05  # [s] of delay that is caught up by back-to-back ticks; beyond it the schedule is shifted


@dataclass
class TickStatistics:
    """Statistics of the ticks.

    Attributes:
        ticks: Number of ticks.
        late: Ticks that began more than half a period late.
        slipped: Periods by which the schedule was shifted, because machine or physics were too slow.
        worst_late: Largest delay of a tick [s].
        busy: CPU time spent on all ticks [s].
    """

    ticks: int = 0
    late: int = 0
    slipped: int = 0
    worst_late: float = 0.0
    busy: float = 0.0


class Schedule:
    """The schedule of the ticks.

    After a late tick the next ones follow without a pause until the schedule is met again, so that the rate is kept on
    average. After a delay of more than CATCH_UP the schedule is shifted by whole periods instead: no tick is omitted,
    but the robot's time falls behind the clock.

    Args:
        period: Period of the ticks [s].
        clock: The robot's clock.

    Attributes:
        period: Period of the ticks [s].
        clock: The robot's clock.
        statistics: Statistics of the ticks.
    """

    def __init__(self, period: float, clock: HostClock) -> None:
        self.period, self.clock = period, clock
        self.statistics = TickStatistics()
        self._start, self._count = clock.now(), 0

    @property
    def due(self) -> float:
        """Time of the next tick [s]."""
        return self._start + self._count * self.period

    @property
    def overdue(self) -> bool:
        """Whether the next tick should have begun already."""
        return self.clock.now() > self.due

    def begin(self) -> float:
        """Begin the tick that is due; returns its scheduled time [s]."""
        due, statistics = self.due, self.statistics
        late = self.clock.now() - due
        if late > CATCH_UP:
            periods = int(late / self.period)
            statistics.slipped += periods
            self._start += periods * self.period
        statistics.late += late > 0.5 * self.period
        statistics.worst_late = max(statistics.worst_late, late)
        statistics.ticks += 1
        self._count += 1
        return due

    def restart(self) -> None:
        """Restart the schedule with the first tick now."""
        self._start, self._count = self.clock.now(), 0

    def reset(self) -> None:
        """Reset the statistics."""
        self.statistics = TickStatistics()


DASHBOARD_PORT, PRIMARY_PORT, SECONDARY_PORT, REALTIME_PORT, RTDE_PORT = 29999, 30001, 30002, 30003, 30004
FAULT_PORT = 30020
COLLECT_TICKS = 5000  # ticks between two runs of the garbage collector, while no client is connected
TRACE_TICKS = 30000  # ticks that the trace keeps: 4 min at 125 Hz, 1 min at 500 Hz


@dataclass(frozen=True)
class ControllerOptions:
    """Initial state of a stand-in.

    Attributes:
        model: Name of the model, a key of MODELS.
        host: Loopback address.
        fault_port: TCP port of the fault port; the other ports are the robot's.
        speed_slider: Position of the speed slider, 0 to 1.
        remote: Whether an e-Series controller is in remote control.
        safeguard_resumes: Whether closing the safeguard resumes the program that it paused; the profile's if None.
        powered: Whether the arm is powered on and its brakes are released.
        payload_kg: Mass on the flange that the controller assumes [kg].
        payload_cog: Its centre of gravity in the flange frame, (3,) [m].
        profile: How the controller follows, measures and stops: `ideal`, or `harsh` for the values of the model's
            generation.
        seed: Seed of the noise of the sensors.
        limits: Limits of the safety system; the profile's if None.
        lag: Lag of `servoj` at REFERENCE_GAIN and REFERENCE_LOOKAHEAD [s]; the profile's if None.
        stops: Decelerations of the stops; the profile's if None.
        real_time_factor: Real-time factor of the robot's time; its clients' clocks must run at the same factor.
    """

    model: str = "UR10"
    host: str = "127.0.0.2"
    fault_port: int = FAULT_PORT
    speed_slider: float = 1.0
    remote: bool = True
    safeguard_resumes: bool | None = None
    powered: bool = True
    payload_kg: float = 0.0
    payload_cog: tuple[float, float, float] = (0.0, 0.0, 0.0)
    profile: ProfileName = "ideal"
    seed: int = 0
    limits: SafetyLimits | None = None
    lag: float | None = None
    stops: StopDecelerations | None = None
    real_time_factor: float = 1.0


@dataclass(frozen=True)
class TraceRow:
    """The arm's state in one tick.

    Attributes:
        tick: Number of the tick.
        stamp: Time at its end [s] on the controller's clock.
        q: True joint positions, (6,) [rad], without the offset that a fault adds to the measured ones.
        qd: True joint velocities, (6,) [rad/s].
        q_target: Set-point, (6,) [rad].
        safety: Value of `SafetyMode`.
        program: Value of `RuntimeState`.
        commands: Value of `Inputs.commands`.
    """

    tick: int
    stamp: float
    q: Array
    qd: Array
    q_target: Array
    safety: int
    program: int
    commands: int


class Controller:
    """A stand-in for a Universal Robots controller.

    Args:
        options: Initial state.
        plant: Creates the plant for a model.
        log: Called with each line of the log.

    Attributes:
        options: Initial state.
        log: Called with each line of the log.
        clock: The robot's clock; the ports use the wall clock.
        publish_at: Fraction of a tick after which its data are sent, or as soon as the tick is done if that is later. A
            robot's data come evenly, while a plant's computation time varies.
        robot: The robot.
        schedule: Schedule of the ticks.
        outputs: RTDE output variables.
        inputs: RTDE input variables.
        rtde_faults: Faults of the RTDE server.
        trace: The latest TRACE_TICKS ticks.
        frozen_until: Time before which the loop stands still [s]; a fault.
        ports: The robot's ports, by name.
        faults: The hooks of the fault port.
        fault_port: The fault port.
        services: Everything hooked into the loop.

    Raises:
        UserError: An option is unusable.
    """

    def __init__(
        self,
        options: ControllerOptions,
        plant: Callable[[ControllerModel], Plant],
        log: Callable[[str], None] = lambda _line: None,
    ) -> None:
        _check(options)
        self.options, self.log = options, log
        self.clock = HostClock(options.real_time_factor)
        self.publish_at = 0.0
        model = MODELS[options.model]
        chosen = _profile(options, model)
        self.robot = Robot(model, plant(model), options.limits, log, chosen, options.seed)
        self.robot.machine.speed_fraction = options.speed_slider
        self.robot.machine.set_payload(options.payload_kg, options.payload_cog)
        self.robot.safety.remote = options.remote
        if options.safeguard_resumes is not None:
            self.robot.safety.safeguard_resumes = options.safeguard_resumes
        if not options.powered:
            self.robot.safety.power_off()
        self.schedule = Schedule(model.period, self.clock)
        self.outputs, self.inputs = Outputs(self.robot), Inputs(self.robot)
        self.rtde_faults = RtdeFaults()
        self.trace: deque[TraceRow] = deque(maxlen=TRACE_TICKS)
        self.frozen_until = 0.0
        robot, host = self.robot, options.host
        self.ports = {
            "dashboard": Port("dashboard", host, DASHBOARD_PORT, lambda c: DashboardSession(c, robot), log),
            "primary": Port("primary", host, PRIMARY_PORT, lambda c: StateSession(c, robot), log),
            "secondary": Port("secondary", host, SECONDARY_PORT, lambda c: StateSession(c, robot), log),
            "realtime": Port("realtime", host, REALTIME_PORT, lambda c: ScriptSession(c, robot), log),
            "rtde": Port(
                "rtde",
                host,
                RTDE_PORT,
                lambda c: RtdeSession(c, robot, self.outputs, self.inputs, self.rtde_faults),
                log,
            ),
        }
        self.faults = Faults(self)
        self.fault_port = Port("faults", host, options.fault_port, lambda c: FaultSession(c, self.faults), log)
        self.services: list[Service] = [*self.ports.values(), self.fault_port]
        self._running = False
        self._turn = 0  # rotates which ready descriptor is read first

    def add_service(self, service: Service) -> None:
        """Add a service to the loop; it is closed with the controller."""
        self.services.append(service)

    def listen(self) -> None:
        """Open all ports. Raises UserError, with no port open, if one is taken."""
        try:
            for port in (*self.ports.values(), self.fault_port):
                port.listen()
        except UserError:
            self.close()
            raise

    def run(self, realtime: bool = False) -> None:
        """Run the tick loop until `stop` is called or an exception, such as Ctrl-C, ends it; then close every port.

        The garbage collector is off in the loop, since its pauses would delay ticks; it runs while no client is
        connected.

        Args:
            realtime: Whether the calling thread gets real-time priority if permitted, as a real controller has its own
                computer.
        """
        self._running = True
        if realtime:
            with suppress(PermissionError):
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        gc.collect()
        gc.freeze()
        gc.disable()
        self.schedule.restart()
        try:
            while self._running:
                self._serve_until(self.schedule.due)
                self.tick()
        finally:
            gc.enable()
            self.close()

    def stop(self) -> None:
        """End `run` after the current tick."""
        self._running = False

    def tick(self) -> None:
        """Execute one tick now."""
        due = self.schedule.begin()
        began = time.thread_time()
        self.faults.step()
        robot = self.robot
        robot.step()
        machine = robot.machine
        self.trace.append(
            TraceRow(
                robot.ticks,
                self.clock.now(),
                robot.plant.q.copy(),
                robot.plant.qd.copy(),
                machine.q_target.copy(),
                int(robot.safety.mode),
                int(robot.program.state),
                self.inputs.commands,
            )
        )
        if self.publish_at > 0.0:
            self._serve_until(due + self.publish_at * robot.model.period)
        self.inputs.catching_up = self.schedule.overdue
        for service in self.services:
            service.on_tick(robot.model.period)
        if robot.ticks % COLLECT_TICKS == 0 and not any(port.clients for port in self.ports.values()):
            gc.collect()
        self.schedule.statistics.busy += time.thread_time() - began

    def close(self) -> None:
        """Close every port and every service."""
        for service in self.services:
            service.close()

    def _serve_until(self, due: float) -> None:
        """Read from all services until the time `due` [s]; at least once."""
        clock = self.clock
        clock.sleep(self.frozen_until - clock.now())
        while True:
            readers = {fd: service for service in self.services for fd in service.filenos()}
            timeout = max(0.0, clock.to_wall_time(due - clock.now()))
            ready = readable(list(readers), timeout)
            self.inputs.catching_up = self.schedule.overdue  # the computer may have stalled during the wait
            # A flood on many connections must not delay the tick, and no connection may starve.
            enough = max(due, clock.now()) + self.schedule.period
            self._turn = (self._turn + 1) % max(len(ready), 1)
            for fd in ready[self._turn :] + ready[: self._turn]:
                readers[fd].on_readable(fd)
                if clock.now() > enough:
                    break
            if clock.now() >= due:
                return


def _profile(options: ControllerOptions, model: ControllerModel) -> Profile:
    """The profile with what the options change of it."""
    chosen = profile(options.profile, model.e_series)
    if options.lag is not None:
        servo = chosen.servo or usual_lag(model.e_series)
        chosen = replace(chosen, servo=servo.with_lag(options.lag, model.period))
    if options.stops is not None:
        chosen = replace(chosen, stops=options.stops)
    return chosen


def _check(options: ControllerOptions) -> None:
    if options.model not in MODELS:
        message = f"unknown model {options.model!r}: choose one of {', '.join(MODELS)}"
        raise UserError(message)
    if not is_loopback(options.host):
        raise UserError(
            f"{options.host!r} is not a loopback address: the emulated controller serves this computer only. Use "
            "--host 127.0.0.2, 127.0.0.3, ...",
            code="user.not_loopback",
        )
    if options.profile not in get_args(ProfileName):
        message = f"unknown profile {options.profile!r}: choose one of {', '.join(get_args(ProfileName))}"
        raise UserError(message)
    check_real_time_factor(options.real_time_factor, options.host)
    if options.stops is not None and not all(value > 0.0 and isfinite(value) for value in astuple(options.stops)):
        message = f"the stops' decelerations must be over 0 rad/s^2, not {astuple(options.stops)}"
        raise UserError(message)
    if not 0.0 <= options.speed_slider <= 1.0:
        message = f"the speed slider must be between 0 and 1, not {options.speed_slider}"
        raise UserError(message)
    if not 0.0 <= options.payload_kg <= 50.0:
        message = f"the payload must be between 0 and 50 kg, not {options.payload_kg:g} kg"
        raise UserError(message)
    if not 1024 <= options.fault_port <= 65535:
        message = f"the fault port must be between 1024 and 65535, not {options.fault_port}"
        raise UserError(message)

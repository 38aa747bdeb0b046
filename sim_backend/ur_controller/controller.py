"""The controller: its ports and its tick loop, one thread around `select`.

A tick: sockets are drained as data comes; at the tick's time the inputs are what they are, the script's threads run,
the motion and the physics advance, safety judges, and the services (ports, a world's own) publish.
"""

from __future__ import annotations

import gc
import select
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from toolee_robot.errors import UserError
from toolee_robot.frames import Array
from toolee_robot.runtime.clock import HostClock, check_real_time_factor, is_loopback
from toolee_robot.sim_backend.ur_controller.faults.fault_port import Faults
from toolee_robot.sim_backend.ur_controller.faults.session import FaultSession
from toolee_robot.sim_backend.ur_controller.robot.model import MODELS, ControllerModel
from toolee_robot.sim_backend.ur_controller.robot.plant import Plant
from toolee_robot.sim_backend.ur_controller.robot.safety import SafetyLimits
from toolee_robot.sim_backend.ur_controller.robot_system import Robot
from toolee_robot.sim_backend.ur_controller.server.dashboard import DashboardSession
from toolee_robot.sim_backend.ur_controller.server.port import Port
from toolee_robot.sim_backend.ur_controller.server.primary import StateSession
from toolee_robot.sim_backend.ur_controller.server.rtde import RtdeFaults, RtdeSession
from toolee_robot.sim_backend.ur_controller.server.rtde_inputs import Inputs
from toolee_robot.sim_backend.ur_controller.server.rtde_variables import Outputs
from toolee_robot.sim_backend.ur_controller.server.schedule import Schedule
from toolee_robot.sim_backend.ur_controller.server.script_ports import ScriptSession
from toolee_robot.sim_backend.ur_controller.server.service import Service

DASHBOARD_PORT, PRIMARY_PORT, SECONDARY_PORT, REALTIME_PORT, RTDE_PORT = 29999, 30001, 30002, 30003, 30004
FAULT_PORT = 30020
COLLECT_TICKS = 5000  # between two runs of the garbage collector, while nobody is connected
TRACE_TICKS = 30000  # 4 min at 125 Hz, 1 min at 500 Hz


@dataclass(frozen=True)
class ControllerOptions:
    """How a stand-in starts. model: of MODELS. host: a loopback address. fault_port: of the fault port; the other
    ports are the robot's. speed_slider: 0..1. q_start (6,) [rad]; None: the plant's own. remote: e-Series remote
    control. powered: brakes are released already. limits: of the safety system. real_time_factor: of the robot's time,
    all of it, against the wall's: its clients' clocks must run at the same."""

    model: str = "UR10"
    host: str = "127.0.0.2"
    fault_port: int = FAULT_PORT
    speed_slider: float = 1.0
    remote: bool = True
    powered: bool = True
    limits: SafetyLimits = field(default_factory=SafetyLimits)
    real_time_factor: float = 1.0


@dataclass(frozen=True)
class TraceRow:
    """One tick. stamp: of the controller's clock at its end [s]. q, qd: true, without the offset that a fault adds to
    what is measured. q_target: the set-point. safety: mode. program: runtime state."""

    tick: int
    stamp: float
    q: Array
    qd: Array
    q_target: Array
    safety: int
    program: int


class Controller:
    """A stand-in for a Universal Robots controller.

    plant: makes what the controller moves. Raises UserError for an address that is not loopback, an unknown model, or
    a port that is taken. clock: the robot's time; the ports' is the wall's. publish_at: share of a tick after which its
    data go out, or as soon as it is done where that takes longer: a robot's come evenly, while a plant may take now
    little of a tick, now most of it.
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
        self.robot = Robot(model, plant(model), options.limits, log)
        self.robot.machine.speed_fraction = options.speed_slider
        self.robot.safety.remote = options.remote
        if not options.powered:
            self.robot.safety.power_off()
        self.schedule = Schedule(model.period, self.clock)
        self.outputs, self.inputs = Outputs(self.robot), Inputs(self.robot)
        self.rtde_faults = RtdeFaults()
        self.trace: deque[TraceRow] = deque(maxlen=TRACE_TICKS)
        self.frozen_until = 0.0  # [s] before which the loop stands still (a fault)
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
        self._turn = 0  # whose data are taken first

    def add_service(self, service: Service) -> None:
        """Hook descriptors and a tick callback of someone else into the loop; closed with the controller."""
        self.services.append(service)

    def listen(self) -> None:
        """Open all ports. Raises UserError when one is taken; none is open then."""
        try:
            for port in (*self.ports.values(), self.fault_port):
                port.listen()
        except UserError:
            self.close()
            raise

    def run(self) -> None:
        """The tick loop, until `stop` is called or an exception (Ctrl-C) ends it; closes every port.

        The garbage collector is off in the loop: its pauses would be late ticks. It runs when nobody is connected.
        """
        self._running = True
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
        """End `run` after the present tick."""
        self._running = False

    def tick(self) -> None:
        """One tick, now."""
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
        """Read from whoever sends until the time `due` [s]; at least once."""
        clock = self.clock
        clock.sleep(self.frozen_until - clock.now())
        while True:
            readers = {fd: service for service in self.services for fd in service.filenos()}
            timeout = max(0.0, clock.to_wall_time(due - clock.now()))
            ready, _, _ = select.select(list(readers), [], [], timeout)
            self.inputs.catching_up = self.schedule.overdue  # the computer may have stopped in the midst of the wait
            # A flood on many connections must not hold up the tick, nor one of them always come last.
            enough = max(due, clock.now()) + self.schedule.period
            self._turn = (self._turn + 1) % max(len(ready), 1)
            for fd in ready[self._turn :] + ready[: self._turn]:
                readers[fd].on_readable(fd)
                if clock.now() > enough:
                    break
            if clock.now() >= due:
                return


def _check(options: ControllerOptions) -> None:
    if options.model not in MODELS:
        raise UserError(f"unknown model {options.model!r}: choose one of {', '.join(MODELS)}")
    if not is_loopback(options.host):
        raise UserError(
            f"{options.host!r} is not a loopback address: the stand-in serves this machine only. Use --host 127.0.0.2, "
            "127.0.0.3, ..."
        )
    check_real_time_factor(options.real_time_factor, options.host)
    if not 0.0 <= options.speed_slider <= 1.0:
        raise UserError(f"the speed slider is between 0 and 1, not {options.speed_slider}")
    if not 1024 <= options.fault_port <= 65535:
        raise UserError(f"the fault port is between 1024 and 65535, not {options.fault_port}")

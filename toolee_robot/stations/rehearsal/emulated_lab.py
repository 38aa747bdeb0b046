"""A lab's station whose devices are all emulated, in front of a simulated cell.

The cell is what the station file says, with the errors of what a person measures. They are drawn from the seed, and
unknown to the job: where the camera really stands, by the covariance of its calibration; where
the nail really is and how it leans; and the hammer, of which the job gets what a ruler and scales tell
(`sim_backend.cell_errors`).
"""

from __future__ import annotations

import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from toolee_robot.calibration.record import read_record
from toolee_robot.control import RobotModel
from toolee_robot.control.supervisor_checks import UNSURE
from toolee_robot.errors import (
    ConfigError,
    DeviceError,
    OverrunError,
    PersonNearError,
    StaleDataError,
    UserError,
)
from toolee_robot.frames import Array
from toolee_robot.hal import Station
from toolee_robot.robots import MOUNT
from toolee_robot.robots.hands import HAND_FILES
from toolee_robot.runtime.clock import HostClock
from toolee_robot.runtime.latency_monitor import CpuKeepalive
from toolee_robot.sim_backend.cell_errors import NOMINAL, DrawnErrors, draw_errors
from toolee_robot.sim_backend.devices.software_realsense import Pictures
from toolee_robot.sim_backend.hands import emulated_hand, find_emulator
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.remote import RemoteJudge, RemoteWorld
from toolee_robot.sim_backend.station import draw_handover
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.station import REHEARSED, HandConfig, StationConfig
from toolee_robot.stations.lab import LabStation, Purpose, check_purpose
from toolee_robot.stations.rehearsal.camera import SeenScene, emulated_stream
from toolee_robot.stations.rehearsal.person import FingerCoupling, RehearsedPerson
from toolee_robot.tools import Tool

_LATE = (
    "device.timeout", "motion_fault.task_stalled", "no_answer.hand_silent", "no_answer.hand_write",
    "no_answer.timeout", "not_ready.timing", "person_near.switch_not_taken",
)  # fmt: skip
"""Codes of further errors that late programs alone explain where every device and the person are emulated."""
_PORTS = (29999, 30004)
SWITCH_INTERVAL = 0.0005
"""Time after which a thread of this process must let another one run [s]: drivers and emulated devices keep to their
wires' times."""


@dataclass(frozen=True, eq=False)
class Cell:
    """A simulated cell, and what a person measured there.

    Attributes:
        true: The cell as it is.
        measured: The cell as the station file says.
        tool: The tool in the cell.
        options: Options of the simulation.
        seed: Seed of room and noise.
    """

    true: StationConfig
    measured: StationConfig
    tool: Tool
    options: SimOptions
    seed: int


class EmulatedLab:
    """The devices of a `LabStation`, each at the other end of its wire emulated; use it in its `with` block.

    Args:
        cell: The cell.
        tell: Shows a prompt to the person at the station.
        real_time_factor: Rate of the station's time relative to wall-clock time.
        profile: How the arm's controller follows, measures and stops.
        purpose: What the devices are for.
        doing: Told what is connected to.

    Attributes:
        station: The devices; set inside the block.
        judge: Ground truth, for the evaluation; set inside the block.

    Raises:
        ConfigError: The station file lacks what the purpose needs, or names a hand that cannot be emulated.
    """

    station: Station
    judge: RemoteJudge

    def __init__(
        self,
        cell: Cell,
        tell: Callable[[str], object],
        real_time_factor: float,
        profile: ProfileName,
        purpose: Purpose = Purpose.JOB,
        doing: Callable[[str], object] = lambda _: None,
    ) -> None:
        LabStation(cell.measured, tell, purpose=purpose)  # refuses what is missing
        hand = cell.measured.hand.model
        if hand != MOUNT and find_emulator(hand) is None:
            raise ConfigError(
                f"the hand {hand!r} cannot be rehearsed, because it has no emulator. These have one: "
                f"{', '.join(HAND_FILES)}. A {MOUNT} needs none"
            )
        self._cell, self._tell, self._purpose, self._doing = cell, tell, purpose, doing
        self._clock, self._profile = HostClock(real_time_factor), profile
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        """Start the emulators, and connect the drivers.

        Raises:
            UserError: An emulator cannot start.
            DeviceError: A driver cannot connect.
        """
        cell, clock, config = self._cell, self._clock, self._cell.measured
        with self.blaming_the_machine(), ExitStack() as stack:
            stack.callback(sys.setswitchinterval, sys.getswitchinterval())
            sys.setswitchinterval(SWITCH_INTERVAL)
            stack.enter_context(CpuKeepalive())
            host = stack.enter_context(claimed_address())
            self._doing(f"starting the simulated cell behind a controller at {host}")
            world = RemoteWorld(cell.true, cell.seed, cell.options, host, clock, self._profile)
            stack.enter_context(world)
            self._set_up_robot(world)
            hand = self._emulated_hand(world, stack)

            def see(X_color_depth: Array) -> Callable[[], Pictures | None]:
                state, boards = (lambda: world.call("scene")), cell.options.boards
                return SeenScene(cell.true, cell.tool, cell.seed, state, clock, X_color_depth, boards).pictures

            stream = stack.enter_context(emulated_stream(config.camera, clock, see))
            lab = stack.enter_context(
                LabStation(
                    replace(config, arm=replace(config.arm, host=host), hand=hand),
                    self._tell,
                    purpose=self._purpose,
                    real_time_factor=clock.real_time_factor,
                    doing=self._doing,
                    stream=stream,
                )
            )
            assert config.person is not None
            person = RehearsedPerson(
                lab.station.person, config.person, world.controller, world, clock, clamps=hand.model == MOUNT
            )
            self.station, self.judge = replace(lab.station, person=person), RemoteJudge(world)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    @contextmanager
    def blaming_the_machine(self) -> Iterator[None]:
        """Context in which late data and commands are said to be late because this machine is busy or slow.

        Every device is emulated here, so that nothing else delays them.

        Raises:
            DeviceError: The error that was raised inside, with that said first.
        """
        try:
            yield
        except DeviceError as error:
            if why := self.why_late(error):
                error.args = (f"{why}. What was late: {error}",)
            raise

    def why_late(self, error: DeviceError) -> str:
        """Say what an error of late data or commands has to do with this machine.

        Args:
            error: The error of an emulated device, or of the supervisor about the emulated person.

        Returns:
            The words, without a full stop; empty for an error that has other causes.
        """
        unsure = isinstance(error, PersonNearError) and UNSURE in str(error)
        if unsure or isinstance(error, StaleDataError | OverrunError) or error.code in _LATE:
            return (
                "data came late, because this machine is busy, or too slow for this rehearsal. Close other programs, "
                f"or give a --real-time-factor under {self._clock.real_time_factor:g}"
            )
        return ""

    def _set_up_robot(self, world: RemoteWorld) -> None:
        """Set the robot up as at the pendant: the payload that was weighed, and the serial number that is known."""
        config, controller = self._cell.measured, world.controller
        model = RobotModel.of_station(config).description
        payload = model.hand_payload(model.hand_open)
        controller.fault("payload", mass=payload.mass, cog=payload.center_of_mass.tolist())
        known = config.calibration
        controller.fault("serial", number=REHEARSED if known is None else known.robot_serial)

    def _emulated_hand(self, world: RemoteWorld, stack: ExitStack) -> HandConfig:
        hand = self._cell.measured.hand
        if hand.model == MOUNT:
            return hand
        model = RobotModel.of_station(self._cell.measured).description
        emulator = stack.enter_context(emulated_hand(hand, self._cell.seed, self._clock.real_time_factor))
        stack.enter_context(FingerCoupling(world, emulator, model.hand_open, model.hand.opposing.name))
        return replace(hand, port=emulator.port)


@contextmanager
def claimed_address() -> Iterator[str]:
    """Context that keeps a loopback address from other rehearsals.

    A controller listens seconds after its address was chosen, within which another rehearsal may begin.

    Yields:
        The address; no controller listens there.

    Raises:
        UserError: There is none.
    """
    for last in range(2, 255):
        host = f"127.0.0.{last}"
        with socket.socket(socket.AF_UNIX) as claim:
            try:
                claim.bind(f"\0toolee-rehearsal-{host}")  # a name without a file, which ends with the process
            except OSError:
                continue
            if all(_silent(host, port) for port in _PORTS):
                yield host
                return
    raise UserError("every loopback address has a controller. End those emulated controllers")


def _silent(host: str, port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((host, port)) != 0


def job_cell(config: StationConfig, station_file: Path, seed: int) -> Cell:
    """Draw a cell that a station file may describe, and a hammer.

    Args:
        config: What the station file says, from `load_lab_station`.
        station_file: The file.
        seed: Seed of hammer, grasp, and of the errors of what the station file says.

    Returns:
        The cell; the hammer's data are in `measured.tool`, instead of the file's.

    Raises:
        ConfigError: The file lacks what a job needs, or its calibration's record cannot be read or was altered.
    """
    check_purpose(config)
    errors = job_errors(config, station_file, seed)
    options = errors.options(SimOptions())
    tool, _ = draw_handover(seed, options)
    sheet = errors.measured(tool, f"{tool.kind.replace('_', ' ')} of the rehearsal")
    measured = replace(config, tool=sheet.unmeasured_as(config.tool))
    return Cell(errors.made_of(errors.displaced(config)), measured, tool, options, seed)


def job_errors(config: StationConfig, station_file: Path, seed: int) -> DrawnErrors:
    """Draw the errors of what a station file says.

    Args:
        config: What the station file says; it has a calibration.
        station_file: The file.
        seed: Seed of the job.

    Returns:
        The errors.

    Raises:
        ConfigError: The calibration's record cannot be read or was altered.
    """
    # What the hand weighs the file says itself, and the wrench is the controller's.
    sizes = replace(NOMINAL, payload=0.0, wrench=0.0)
    return draw_errors(sizes, seed, camera_covariance(config, station_file))


def camera_covariance(config: StationConfig, station_file: Path) -> Array:
    """Covariance of the camera's pose.

    Args:
        config: What the station file says; it has a calibration.
        station_file: The file.

    Returns:
        That of the calibration's record; of a calibration by another program, which tells a residual alone, one that
        is as large along each axis and turns the camera by as much at 1 m, (6, 6) [m, rad], axes of `base`.

    Raises:
        ConfigError: The record cannot be read or was altered.
    """
    assert config.calibration is not None, "checked before"
    if config.calibration.record is not None:
        return np.array(read_record(station_file.parent / config.calibration.record).covariance)
    return np.eye(6) * config.calibration.residual**2

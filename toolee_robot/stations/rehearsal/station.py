"""The station of a rehearsal."""

from __future__ import annotations

import socket
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

from toolee_robot.config import StationConfig
from toolee_robot.errors import ConfigError
from toolee_robot.hal import Station
from toolee_robot.robots import MOUNT
from toolee_robot.robots.hands.inspire import INSPIRE
from toolee_robot.runtime.clock import HostClock
from toolee_robot.runtime.cpu_keepalive import CpuKeepalive
from toolee_robot.sim_backend.inspire_hand import HandEmulator
from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.remote.station import RemoteJudge
from toolee_robot.sim_backend.remote.world import RemoteWorld
from toolee_robot.sim_backend.station import draw_handover
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.stations.driven_hand import SWITCH_INTERVAL
from toolee_robot.stations.lab import LabStation
from toolee_robot.stations.rehearsal.camera import emulated_stream
from toolee_robot.stations.rehearsal.cell import camera_covariance, draw_cell
from toolee_robot.stations.rehearsal.hand import FingerCoupling
from toolee_robot.stations.rehearsal.person import RehearsedPerson

EMULATED_HANDS = (INSPIRE,)
"""Hands that have an emulator."""
_PORTS = (29999, 30004)


class Rehearsal:
    """A lab's station with every device emulated, in front of the simulated cell of a seed; use it in its `with` block.

    Args:
        config: What the station file says, from `load_lab_station`.
        station_file: The file.
        tell: Shows a prompt to the person at the station.
        seed: Seed of hammer, grasp, and of the errors of what the station file says.
        real_time_factor: Rate of the station's time relative to wall-clock time.
        profile: How the arm's controller follows, measures and stops.

    Attributes:
        station: The devices; set inside the block.
        config: What the station file says, with the hammer that is handed over; what the job is given.
        tool: The hammer that is handed over.
        judge: Ground truth, for the evaluation after the job.

    Raises:
        ConfigError: The station file lacks what a job needs, or names a device that cannot be emulated.
    """

    station: Station

    def __init__(
        self,
        config: StationConfig,
        station_file: Path,
        tell: Callable[[str], object],
        seed: int,
        real_time_factor: float,
        profile: ProfileName = "harsh",
    ) -> None:
        LabStation(config, tell)  # refuses what is missing
        hand = config.hand.model
        if hand not in (*EMULATED_HANDS, MOUNT):
            raise ConfigError(
                f"the hand {hand!r} has no emulator, so that it cannot be rehearsed: those with one are "
                f"{', '.join(EMULATED_HANDS)}, and a {MOUNT} needs none",
                code="config.no_emulator",
            )
        options = SimOptions()
        self.tool, _ = draw_handover(seed, options)
        self._cell = draw_cell(config, camera_covariance(config, station_file), self.tool, seed)
        self.config = self._cell.measured
        self._tell, self._seed, self._clock = tell, seed, HostClock(real_time_factor)
        self.host = _free_address()
        self._world = RemoteWorld(self._cell.true, seed, options, self.host, self._clock, profile)
        self.judge = RemoteJudge(self._world)
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        """Start the emulators, and connect the drivers.

        Raises:
            UserError: An emulator cannot start.
            DeviceError: A driver cannot connect.
        """
        config, clock, world = self.config, self._clock, self._world
        calibration, person = config.calibration, config.person
        assert calibration is not None
        assert person is not None
        with ExitStack() as stack:
            stack.callback(sys.setswitchinterval, sys.getswitchinterval())
            sys.setswitchinterval(SWITCH_INTERVAL)
            stack.enter_context(CpuKeepalive())
            stack.enter_context(world)
            world.controller.fault("serial", number=calibration.robot_serial)
            hand = config.hand
            if hand.model == INSPIRE:
                emulator = stack.enter_context(HandEmulator(hand.hand_id, seed=self._seed, pace=clock.real_time_factor))
                stack.enter_context(FingerCoupling(world, emulator))
                hand = replace(hand, port=emulator.port)
            stream = stack.enter_context(
                emulated_stream(config, self._cell.true, self.tool, self._seed, lambda: world.call("scene"), clock)
            )
            lab = stack.enter_context(
                LabStation(
                    replace(config, arm=replace(config.arm, host=self.host), hand=hand),
                    self._tell,
                    real_time_factor=clock.real_time_factor,
                    stream=stream,
                )
            )
            person_acts = RehearsedPerson(
                lab.station.person, person, self._set_input, world, clock, clamps=hand.model == MOUNT
            )
            self.station = replace(lab.station, person=person_acts)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def _set_input(self, index: int, high: bool) -> None:
        self._world.controller.fault("digital_input", index=index, high=high)


def _free_address() -> str:
    """A loopback address on which no controller listens."""
    for last in range(2, 255):
        host = f"127.0.0.{last}"
        if all(_silent(host, port) for port in _PORTS):
            return host
    raise ConfigError("every loopback address has a controller: end those stand-ins", code="config.no_address")


def _silent(host: str, port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((host, port)) != 0

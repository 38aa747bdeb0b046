"""Sections of `toolee doctor`; the import takes seconds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

from toolee_robot.devices.hands import open_hand
from toolee_robot.devices.person import check_inputs, open_person
from toolee_robot.doctor.configuration import (
    check_calibration,
    check_contacts,
    check_limits,
    check_measured,
    check_reach,
    check_sides,
)
from toolee_robot.doctor.devices import check_camera, check_exposure, check_hand, check_lens, check_range
from toolee_robot.doctor.frames import check_base
from toolee_robot.doctor.machine import check_disk, check_processor, check_real_time, check_weights, examine_robot
from toolee_robot.errors import ConfigError, DeviceError, UserError
from toolee_robot.findings import Finding, warn
from toolee_robot.frames import Array
from toolee_robot.runtime.clock import HostClock, is_loopback
from toolee_robot.station import SIMULATED, UPRIGHT_WITHIN, StationConfig
from toolee_robot.stations.camera import open_camera
from toolee_robot.stations.lab import ur_driver

Section = tuple[str, list[Finding]]


@dataclass
class DoctorReport:
    """Runs the checks of `toolee doctor`.

    Attributes:
        config: Configuration of the station.
        host: Address of a UR controller; None for the simulated arm.
        out: Folder for recordings.
        jogged_point: The TCP that the teach pendant shows now, feature Base, (3,) [m]; None if nobody has read it.
        doing: Context manager that shows what is in progress.
        tell: Shows a prompt to the person whose door and switch are to be seen changing; None to see none of it.
        path: The station file; None for the simulated station.
        ask: Asks the person at the terminal for `jogged_point`; None to ask nobody.
        facts: Further results for --json.
    """

    config: StationConfig
    host: str | None
    out: Path
    jogged_point: Array | None
    doing: Callable[[str], AbstractContextManager[object]]
    tell: Callable[[str], object] | None = None
    path: Path | None = None
    ask: Callable[[], Array | None] | None = None
    facts: dict[str, Any] = field(default_factory=dict)
    _rate: float | None = field(default=None, init=False)
    _robot_serial: str | None = field(default=None, init=False)
    _camera_serial: str | None = field(default=None, init=False)

    def sections(self) -> Iterator[Section]:
        """Run the checks and yield the findings, section by section: the file first, which needs no device."""
        config = self.config
        with self.doing("planning"):
            findings = [check_base(config), check_sides(config), *check_limits(config), *check_contacts(config)]
            if config.arm.tilt <= UPRIGHT_WITHIN:  # what is planned takes z of `base` for straight up
                findings += check_reach(config)
            if config.camera.device is not None:
                findings.append(check_range(config))
            if self.host is not None:
                findings.insert(0, check_measured(self.path, is_loopback(self.host)))
        yield "Simulated station (no --station)" if self.path is None else "Station file", findings
        serials: tuple[str | None, str | None] = SIMULATED, SIMULATED
        if self.host is not None:
            yield from self._controller(self.host)
            serials = self._robot_serial, self._camera_serial
        yield "Calibration", [check_calibration(config, *serials, date.today(), self.host is not None)]
        with self.doing("loading the networks, trying the clock"):
            findings = [check_weights(), check_disk(self.out), *check_processor()]
            if self._rate is not None:
                findings += check_real_time(self._rate)
        yield "This computer", findings

    def _controller(self, host: str) -> Iterator[Section]:
        with self.doing(f"asking the robot at {host}"):
            robot = examine_robot(host, self.config, self.jogged_point)
        if self.ask is not None and robot.compares_points and (point := self.ask()) is not None:
            with self.doing("comparing it with the robot"):  # which the person has jogged meanwhile
                robot = examine_robot(host, self.config, point)
        self._rate, self._robot_serial = robot.rate, robot.serial
        own = robot.calibration
        self.facts |= {"robot_serial": robot.serial, "arm_calibration": None if own is None else asdict(own)}
        yield "Robot", robot.findings
        yield "Devices", list(self._own_devices())
        yield "Door and hold-to-run switch", list(self._person(host))

    def _person(self, host: str) -> Iterator[Finding]:
        """Check the person's inputs, with the station's own driver where somebody is there to change them."""
        name, config = "person", self.config
        if config.person is None:
            message = "the station file names no inputs for door and switch: no handover, and no fast motion"
            yield warn(name, message, "give `person`: docs/concepts/safety.md")
        elif self.tell is None:
            address = "" if host == config.arm.host else f" --robot-host {host}"
            remedy = f"before a handover: `toolee doctor --station {self.path}{address} --inputs`"
            yield warn(name, "door and hold-to-run switch were not seen to change", remedy)
        else:
            clock = HostClock()
            try:
                with ur_driver(config, host) as arm, open_person(config, arm, clock, self.tell) as person:
                    yield from check_inputs(person, clock, self.tell)
            except DeviceError as error:
                yield Finding.of_error(name, error, "first fix the faults of the robot")

    def _own_devices(self) -> Iterator[Finding]:
        """Check the station's own hand and camera; nothing moves."""
        unchecked = {
            "config.hand_driver": ("has no driver here: nothing was checked", "check it yourself"),
            "config.hand_port": ("the station file names no port: no job", "give hand.port"),
        }
        try:
            hand = open_hand(self.config.hand, HostClock())
            with self.doing("asking the hand"), hand:
                yield check_hand(hand, self.config)
        except (ConfigError, DeviceError) as error:
            if error.code in unchecked and self.config.hand.port is None:
                yield warn("hand", *unchecked[error.code])
            else:
                yield Finding.of_error("hand", error, "fix it, then check again")
        yield from self._own_camera()

    def _own_camera(self) -> Iterator[Finding]:
        if self.config.camera.device is None:
            yield warn("camera", "the station file names none: no job", "give camera.device")
            return
        clock = HostClock()
        try:
            with self.doing("asking the camera"), open_camera(self.config.camera, clock) as camera:
                self._camera_serial = camera.profile.serial
                yield from check_camera(camera, clock, self.config)
                yield from check_exposure(camera.read(), camera.profile.auto_exposure)
                yield check_lens(camera)
        except (UserError, DeviceError) as error:
            yield Finding.of_error("camera", error, "fix it, then check again")

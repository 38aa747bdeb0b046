"""A lab's station: every device by its own driver, as the station file says.

with LabStation(load_lab_station(Path("lab.yaml")), print) as lab:
    HammeringTask(lab.station, perception, lab.config, measured_grasp(lab.tool, lab.config)).run()

with open_arm(load_station(Path("lab.yaml")), "192.168.1.10", person) as arm:
    arm.execute(trajectory)
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from datetime import date
from enum import StrEnum
from typing import Any, Self

from toolee_robot.control import CollisionWorld, RobotModel, Supervisor
from toolee_robot.control.planning.views import DISTANCE
from toolee_robot.devices.cameras import CameraStream
from toolee_robot.devices.cameras.lens_choice import UNKNOWN_LENS
from toolee_robot.devices.hands import open_hand, wired_hand
from toolee_robot.devices.person import open_person
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.errors import ConfigError, NotReadyError
from toolee_robot.hal import Person, Station
from toolee_robot.robots import MOUNT
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import StationConfig, ToolData, check_upright
from toolee_robot.stations.camera import RECORDED, open_camera


def ur_driver(config: StationConfig, host: str, *, real_time_factor: float = 1.0) -> UnsupervisedUrArm:
    """Build the driver of a station's arm, for a `hal.Station`: a task puts it under a supervisor of its own.

    Args:
        config: Configuration of the station. The robot's installation must have the payload of the empty hand, and the
            TCP at the flange.
        host: Address of the controller.
        real_time_factor: Real-time factor of a stand-in; 1 for a robot.

    Returns:
        The driver, not yet entered. By itself it checks neither speed nor collisions nor people.

    Raises:
        ConfigError: The hand is unknown, or a parameter of the servo is out of range.
        UserError: The real-time factor is invalid for this host.
    """
    model = RobotModel.of_station(config).description
    payload = model.hand_payload(model.hand_open)
    settings = UrArmConfig(host, config.servo, payload=payload, tcp=(0.0,) * 6, real_time_factor=real_time_factor)
    return UnsupervisedUrArm(settings, config.arm)


def open_arm(config: StationConfig, host: str, person: Person) -> Supervisor:
    """Build a station's arm under the supervisor, with the hand empty.

    Args:
        config: Configuration of the station, as for `ur_driver`.
        host: Address of the controller.
        person: The person at the station.

    Returns:
        The supervisor, in HANDOVER mode, not yet entered. Entering it checks the robot and connects, which moves
        nothing, and raises what `hal.Arm` and the driver raise; leaving it ends the robot's program.

    Raises:
        ConfigError: The hand is unknown, or a parameter of the servo is out of range.
    """
    robot = RobotModel.of_station(config)
    world = CollisionWorld(robot, config, robot.description.hand_open)
    driver = ur_driver(config, host)
    return Supervisor(driver, person, robot, config, lambda: world)


class Purpose(StrEnum):
    """What a lab's devices are opened for."""

    JOB = "a job"
    CALIBRATION = "a calibration of the camera"


class LabStation:
    """The devices of a lab; use it in its `with` block. Entering it connects to all of them and moves nothing.

    Args:
        config: What the station file says, from `load_lab_station`.
        tell: Shows a prompt to the person at the station.
        purpose: What the devices are for.
        real_time_factor: Rate of the station's time relative to wall-clock time: 1, but for emulated devices.
        doing: Told what is connected to.
        stream: Stream of the camera instead of the one that the station file names, for an emulated camera.

    Attributes:
        station: The devices; set inside the block.

    Raises:
        ConfigError: As `check_purpose`.
    """

    station: Station

    def __init__(
        self,
        config: StationConfig,
        tell: Callable[[str], object],
        *,
        purpose: Purpose = Purpose.JOB,
        real_time_factor: float = 1.0,
        doing: Callable[[str], object] = lambda _: None,
        stream: CameraStream | None = None,
    ) -> None:
        check_purpose(config, purpose)
        self._purpose = purpose
        self.config, self._tell, self._factor, self._stream = config, tell, real_time_factor, stream
        self._doing = doing
        self._stack = ExitStack()

    @property
    def tool(self) -> ToolData:
        """The hammer that a person hands over."""
        assert self.config.tool is not None, "checked at the construction"
        return self.config.tool

    def __enter__(self) -> Self:
        """Connect to camera, hand, arm and the person's inputs, in this order: what fails most often fails first.

        Raises:
            ConfigError: A device has no driver here, or the station file lacks what its driver needs.
            NotReadyError: A device is there and not ready, or a camera is to be calibrated whose lens nobody knows; the
                message says what a person must do.
            DeviceError: A device does not answer.
        """
        config, clock = self.config, HostClock(self._factor)
        assert config.arm.host is not None, "checked at the construction"
        device = config.camera.device
        assert device is not None, "checked at the construction"
        with ExitStack() as stack:
            self._doing(f"connecting to the camera {device.serial} ({device.driver})")
            camera = stack.enter_context(open_camera(config.camera, clock, stream=self._stream))
            if self._purpose is Purpose.CALIBRATION and not camera.lens.lens.known:
                raise NotReadyError(
                    f"the camera {device.serial}: {camera.lens.words}, so its position can be millimetres off: "
                    f"{UNKNOWN_LENS}",
                    code="not_ready.camera_lens_unknown",
                )
            if config.hand.model != MOUNT:
                self._doing(f"connecting to the hand at {config.hand.port}")
            hand = stack.enter_context(open_hand(config.hand, clock))
            self._doing(f"connecting to the {config.arm.model} at {config.arm.host}")
            arm = stack.enter_context(ur_driver(config, config.arm.host, real_time_factor=self._factor))
            person = stack.enter_context(open_person(config, arm, clock, self._tell))
            self.station = Station(arm, hand, camera, person, clock, arm.serial or "", camera.profile.serial)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)


def check_purpose(config: StationConfig, purpose: Purpose = Purpose.JOB) -> None:
    """Refuse a station file that lacks what a purpose needs beyond what every motion needs.

    Args:
        config: What the station file says.
        purpose: What the devices are for.

    Raises:
        ConfigError: A field is missing, and the message names every one, such as `arm.host`;
            or the camera is a recording; or, for a job, the calibration is too old or of
            another camera than the file's, or the camera measures no depth at any view;
            or the arm's base is tilted (`config.mounting_tilted`).
    """
    wanted: dict[str, object] = {
        "arm.host": config.arm.host,
        "camera.device": config.camera.device,
        "person": config.person,
    }
    if purpose is Purpose.JOB:
        wanted |= {
            "calibration": config.calibration,
            "tool": config.tool,
        }
        if (kind := wired_hand(config.hand.model)) is not None:
            wanted["hand.port"] = config.hand.port
            if kind.measured_efforts:
                wanted["hand.efforts"] = config.hand.efforts
    if missing := [name for name, value in wanted.items() if value is None]:
        raise ConfigError(
            f"the station file lacks what {purpose} needs: give {', '.join(missing)}; docs/how-to/first_nail.md"
        )
    check_upright(config.arm, str(purpose))
    device, calibration = config.camera.device, config.calibration
    assert device is not None, "checked above"
    if purpose is Purpose.JOB and device.least_range > DISTANCE[1]:
        raise ConfigError(
            f"camera.device.least_range {device.least_range:g} m: the camera is too near to every view of "
            f"{purpose}, {DISTANCE[0]:.2f} to {DISTANCE[1]:.2f} m from it. Use a smaller depth image, which sees "
            "nearer things (camera.width, camera.height, intrinsics and least_range), or another camera"
        )
    if device.driver == RECORDED:
        raise ConfigError(
            f"camera.device.driver {RECORDED!r}: a recording cannot see {purpose}. Name the camera itself"
        )
    if purpose is Purpose.JOB and calibration is not None:
        # What the file alone tells; the task asks the devices themselves.
        problems = calibration.problems(calibration.robot_serial, device.serial, date.today())
        if problems:
            raise ConfigError(f"the camera's calibration is not valid: {'; '.join(problems)}")

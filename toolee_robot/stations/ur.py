"""The arm of a real station: a UR10 or UR10e with the settings of the station file.

with open_arm(load_station(Path("lab.yaml")), "192.168.1.10", person) as arm:
    arm.execute(trajectory)
"""

from __future__ import annotations

from toolee_robot.control import CollisionWorld, RobotModel, Supervisor
from toolee_robot.devices.ur.config import UrArmConfig
from toolee_robot.devices.ur.driver import UnsupervisedUrArm
from toolee_robot.hal import Person
from toolee_robot.station import StationConfig


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


def open_arm(config: StationConfig, host: str, person: Person, *, real_time_factor: float = 1.0) -> Supervisor:
    """Build a station's arm under the supervisor, with the hand empty.

    Args:
        config: Configuration of the station, as for `ur_driver`.
        host: Address of the controller.
        person: The person at the station.
        real_time_factor: Real-time factor of a stand-in; 1 for a robot.

    Returns:
        The supervisor, in HANDOVER mode, not yet entered. Entering it checks the robot and connects, which moves
        nothing, and raises what `hal.Arm` and the driver raise; leaving it ends the robot's program.

    Raises:
        ConfigError: The hand is unknown, or a parameter of the servo is out of range.
        UserError: The real-time factor is invalid for this host.
    """
    robot = RobotModel.of_station(config)
    world = CollisionWorld(robot, config, robot.description.hand_open)
    driver = ur_driver(config, host, real_time_factor=real_time_factor)
    return Supervisor(driver, person, robot, config, lambda: world)

"""Configuration of a station and of the job as frozen dataclasses, optionally loaded from a YAML station file.

    from toolee_robot.station import load_lab_station, load_station, sim_station
    config = sim_station()                   # the simulated station, sim.yaml
    config = load_station(Path("lab.yaml"))  # another station in simulation: any subset of the fields
    config = load_lab_station(Path("lab.yaml"))  # a real robot's: nothing that is measured has a default

The records hold everything that is measured once per station: the poses of camera, stand and nail, the limits, and the
calibration. Lengths are in metres and angles in radians unless a field states otherwise.
"""

from toolee_robot.station.calibration import REHEARSED, SIMULATED, SIMULATED_CALIBRATION, CalibrationConfig
from toolee_robot.station.cell import CameraConfig, CameraDevice, Obstacle, SceneConfig, ToolEnvelope
from toolee_robot.station.head import VERSION, check_current, is_current
from toolee_robot.station.job import StrikeConfig, SupervisorConfig, TaskConfig, ToolData
from toolee_robot.station.measured import (
    MEASURED,
    given_by_nails,
    given_by_pose,
    load_lab_station,
    unmeasured,
    write_measured,
)
from toolee_robot.station.measured_file import measured_path
from toolee_robot.station.robot import (
    STOP_ROOM,
    UPRIGHT,
    UPRIGHT_WITHIN,
    ArmLimits,
    HandConfig,
    PersonConfig,
    ServoConfig,
    check_upright,
    gravity_below,
    servo_lag,
)
from toolee_robot.station.station import (
    JobSetup,
    StationConfig,
    for_each_joint,
    load_station,
    read_station,
    sim_station,
    with_setup,
)
from toolee_robot.station.work import ONLY_NAIL, NailConfig, WorkConfig

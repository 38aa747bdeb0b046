"""The hardware abstraction: Protocols of the arm, hand, camera, person and clock that a task uses.

The simulation, the controller stand-in and real devices implement the same Protocols, none of which carries ground
truth. SI units and radians; every stamp is in seconds on the station's clock. Devices are context managers, and leaving
the context brings the device to a safe standstill. A device that cannot determine its state stands still and raises
`DeviceError`.
"""

from toolee_robot.hal.arm import (
    ZERO_TIME,
    Arm,
    ArmState,
    ArmStatus,
    ContactGuard,
    HandGuidedArm,
    MotionOutcome,
    MotionReport,
    MotionWatch,
)
from toolee_robot.hal.device import ClearsFaults, Clock, Device, Hand, HandState, KeepsCourse, RgbdCamera
from toolee_robot.hal.station import CLEAR_TIME, Person, Station, wait_until_clear

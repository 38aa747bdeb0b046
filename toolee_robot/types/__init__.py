"""Frozen records that the stages exchange. SI units and radians; poses are 4x4 arrays named X_AB."""

from toolee_robot.types.arm import (
    MOUNT,
    ArmModel,
    DhCalibration,
    HandEfforts,
    HandMounting,
    HandWeight,
    JointState,
    Payload,
    Six,
    ToolMount,
    Trajectory,
)
from toolee_robot.types.perception import (
    CameraError,
    CameraIntrinsics,
    Detection,
    HeldRegion,
    HoldingHand,
    InHandEstimate,
    PoseHypotheses,
    RgbdFrame,
    ToolEstimate,
)

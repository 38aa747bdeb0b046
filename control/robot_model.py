"""Model of arm and hand: Pinocchio model, kinematics of the arm, payload of the flange."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pinocchio as pin

from toolee_robot.control.inverse_kinematics import InverseKinematics
from toolee_robot.control.kinematics import ArmKinematics
from toolee_robot.errors import AssetError, UserError
from toolee_robot.frames import Array, inverse, is_rigid
from toolee_robot.robots import SHADOW_HAND, HandChoice, RobotDescription, load_robot
from toolee_robot.station import UPRIGHT, StationConfig, gravity_below
from toolee_robot.types import ArmModel, DhCalibration, Payload


class RobotModel:
    """Kinematic model of an arm with 6 joints and a hand with n joints, wrist included.

    `base` is the root of the URDF, the UR's base_link.

    Args:
        description: Names, URDF and meshes of arm and hand.
        up: Direction straight up in `base`, as `ArmLimits.up`.

    Attributes:
        description: Names, URDF and meshes of arm and hand.
        model: The Pinocchio model.
        arm: Batched kinematics of the arm.
        ik: Inverse kinematics of the arm.

    Raises:
        AssetError: Pinocchio cannot read the URDF, or it is no UR arm (`asset.kinematics`).
    """

    def __init__(self, description: RobotDescription, up: tuple[float, float, float] = UPRIGHT) -> None:
        self.description = description
        try:
            self.model = pin.buildModelFromXML(description.urdf)
        except ValueError as error:
            raise AssetError(f"Pinocchio cannot read the {description.hand.label} on the arm: {error}") from error
        self.model.gravity.linear = gravity_below(up)
        self._data = self.model.createData()
        self._flange = self.model.getFrameId(description.flange_frame)
        self._hand = self.model.getFrameId(description.hand_frame)
        # Pinocchio sorts sibling joints by name: map by name, never by order.
        names = (*description.arm_joints, *description.hand_joints)
        self._order = np.array([self.model.joints[self.model.getJointId(name)].idx_q for name in names])
        # The description's base is the model's root: a UR's base_link.
        self.arm = ArmKinematics.from_pinocchio(self.model, description.flange_frame, np.eye(4))
        self.ik = InverseKinematics(self.arm)

    @staticmethod
    def load(
        model: ArmModel = ArmModel.UR10,
        calibration: DhCalibration | None = None,
        hand: str | HandChoice = SHADOW_HAND.name,
        up: tuple[float, float, float] = UPRIGHT,
    ) -> RobotModel:
        """Load the model of an arm with a hand; the result is cached.

        Args:
            model: Model of the arm.
            calibration: Factory calibration of the arm; None for the nominal kinematics.
            hand: Name of the hand, one of `robots.HANDS`; or what a station file says of it.
            up: Direction straight up in `base`, as `ArmLimits.up`.

        Returns:
            The model.

        Raises:
            ConfigError: The hand is unknown.
            AssetError: A file is missing or unreadable.
        """
        return _load(load_robot(model, calibration, hand), up)

    @staticmethod
    def of_station(config: StationConfig) -> RobotModel:
        """Load the model of a station's arm and hand; errors as `load`."""
        return RobotModel.load(config.arm.model, config.arm.calibration, config.hand, config.arm.up)

    def configuration(self, q_arm: Array, q_hand: Array) -> Array:
        """Assemble Pinocchio's configuration vector.

        Args:
            q_arm: Joint positions of the arm, (6,) [rad].
            q_hand: Joint positions of the hand in the description's order, wrist first, (n,) [rad].

        Returns:
            The configuration in Pinocchio's joint order, (6 + n,) [rad].

        Raises:
            UserError: The shapes are wrong.
        """
        n_arm, n_hand = len(self.description.arm_joints), len(self.description.hand_joints)
        if q_arm.shape != (n_arm,) or q_hand.shape != (n_hand,):
            raise UserError(
                f"q_arm {q_arm.shape} and q_hand {q_hand.shape} must be ({n_arm},) and ({n_hand},): "
                "give the hand's joints in the order of the description, wrist first",
                code="user.joint_count",
            )
        q = np.empty(self.model.nq)
        q[self._order] = np.concatenate([q_arm, q_hand])
        return q

    def fk(self, q_arm: Array, q_hand: Array) -> tuple[Array, Array]:
        """Compute the forward kinematics.

        Args:
            q_arm: Joint positions of the arm, (6,) [rad].
            q_hand: Joint positions of the hand, wrist first, (n,) [rad].

        Returns:
            X_base_flange and X_base_hand, (4, 4) each.
        """
        pin.framesForwardKinematics(self.model, self._data, self.configuration(q_arm, q_hand))
        return self._data.oMf[self._flange].homogeneous, self._data.oMf[self._hand].homogeneous

    def X_flange_hand(self, q_hand: Array) -> Array:
        """Pose of the palm in the flange, (4, 4), which the wrist joints of q_hand, (n,) [rad], determine."""
        X_base_flange, X_base_hand = self.fk(np.zeros(6), q_hand)
        return inverse(X_base_flange) @ X_base_hand

    def X_base_ee(self, q_arm: Array, q_hand: Array, X_hand_ee: Array) -> Array:
        """Compute the pose of the tool's end effector in `base`.

        Args:
            q_arm: Joint positions of the arm, (6,) [rad].
            q_hand: Joint positions of the hand, wrist first, (n,) [rad].
            X_hand_ee: Pose of the end effector in the hand, (4, 4).

        Returns:
            X_base_ee, (4, 4).
        """
        return self.fk(q_arm, q_hand)[1] @ X_hand_ee

    def payload(self, q_hand: Array, X_hand_tool: Array, mass: float, p_tool_com: Array) -> Payload:
        """Compute the mass properties of hand and tool on the flange.

        Args:
            q_hand: Joint positions of the hand, wrist first, (n,) [rad].
            X_hand_tool: Pose of the tool in the hand, (4, 4).
            mass: Mass of the tool [kg].
            p_tool_com: Centre of mass of the tool in its own frame, (3,) [m].

        Returns:
            Mass [kg] and centre of mass in the flange frame [m].

        Raises:
            UserError: X_hand_tool is not a rigid transform.
        """
        if not is_rigid(X_hand_tool):
            raise UserError("X_hand_tool is not a rigid transform", code="user.not_rigid")
        hand = self.description.hand_payload(q_hand)
        p_tool = (self.X_flange_hand(q_hand) @ X_hand_tool @ np.append(p_tool_com, 1.0))[:3]
        total = hand.mass + mass
        return Payload(total, (hand.mass * hand.center_of_mass + mass * p_tool) / total)


@lru_cache(maxsize=4)
def _load(description: RobotDescription, up: tuple[float, float, float]) -> RobotModel:
    return RobotModel(description, up)

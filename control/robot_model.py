"""The robot as the controller sees it: a Pinocchio model of arm and hand, the arm's kinematics, what it carries."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pinocchio as pin

from toolee_robot.config import StationConfig
from toolee_robot.control.inverse_kinematics import InverseKinematics
from toolee_robot.control.kinematics import ArmKinematics
from toolee_robot.errors import AssetError, UserError
from toolee_robot.frames import Array, inverse, is_rigid
from toolee_robot.robots import SHADOW_HAND, RobotDescription, load_robot
from toolee_robot.types import ArmModel, DhCalibration, Payload


class RobotModel:
    """Arm (6 joints) and hand (n joints, wrist included). `base` is the URDF's root, the UR's base_link.

    arm: batched kinematics of the arm. ik: all its inverse-kinematics branches. description: names and meshes.
    """

    def __init__(self, description: RobotDescription) -> None:
        self.description = description
        try:
            self.model = pin.buildModelFromUrdf(str(description.urdf_path))
        except ValueError as error:
            raise AssetError(f"Pinocchio cannot read {description.urdf_path}: {error}") from error
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
        model: ArmModel = ArmModel.UR10, calibration: DhCalibration | None = None, hand: str = SHADOW_HAND.name
    ) -> RobotModel:
        """An arm with a hand, built once; arguments and errors as `load_robot`'s."""
        return _load(load_robot(model, calibration, hand))

    @staticmethod
    def of_station(config: StationConfig) -> RobotModel:
        """The station's arm and hand. Raises ConfigError for an unknown hand, AssetError for missing files."""
        return RobotModel.load(config.arm.model, config.arm.calibration, config.hand.model)

    def configuration(self, q_arm: Array, q_hand: Array) -> Array:
        """Pinocchio's q (6 + n,) from q_arm (6,) and q_hand (n,) in the description's order."""
        n_arm, n_hand = len(self.description.arm_joints), len(self.description.hand_joints)
        if q_arm.shape != (n_arm,) or q_hand.shape != (n_hand,):
            raise UserError(
                f"q_arm {q_arm.shape} and q_hand {q_hand.shape} must be ({n_arm},) and ({n_hand},): "
                "give the hand's joints in the order of the description, wrist first"
            )
        q = np.empty(self.model.nq)
        q[self._order] = np.concatenate([q_arm, q_hand])
        return q

    def fk(self, q_arm: Array, q_hand: Array) -> tuple[Array, Array]:
        """X_base_flange and X_base_hand (4x4 each) from q_arm (6,), q_hand (n,) [rad], wrist included."""
        pin.framesForwardKinematics(self.model, self._data, self.configuration(q_arm, q_hand))
        return self._data.oMf[self._flange].homogeneous, self._data.oMf[self._hand].homogeneous

    def X_flange_hand(self, q_hand: Array) -> Array:
        """The palm in the flange, 4x4; depends on the wrist joints of q_hand (n,)."""
        X_base_flange, X_base_hand = self.fk(np.zeros(6), q_hand)
        return inverse(X_base_flange) @ X_base_hand

    def X_base_ee(self, q_arm: Array, q_hand: Array, X_hand_ee: Array) -> Array:
        """The tool's end effector in `base`, 4x4."""
        return self.fk(q_arm, q_hand)[1] @ X_hand_ee

    def payload(self, q_hand: Array, X_hand_tool: Array, mass: float, p_tool_com: Array) -> Payload:
        """What the flange carries: the hand, and a tool of `mass` [kg] with its centre of mass p_tool_com (3,) [m]."""
        if not is_rigid(X_hand_tool):
            raise UserError("X_hand_tool is not a rigid transform")
        hand = self.description.hand_payload(q_hand)
        p_tool = (self.X_flange_hand(q_hand) @ X_hand_tool @ np.append(p_tool_com, 1.0))[:3]
        total = hand.mass + mass
        return Payload(total, (hand.mass * hand.center_of_mass + mass * p_tool) / total)


@lru_cache(maxsize=4)
def _load(description: RobotDescription) -> RobotModel:
    return RobotModel(description)

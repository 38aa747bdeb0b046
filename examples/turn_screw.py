"""A task of one's own: take a screwdriver from the person, look at it, set its tip on a screw, turn it."""

import numpy as np

from examples.plan_turn import HEIGHT, plan_place
from toolee_robot import Category, StationConfig, ToolPerception
from toolee_robot.control.limits import Mode
from toolee_robot.control.planning.turn import plan_turn
from toolee_robot.control.planning.views import plan_handover, plan_views
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.errors import GripError
from toolee_robot.frames import Array, inverse
from toolee_robot.hal import Station
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.types import HoldingHand, Payload

SCREWDRIVER = Payload(0.15, np.zeros(3))  # mass [kg] and centre of mass in the tip's frame [m]


class TurnScrew:
    """X_hand_ee: the tip in a nominal grasp. Nothing moves past `motions`, whose `arm` is the supervisor."""

    def __init__(self, station: Station, perception: ToolPerception, config: StationConfig, X_hand_ee: Array) -> None:
        self.station, self.perception, self.config = station, perception, config
        self.robot = RobotModel.of_station(config)
        self.motions = Motions(station, config, self.robot, TaskObserver())
        self.nominal = HeldTool.nominally(X_hand_ee, SCREWDRIVER)

    def run(self, X_base_screw: Array, angle: float) -> None:
        """Turn the screw about its z, which points into the wood, by `angle` [rad]: clockwise if positive."""
        self.motions.begin()
        self.take_tool()
        held = self.look(self.nominal)
        m, axis, point = self.motions, X_base_screw[:3, 2], X_base_screw[:3, 3]
        m.transfer("above the screw", plan_place(self.robot, self.config, m, held, X_base_screw, angle), held)
        m.straight("down", (0.0, 0.0, -1.0), HEIGHT, held)
        turn = plan_turn(self.robot, self.config, m.world(held), m.q, axis, point, angle, speed=0.5)
        m.execute("turn", turn, held, at_work=True)
        m.straight("up", (0.0, 0.0, 1.0), HEIGHT, held)

    def take_tool(self) -> None:
        """Raises GripError when no tool is in the hand, or the person stays."""
        m, hand, person = self.motions, self.station.hand, self.motions.person
        hand.open()
        m.transfer("to the handover", plan_handover(self.robot, self.config, m.world(None), m.q, m.q_hand), None)
        handed = person.request_handover("Put the screwdriver into the open hand.", timeout=30.0)
        hand.close()
        if not (handed and person.release("Let go and step back.", timeout=30.0) and hand.state().holding):
            raise GripError("the hand holds no tool, or the person did not step back")
        m.arm.mode = Mode.UNATTENDED

    def look(self, held: HeldTool, views: int = 3) -> HeldTool:
        """The tool as the camera sees it. Raises PerceptionError when it does not see the tip."""
        m, seen, hands = self.motions, [], []
        R_hand_tool = self.robot.description.hand.grasp.R_hand_tool
        for view in plan_views(
            self.robot, self.config, m.world(held), m.q, m.q_hand, held.X_nominal, count=views
        ).views:
            m.transfer("to a view", view.transfer, held)
            self.station.clock.sleep(0.3)  # until arm and tool have stopped swinging
            hands.append(inverse(self.config.camera.X_base_camera) @ self.robot.fk(m.q, m.q_hand)[1])
            seen.append(self.perception.estimate(self.station.camera.read(), HoldingHand(hands[-1], R_hand_tool)))
        return held.moved(self.perception.fuse(seen, hands, Category.SCREWDRIVER_HEAD).X_hand_ee)


if __name__ == "__main__":
    print(__doc__)

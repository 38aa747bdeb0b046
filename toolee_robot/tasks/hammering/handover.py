"""The tool comes into the hand from a person, and goes back to a person; in between the person is out of reach."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.limits import Mode
from toolee_robot.control.planning.strike import plan_strike
from toolee_robot.control.planning.views import plan_handover
from toolee_robot.control.tool_weight import ToolWeight
from toolee_robot.errors import (
    DeviceError,
    LatchedError,
    NotReadyError,
    PersonNearError,
    PlanningError,
    UnreachableError,
)
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.motions import Motions
from toolee_robot.tasks.common.outcome import JobEnded, Outcome, Stage
from toolee_robot.tasks.hammering.grasp import Grasp
from toolee_robot.tasks.hammering.weighing import Weighing
from toolee_robot.types import Payload


@dataclass(frozen=True)
class Prompts:
    """What a person is asked to do.

    Attributes:
        give: At the handover.
        take: To take the tool back.
    """

    give: str
    take: str


_HAND = Prompts(
    "Put the hammer's handle into the open hand, face towards the fingertips.",
    "Hold the hammer firmly and confirm. The hand then opens.",
)
_MOUNT = Prompts(
    "Fix the hammer's handle in the mount, face towards its working side. Pull at it, then confirm.",
    "Take the hammer out of the mount, then confirm.",
)
_ELSEWHERE = "The hand holds nothing. Put the handle in again, 2 to 4 cm nearer to the head or to the butt."
"""What is said after the hand has closed on nothing."""
CLOSINGS = 5
"""How often the hand closes until it holds the tool."""
UNKNOWN_GIVE = " Its head is then 15 to 28 cm from the middle of the grip."
"""What is said beside the prompt of a tool whose face was not measured."""
MOUNT_EMPTY = "The mount cannot sense a tool. Is it empty? The arm is about to move to the handover."
"""Question before the arm moves an empty mount."""
_RESET = (
    "The arm does not move: {}. Check robot, hand and tool. Leave and close the door. Make the robot ready from "
    "outside of its reach. Then confirm, and the arm is reset; this moves nothing."
)


class Handover:
    """Handover of the tool, in both directions.

    A door on the robot's safeguard input stops the robot when the person comes. The arm is reset as after any other
    stop, once a person has looked and confirmed it, and they are then seen out of reach once more.

    Args:
        motions: The arm and its motions.
        grasp: Nominal grasp of the tool.
        nails: Names of the nails that will be struck.
        prompts: What a person is asked to do; None for a hammer.

    Attributes:
        person_clear: Whether nobody was asked to come near since a person was last seen out of reach.
    """

    def __init__(self, motions: Motions, grasp: Grasp, nails: Sequence[str], prompts: Prompts | None = None) -> None:
        self.person_clear = True
        self._motions, self._grasp, self._nails, self._weighing = motions, grasp, nails, Weighing(motions)
        self._station, self._config, self._robot = motions.station, motions.config, motions.robot
        self._prompts = prompts or (_MOUNT if motions.robot.description.hand.clamps else _HAND)

    @property
    def weight(self) -> ToolWeight | None:
        """What the arm has weighed of the tool; None before, or if it was told."""
        return self._weighing.weight

    def take_tool(self) -> HeldTool:
        """Bring the empty hand to the handover, close it around the tool, and see the person out of reach.

        A hand that closed on nothing opens, and the person puts the handle in at another place. A mount neither closes
        nor senses the tool: the person fixes it and says so.

        Returns:
            The tool as it is nominally held, weighed if nobody has told its weight.

        Raises:
            JobEnded: No tool was handed over, or the hand does not hold it.
            TooleeError: A motion or a device failed, or the person stays.
        """
        hand, grasp = self._station.hand, self._grasp
        held = HeldTool.nominally(grasp.X_hand_ee, grasp.swung, grasp.ee_off)
        with self._motions.stages(Stage.HANDOVER):
            self._check_reach()
            if self._empty_hand():
                self._once_reset(self._go_there)
            else:
                self._go_there()
            if grasp.to_weigh:
                self._weighing.feel_empty_hand(grasp, held)
            self._ask_for_tool(self._prompts.give + (UNKNOWN_GIVE if grasp.ee_off else ""))
        with self._motions.stages(Stage.GRIP):
            hand.close()
            for _ in range(CLOSINGS - 1):
                if hand.state().holding:
                    break
                hand.open()
                self._ask_for_tool(_ELSEWHERE)
                hand.close()
            if not hand.state().holding:
                raise JobEnded(
                    Outcome.NO_GRIP, f"the hand closed {CLOSINGS} times and holds nothing. Run the job again"
                )
            self.clear_person("Let go and step back.")
            if not hand.state().holding:
                raise JobEnded(Outcome.NO_GRIP, "the tool left the hand when it was released. Hand it over again")
            self._motions.carry(held)
        return self.tell_payload(held)

    def _ask_for_tool(self, prompt: str) -> None:
        self.person_clear = False
        if not self._motions.person.request_handover(prompt, self._config.task.handover_timeout):
            raise JobEnded(Outcome.NO_HANDOVER, "nobody handed a tool over in time. Run the job again")

    def tell_payload(self, held: HeldTool) -> HeldTool:
        """Tell the arm that it carries the tool; an arm that was stopped since the person came is reset by a person.

        A tool that nobody has weighed is weighed first.

        Args:
            held: What the hand holds.

        Returns:
            The same, with what was weighed.

        Raises:
            PersonNearError: The person who has looked at the stopped arm was not seen out of reach.
            DeviceError: The arm does not take the payload, or a person did not confirm its reset.
            WeighingError: The tool cannot be weighed, or not well enough.
        """
        q_hand = self._motions.q_hand
        if self._grasp.to_weigh:
            self._tell(self._robot.description.hand_payload(q_hand))
            with self._motions.stages(Stage.WEIGH):
                self._grasp, held = self._weighing.weigh(self._grasp, held)
        grasp = self._grasp
        self._tell(self._robot.payload(q_hand, grasp.X_hand_tool, grasp.mass, grasp.p_tool_com))
        return held

    def _tell(self, payload: Payload) -> None:
        if self._once_reset(lambda: self._motions.set_payload(payload)):
            self._permit_fast()

    def _go_there(self) -> None:
        q_hand = self._motions.q_hand
        world = CollisionWorld(self._robot, self._config, q_hand)
        way = plan_handover(self._robot, self._config, world, self._motions.q, q_hand, tool_off=self._grasp.ee_off)
        self._motions.transfer("to the handover", way, None)

    def clear_person(self, prompt: str) -> None:
        """Ask the person to step back, and allow fast motion once they were seen out of reach.

        Args:
            prompt: Instruction for the person.

        Raises:
            PersonNearError: They did not confirm it in time, or were not seen out of reach.
        """
        self._see_out(prompt)
        self._permit_fast()

    def _permit_fast(self) -> None:
        self._motions.arm.mode = Mode.UNATTENDED
        self.person_clear = True

    def _see_out(self, prompt: str) -> None:
        self.person_clear = False
        if not self._motions.person.release(prompt, self._config.task.handover_timeout):
            raise PersonNearError("nobody confirmed to be out of reach, or somebody is within reach: no motion")

    def _once_reset(self, act: Callable[[], None]) -> bool:
        """Do something that the arm refuses after a stop: a person looks, makes the robot ready, and is seen out again.

        Args:
            act: What to do.

        Returns:
            Whether the arm was reset; it is in HANDOVER mode then.

        Raises:
            PersonNearError: They were not seen out of reach.
            DeviceError: They did not confirm it, or the robot is not ready.
        """
        try:
            act()
        except (LatchedError, NotReadyError) as stopped:
            if not self._motions.person.confirm_inspection(_RESET.format(stopped), self._config.task.handover_timeout):
                raise
        else:
            return False
        self._motions.arm.reset(confirmed=True)
        self._motions.begin()
        self._motions.wait_for_readings()  # of a real arm's inputs, whose connection is a new one
        self._see_out("The arm is reset. Stay out of its reach.")
        act()
        return True

    def give_back(self) -> bool:
        """Open the hand at standstill, once a person has confirmed that they hold the tool. Nothing else moves.

        A mount does not open: there the person confirms that they have taken the tool out.

        Returns:
            Whether the hand was opened; without a confirmation it keeps its grip.

        Raises:
            DeviceError: The hand did not open.
        """
        self._motions.stand_still()
        self.person_clear = False
        if not self._motions.person.take_tool(self._prompts.take, self._config.task.handover_timeout):
            return False
        self._station.hand.open()
        self.tool_gone()
        return True

    def tool_gone(self) -> None:
        """Note that the hand is empty, and tell the arm as much: it carries the hammer no longer."""
        self._motions.carry(None)
        with suppress(DeviceError):  # a stopped arm may take no payload; the next job sets it
            self._motions.set_payload(self._robot.description.hand_payload(self._motions.q_hand))

    def _empty_hand(self) -> bool:
        """Open the hand; a person takes a tool that it still holds first, so that it does not fall.

        Whether a mount is empty, only a person knows.

        Returns:
            Whether a person was asked, who may have opened a door that stops the arm.
        """
        if self._robot.description.hand.clamps:
            if not self._motions.person.confirm_inspection(MOUNT_EMPTY, self._config.task.handover_timeout):
                raise JobEnded(Outcome.NOT_READY, "nobody confirmed that the mount is empty. Take the tool out of it")
            self._station.hand.open()
            return True
        asked = self._station.hand.state().holding
        if asked:
            self.person_clear = False
            prompt = "The hand still holds a tool. Hold it; the hand opens."
            if not self._motions.person.take_tool(prompt, self._config.task.handover_timeout):
                raise JobEnded(Outcome.NOT_READY, "the hand still holds a tool. Take it out first")
        self._station.hand.open()
        return asked

    def _check_reach(self) -> None:
        """Refuse a nail that is out of reach before a tool is requested.

        Other failures are only reported: a collision depends on the tool's true pose in the hand.
        """
        q_hand = self._robot.description.hand_closed
        world = CollisionWorld(self._robot, self._config, q_hand, self._grasp.X_hand_ee)
        state = self._motions.q, q_hand, self._grasp.X_hand_ee
        for name in self._nails:
            X_base_nail = self._config.work.only(name).X_base_nail()
            whose = f"nail {name}: " if len(self._nails) > 1 else ""
            try:
                plan_strike(self._robot, self._config, world, *state, X_base_nail, tool=self._grasp.swung)
            except UnreachableError as error:
                if self._grasp.ee_off:  # the face may be elsewhere
                    self._motions.observer.message(
                        f"{whose}with the face in the middle of its expected region: {error}"
                    )
                    continue
                raise UnreachableError(f"{whose}{error}", code=error.code) from error
            except PlanningError as error:
                message = f"{whose}no strike is possible with the tool as it is expected to lie in the hand: {error}"
                self._motions.observer.message(message)

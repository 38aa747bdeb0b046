"""The motions of an arm's bring-up, shown to a person and confirmed before they begin."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Protocol

from toolee_robot.control import CollisionWorld, Mode, RobotModel, Supervisor
from toolee_robot.devices.person import check_wired, open_person
from toolee_robot.errors import DeviceError, PersonNearError, UserError
from toolee_robot.frames import Array
from toolee_robot.hal import MotionOutcome, Person, wait_until_clear
from toolee_robot.runtime.clock import HostClock
from toolee_robot.station import StationConfig
from toolee_robot.stations.lab import open_arm, ur_driver
from toolee_robot.tasks.bring_up.acceleration import STEPS, AccelerationTrial, raise_acceleration, turn_about
from toolee_robot.tasks.bring_up.lag import PAIRS, Trial, lag_motion, tune
from toolee_robot.tasks.bring_up.slow_motions import Caps, MotionFrame, SlowStation, plan_line
from toolee_robot.tasks.bring_up.touch import Touch, approach, measured_settings
from toolee_robot.tasks.common.watches import PersonProof
from toolee_robot.types import Trajectory


class Attendant(Person, Protocol):
    """A person who confirms each motion, and stops it."""

    def confirm(self, question: str) -> None:
        """Ask whether the arm may move; raises PersonNearError if not."""

    def attending(self) -> AbstractContextManager[None]:
        """Context of what was confirmed."""


@dataclass(frozen=True)
class BringUp:
    """A robot at a person's disposal.

    Attributes:
        arm: The arm, under the supervisor.
        slow: The station under its caps.
        person: Who confirms its motions.
    """

    arm: Supervisor
    slow: SlowStation
    person: Attendant

    @property
    def q(self) -> Array:
        """Joint positions that the arm holds, (6,) [rad]."""
        return self.arm.state().q_commanded

    def move(self, trajectory: Trajectory) -> Array:
        """Execute a motion once the person has confirmed it.

        Args:
            trajectory: The motion, from rest to rest.

        Returns:
            Measured joint positions after it, (6,) [rad].

        Raises:
            PersonNearError: It was not confirmed, or was stopped by the person.
            DeviceError: The arm was stopped.
            TooleeError: What `Supervisor.execute` raises.
        """
        self.person.confirm("Move?")
        with self.person.attending():
            report = self.arm.execute(trajectory)
        if report.outcome is not MotionOutcome.COMPLETED:
            raise DeviceError("the arm was stopped during the motion")
        return report.q_measured[-1]

    def touch(
        self,
        way: Array,
        frame: MotionFrame,
        speed: float,
        force: float | None,
        show: Callable[[Trajectory, float, float], None],
    ) -> Touch | None:
        """Approach until the arm feels a force, and go back.

        Args:
            way: Longest way of the flange, (3,) [m].
            frame: Its frame.
            speed: Speed [m/s]; a noisy force lowers it.
            force: Force that ends the approach [N]; None for the station's. A noisy force raises it.
            show: Shows the plan, its force [N] and speed [m/s], before the person is asked.

        Returns:
            The contact; None if nothing was felt on the whole way.

        Raises:
            TooleeError: The way is out of reach, the person does not confirm, or the arm was stopped.
        """
        strike = self.slow.config.strike
        settings = measured_settings(self.arm, strike, strike.touch_force if force is None else force)
        speed = min(speed, settings.speed)
        plan = plan_line(self.slow, self.q, way, frame, speed)
        show(plan, settings.force, speed)
        self.person.confirm("Move?")
        with self.person.attending():
            return approach(self.arm, self.slow, plan, settings)


@contextmanager
def open_bring_up(station: StationConfig, host: str, person: Attendant, caps: Caps) -> Iterator[BringUp]:
    """Check the robot and connect, which moves nothing; leaving the context ends its program.

    Args:
        station: The station.
        host: Address of the robot's controller.
        person: Who confirms its motions.
        caps: How fast it may move.

    Yields:
        The robot.

    Raises:
        TooleeError: A cap is no number, or the robot is not ready.
    """
    slow = SlowStation.of(station, caps)
    with open_arm(slow.config, host, person) as arm:
        yield BringUp(arm, slow, person)


def tune_servo(
    station: StationConfig,
    host: str,
    person: Attendant,
    caps: Caps,
    joint: int,
    show: Callable[[BringUp, Trajectory, float], None],
) -> Iterator[Trial]:
    """Try servo settings from gentle to sharp, until one is bad.

    Args:
        station: The station.
        host: Address of the robot's controller.
        person: Who confirms the motions, once.
        caps: How fast it may move.
        joint: Number of the joint that moves, 1 to 6.
        show: Shows the largest motion and its reach to either side [rad], before the person is asked.

    Yields:
        The trials in their order.

    Raises:
        TooleeError: The robot is not ready, or a motion was refused, not confirmed or stopped.
    """

    @contextmanager
    def open_with(gain: float, lookahead: float) -> Iterator[Supervisor]:
        servo = replace(station.servo, gain=gain, lookahead=lookahead, lag=None)
        with open_bring_up(replace(station, servo=servo), host, person, caps) as robot:
            yield robot.arm

    with open_bring_up(station, host, person, caps) as robot:
        limits = robot.slow.config.arm
        motion = lag_motion(robot.q, joint, limits.velocity[joint - 1], limits)
        show(robot, motion.trajectory, motion.reach)
    person.confirm("Move?")
    with person.attending():
        yield from tune(open_with, SlowStation.of(station, caps), joint, PAIRS)


OUT_OF_REACH = (
    "Each joint will turn fast, with nothing in the hand or mount. Open the door once, and check that the hand is open "
    "and empty. Leave, close the door, and make the robot ready again from outside."
)
OUT_OF_REACH_TIME = 180.0
"""Time for that [s]."""


def try_accelerations(
    station: StationConfig,
    host: str,
    joints: Sequence[int],
    most: float,
    show: Callable[[SlowStation, Sequence[Trajectory]], None],
    tell: Callable[[str], object],
    person: Person | None = None,
) -> Iterator[AccelerationTrial]:
    """Move joint after joint with rising accelerations, in UNATTENDED mode.

    Args:
        station: The station.
        host: Address of the robot's controller.
        joints: Numbers of the joints, 1 to 6.
        most: Largest acceleration [rad/s^2]; it replaces `arm.acceleration` of the station.
        show: Shows the largest motion of each joint before the person is asked.
        tell: Shows a question to the person.
        person: Who answers for an emulated robot; None for the person at the station's door and switch, whose inputs
            are seen to change first.

    Yields:
        The trials in their order. They end at a stop of the arm.

    Raises:
        UserError: There is no such joint, or the acceleration is out of range.
        PersonNearError: Nobody confirmed to be out of reach, or somebody is there.
        TooleeError: The station file names no inputs of door and switch, the robot is not ready, or a motion failed.
    """
    if not (joints and all(1 <= joint <= 6 for joint in joints) and STEPS[0] <= most <= STEPS[-1]):
        raise UserError(f"give joints 1 (base) to 6 (wrist 3), and {STEPS[0]:g} to {STEPS[-1]:g} rad/s² at most")
    config = replace(station, arm=replace(station.arm, acceleration=(most,) * 6, transfer_acceleration=most))
    robot = RobotModel.of_station(config)
    unattended = SlowStation(station, config, robot, CollisionWorld(robot, config, robot.description.hand_open))
    clock = HostClock()
    if person is None:
        check_wired(config)  # before anything is connected
    with ExitStack() as stack:
        driver = stack.enter_context(ur_driver(config, host))
        if person is None:
            person = PersonProof(stack.enter_context(open_person(config, driver, clock, tell)))
        arm = Supervisor(driver, person, robot, config, lambda: unattended.world)
        q = arm.state().q_commanded
        show(unattended, [turn_about(q, joint, most, config.arm.jerk) for joint in joints])
        if not person.release(OUT_OF_REACH, OUT_OF_REACH_TIME):
            raise PersonNearError("nobody confirmed that everybody is out of reach: nothing was moved")
        arm.reset(confirmed=True)  # the open door has stopped it
        if not wait_until_clear(person.zone_occupied, clock, OUT_OF_REACH_TIME):
            raise PersonNearError("somebody is within reach: nothing was moved")
        arm.mode = Mode.UNATTENDED
        for joint in joints:
            yield from raise_acceleration(arm, unattended, joint, most)
            if arm.latched:
                return

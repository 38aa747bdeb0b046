"""The supervisor: checks every command before it reaches the arm, and monitors every motion.

    arm = Supervisor(station.arm, station.person, robot, config, world=lambda: CollisionWorld(robot, config, q_hand))
    arm.execute(trajectory)                          # HANDOVER: slow, a person holds the hold-to-run switch
    arm.mode = Mode.UNATTENDED                       # refused while a person is in reach
    arm.permit_swings(timeout=30.0)                  # a person confirms that strikes may begin
    report, verdict = arm.swing(strike, guard, plan.expected_contact)

It rejects commands and never clips them. It is ordinary software and does not replace the robot's own safety system.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Self

from toolee_robot.control.arm_dynamics import ArmDynamics, bound_stop
from toolee_robot.control.collision import BRAKE_EXEMPT, RUN_UP_EXEMPT, CollisionWorld
from toolee_robot.control.contact import ContactVerdict, ExpectedContact, judge_contact
from toolee_robot.control.limits import Mode
from toolee_robot.control.motion.trajectory_checks import check_start
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.control.supervisor_checks import (
    Watcher,
    check_clear,
    check_limits,
    check_momentum,
    check_place,
    check_ready,
    check_speed,
    is_finite,
    why_person_forbids,
)
from toolee_robot.errors import DeviceError, LatchedError, LimitError, MotionFaultError, PersonNearError
from toolee_robot.hal import Arm, ArmState, ContactGuard, HandGuidedArm, MotionReport, MotionWatch, Person
from toolee_robot.station import StationConfig
from toolee_robot.types import Payload, Trajectory

UNKNOWN_OCCUPANCY = "the station cannot tell whether a person is near"
"""Reason of a stop when the station's person detection fails."""


class Supervisor:
    """A `hal.Arm` that wraps another one and checks every command.

    Before a motion it checks the latch; the limits of joints, workspace and speed; start, status and age of the arm's
    data; that no person is where they must not be; and that nothing collides along the trajectory. During the motion
    the arm's own `MotionWatch` and the person detection are active. The errors are, in this order, LatchedError,
    LimitError, StaleDataError, NotReadyError, PersonNearError and CollisionError before anything moves, and
    MotionFaultError or PersonNearError after the arm has stopped. A stop brakes no harder than the joints' torques
    permit with the payload that was set, see `dynamics.torque_room`.

    A fault latches, and so does a command with NaN or infinite values: nothing moves until a person confirms
    `reset(confirmed=True)`, which never clears a protective stop.

    Args:
        arm: The arm to protect.
        person: The person at the station.
        robot: Kinematic model of arm and hand.
        config: Configuration of the station.
        world: Builds the collision model of the present state; called at every motion.
    """

    def __init__(
        self,
        arm: Arm,
        person: Person,
        robot: RobotModel,
        config: StationConfig,
        world: Callable[[], CollisionWorld],
    ) -> None:
        self._arm, self._person = arm, person
        self._robot, self._config = robot, config
        self._world = world
        self._mode = Mode.HANDOVER
        self._swings_permitted = False
        self._payload: Payload | None = None
        self._latched = ""

    def __enter__(self) -> Self:
        self._arm.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._arm.__exit__(*error)

    @property
    def rate(self) -> float:
        """Command rate [Hz]; see `hal.Arm`."""
        return self._arm.rate

    @property
    def mode(self) -> Mode:
        """Mode of operation, initially HANDOVER. Every change revokes the permission to swing.

        Raises:
            PersonNearError: It is set to UNATTENDED while somebody is within reach.
        """
        return self._mode

    @mode.setter
    def mode(self, mode: Mode) -> None:
        if mode is Mode.UNATTENDED and self._person.zone_occupied():
            message = "somebody is within the arm's reach: it stays in handover mode"
            raise PersonNearError(message, code="person_near.zone_occupied")
        self._mode, self._swings_permitted = mode, False

    @property
    def latched(self) -> str:
        """The fault that has not been reset; empty if none."""
        return self._latched

    def permit_swings(self, timeout: float) -> None:
        """Ask a person whether strikes may begin, once until the mode changes.

        Args:
            timeout: Time to answer [s].

        Raises:
            PersonNearError: They did not confirm it.
        """
        if self._swings_permitted or not self._config.supervisor.ask_before_swing:
            return
        prompt = "The arm is about to swing, fast. Is everybody out of its reach?"
        if not self._person.confirm_swing(prompt, timeout):
            message = "nobody confirmed that the arm may swing: no motion"
            raise PersonNearError(message, code="person_near.swing_not_confirmed")
        self._swings_permitted = True

    def state(self, max_age: float = 0.1) -> ArmState:
        """Return the newest state; see `hal.Arm`."""
        return self._arm.state(max_age)

    def execute(
        self,
        trajectory: Trajectory,
        guard: ContactGuard | None = None,
        watch: MotionWatch | None = None,
        *,
        at_work: bool = False,
    ) -> MotionReport:
        """Check and execute a trajectory; see `hal.Arm.execute`.

        Args:
            trajectory: Motion of the 6 joints from rest to rest.
            guard: Contact detection; None for none.
            watch: Bounds checked in every cycle; None for the configured ones.
            at_work: Whether the tool may touch block and stand; nothing else may ever touch anything.

        Returns:
            What was commanded and measured.

        Raises:
            TooleeError: As listed at the class.
        """
        world = self._check(trajectory)
        check_clear(trajectory.q, world, BRAKE_EXEMPT if at_work else frozenset())
        return self._move(trajectory, world, guard, watch)

    def swing(
        self, trajectory: Trajectory, guard: ContactGuard, expected: ExpectedContact
    ) -> tuple[MotionReport, ContactVerdict]:
        """Execute a strike; before the expected contact only the tool's head may come near the block.

        Args:
            trajectory: Motion of the 6 joints from rest to rest.
            guard: Contact detection.
            expected: Where and when the tool should meet the work.

        Returns:
            What was commanded and measured, and how the strike met the work.

        Raises:
            PersonNearError: The swing was not permitted, or a person is near.
            LimitError: The expected contact is not on the trajectory, or a limit is violated.
            TooleeError: As `execute`.
        """
        world = self._check(trajectory)
        config = self._config.supervisor
        if self._mode is not Mode.UNATTENDED or not (self._swings_permitted or not config.ask_before_swing):
            message = "nobody has confirmed that the arm may swing: no motion"
            raise PersonNearError(message, code="person_near.swing_not_permitted")
        if not 0.0 < expected.time < trajectory.duration:
            message = f"the strike should meet the nail at {expected.time:.3f} s, which is not on its way"
            raise LimitError(message, code="limit.contact_time")
        before = trajectory.times <= expected.time
        check_clear(trajectory.q[before], world, RUN_UP_EXEMPT)
        check_clear(trajectory.q[~before], world, BRAKE_EXEMPT)
        report = self._move(trajectory, world, guard, None)
        return report, judge_contact(report, expected, self._robot.arm, config)

    def set_payload(self, payload: Payload) -> None:
        """Tell the arm what its flange carries; see `hal.Arm`."""
        self._arm.set_payload(payload)
        self._payload = payload

    def zero_wrench(self) -> None:
        """Zero the force reading at standstill; see `hal.Arm`.

        Raises:
            LatchedError: A fault has not been reset.
            NotReadyError: The robot is not ready or moves.
            DeviceError: The arm cannot zero it.
        """
        self._check_at_rest()
        self._arm.zero_wrench()

    @contextmanager
    def freedrive(self) -> Iterator[None]:
        """Let a person move the arm by hand inside this context, in HANDOVER mode; see `hal.HandGuidedArm`.

        Raises:
            LatchedError: A fault has not been reset.
            NotReadyError: The robot is not ready or moves.
            PersonNearError: The mode is not HANDOVER, or the person does not hold the switch at the beginning.
            DeviceError: The arm cannot be moved by hand, or refuses.
        """
        self._check_at_rest()
        reason = self._reason_to_stop() if self._mode is Mode.HANDOVER else f"the arm is in {self._mode} mode"
        if reason:
            raise PersonNearError(f"{reason}: no freedrive", code="person_near.freedrive")
        if not isinstance(self._arm, HandGuidedArm):
            raise DeviceError("this arm cannot be moved by hand: use a motion", code="device.no_freedrive")
        with self._arm.freedrive():
            yield

    def stop(self) -> None:
        """Stop the arm, from any thread; see `hal.Arm`."""
        self._arm.stop()

    def reset(self, *, confirmed: bool = False) -> None:
        """Clear the latch and return to HANDOVER mode.

        Args:
            confirmed: Whether a person has inspected the robot, and has made it ready again where it had stopped
                itself.

        Raises:
            DeviceError: The reset was not confirmed, or the robot is not ready.
        """
        if not confirmed:
            message = "a reset needs a person who has looked at the robot: confirm it"
            raise DeviceError(message, code="device.reset_not_confirmed")
        self._arm.reset()
        self._latched = ""
        self._mode, self._swings_permitted = Mode.HANDOVER, False

    def _check(self, trajectory: Trajectory) -> CollisionWorld:
        """All checks but that for collisions."""
        self._check_latch()
        config = self._config
        if not is_finite(trajectory):
            # The caller's computation is broken: latch, so that none of its later commands is executed either.
            self._arm.stop()
            self._latch("a command held NaN or infinite values")
            message = f"{self._latched}: nothing was sent; find out where they come from, then reset"
            raise LimitError(message, code="limit.not_finite")
        world = self._world()
        check_limits(trajectory, self._robot, config, world)
        check_speed(trajectory, world, self._mode.speed(config.supervisor), self._mode)
        state = self._arm.state(config.supervisor.max_data_age)
        check_ready(state)
        check_place(state)
        check_start(trajectory, state.q_commanded)
        reason = self._reason_to_stop()
        if reason:
            raise PersonNearError(f"{reason}: no motion", code="person_near.before_motion")
        return world

    def _check_at_rest(self) -> None:
        self._check_latch()
        check_ready(self._arm.state(self._config.supervisor.max_data_age))

    def _check_latch(self) -> None:
        if self._latched:
            raise LatchedError(f"{self._latched}: nothing moves until a person has looked and reset it")

    def _reason_to_stop(self) -> str:
        """Why a person forbids motion in this mode; empty if they do not."""
        return why_person_forbids(self._person, self._mode)

    def _move(
        self, trajectory: Trajectory, world: CollisionWorld, guard: ContactGuard | None, watch: MotionWatch | None
    ) -> MotionReport:
        config = self._config.supervisor
        watch = watch or MotionWatch(config.tracking_error, config.data_cycles, config.overruns)
        dynamics = ArmDynamics.with_payload(self._robot, world.q_hand, self._payload)
        check_momentum(trajectory, dynamics, config.momentum)
        trajectory = bound_stop(trajectory, dynamics, self._config.arm.model)
        try:
            with Watcher(self._reason_to_stop, self._arm.stop, UNKNOWN_OCCUPANCY) as person:
                report = self._arm.execute(trajectory, guard, watch)
        except MotionFaultError as fault:
            self._latch(str(fault))
            raise
        if person.reason:
            if self._mode is Mode.UNATTENDED:
                self._latch(person.reason)
            raise PersonNearError(f"{person.reason}: the arm was stopped", report, code="person_near.during_motion")
        return report

    def _latch(self, reason: str) -> None:
        self._latched = reason
        self._swings_permitted = False

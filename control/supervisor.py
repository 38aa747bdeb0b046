"""The supervisor: every command of the arm passes it, and nothing that could do harm gets through.

    arm = Supervisor(station.arm, station.person, robot, config, world=lambda: CollisionWorld(robot, config, q_hand))
    arm.execute(trajectory)                          # HANDOVER: slow, a person attends
    arm.mode = Mode.HAMMERING                        # nobody in reach, or it is refused
    arm.permit_swings(timeout=30.0)                  # a person says that strikes may begin
    report, verdict = arm.swing(strike, guard, ExpectedContact(q_contact, direction, contact_time))

It rejects; it never clips. None of it replaces the robot's own safety system: it is software that runs on a computer.
"""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Self

from toolee_robot.config import StationConfig
from toolee_robot.control.collision import BRAKE_EXEMPT, RUN_UP_EXEMPT, CollisionWorld
from toolee_robot.control.contact import ContactVerdict, ExpectedContact, judge_contact
from toolee_robot.control.modes import Mode
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.control.supervisor_checks import (
    check_clear,
    check_limits,
    check_place,
    check_ready,
    check_speed,
    is_finite,
)
from toolee_robot.control.watcher import Watcher
from toolee_robot.errors import DeviceError, LatchedError, LimitError, MotionFaultError, PersonNearError
from toolee_robot.hal import Arm, ArmState, ContactGuard, MotionReport, MotionWatch, Person
from toolee_robot.motion.trajectory_checks import check_start
from toolee_robot.types import Payload, Trajectory

UNKNOWN_OCCUPANCY = "the station cannot tell whether a person is near"


class Supervisor:
    """A `hal.Arm` around another one. world: what must not collide as things are when a motion is asked for.

    Before a motion: latched or not; limits of joints, workspace and speed; start, status and age of the arm's data;
    nobody where they must not be; no collision anywhere on the way. During it: the arm's own `MotionWatch`, and the
    person. Raises, in this order, LatchedError, LimitError, StaleDataError, NotReadyError, PersonNearError,
    CollisionError before anything moves; MotionFaultError or PersonNearError after the arm has stopped.

    A fault latches, and so does a command with NaN or infinite values: nothing moves until `reset(confirmed=True)`,
    said by a person. It never clears a protective stop.
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
        self._latched = ""

    def __enter__(self) -> Self:
        self._arm.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._arm.__exit__(kind, error, trace)

    @property
    def rate(self) -> float:
        """See `hal.Arm`."""
        return self._arm.rate

    @property
    def mode(self) -> Mode:
        """HANDOVER until a person has stepped back. Every change takes the permission to swing away."""
        return self._mode

    @mode.setter
    def mode(self, mode: Mode) -> None:
        """Raises PersonNearError, and the mode stays, when somebody is in reach and UNATTENDED is asked for."""
        if mode is Mode.UNATTENDED and self._person.zone_occupied():
            raise PersonNearError("somebody is within the arm's reach: it stays in handover mode")
        self._mode, self._swings_permitted = mode, False

    @property
    def latched(self) -> str:
        """The fault that nobody has reset yet; empty if none."""
        return self._latched

    def permit_swings(self, timeout: float) -> None:
        """Ask a person whether strikes may begin; once for this mode. Raises PersonNearError if they do not say so
        within `timeout` [s]."""
        if self._swings_permitted or not self._config.supervisor.ask_before_swing:
            return
        prompt = "The arm is about to swing, fast. Is everybody out of its reach?"
        if not self._person.confirm_swing(prompt, timeout):
            raise PersonNearError("nobody confirmed that the arm may swing: no motion")
        self._swings_permitted = True

    def state(self, max_age: float = 0.1) -> ArmState:
        """See `hal.Arm`."""
        return self._arm.state(max_age)

    def execute(
        self,
        trajectory: Trajectory,
        guard: ContactGuard | None = None,
        watch: MotionWatch | None = None,
        *,
        at_work: bool = False,
    ) -> MotionReport:
        """See `hal.Arm` and the class. at_work: the tool may touch block and stand; nothing else ever may. watch: the
        configured bounds if None."""
        world = self._check(trajectory)
        check_clear(trajectory.q, world, BRAKE_EXEMPT if at_work else frozenset())
        return self._move(trajectory, guard, watch)

    def swing(
        self, trajectory: Trajectory, guard: ContactGuard, expected: ExpectedContact
    ) -> tuple[MotionReport, ContactVerdict]:
        """A strike, and whether it met what it was meant for where that was expected. Before the expected contact only
        the tool's head may come near the block. Raises as `execute`, and PersonNearError without `permit_swings`."""
        world = self._check(trajectory)
        config = self._config.supervisor
        if self._mode is not Mode.UNATTENDED or not (self._swings_permitted or not config.ask_before_swing):
            raise PersonNearError("nobody has confirmed that the arm may swing: no motion")
        if not 0.0 < expected.time < trajectory.duration:
            raise LimitError(f"the strike should meet the nail at {expected.time:.3f} s, which is not on its way")
        before = trajectory.times <= expected.time
        check_clear(trajectory.q[before], world, RUN_UP_EXEMPT)
        check_clear(trajectory.q[~before], world, BRAKE_EXEMPT)
        report = self._move(trajectory, guard, None)
        return report, judge_contact(report, expected, self._robot.arm, config)

    def set_payload(self, payload: Payload) -> None:
        """See `hal.Arm`."""
        self._arm.set_payload(payload)

    def stop(self) -> None:
        """See `hal.Arm`; from any thread."""
        self._arm.stop()

    def reset(self, *, confirmed: bool = False) -> None:
        """Take the latch off: `confirmed` says that a person has looked at the robot, and has made it ready again where
        it had stopped itself. Afterwards the mode is HANDOVER. Raises DeviceError otherwise."""
        if not confirmed:
            raise DeviceError("a reset needs a person who has looked at the robot: confirm it")
        self._arm.reset()
        self._latched = ""
        self._mode, self._swings_permitted = Mode.HANDOVER, False

    def _check(self, trajectory: Trajectory) -> CollisionWorld:
        """Everything but the collisions."""
        if self._latched:
            raise LatchedError(f"{self._latched}: nothing moves until a person has looked and reset it")
        config = self._config
        if not is_finite(trajectory):
            # Whoever sends this computes with rubbish: nothing else of theirs is carried out either.
            self._arm.stop()
            self._latch("a command held NaN or infinite values")
            raise LimitError(f"{self._latched}: nothing was sent; find out where they come from, then reset")
        check_limits(trajectory, self._robot, config)
        world = self._world()
        check_speed(trajectory, world, self._mode.speed(config.supervisor), self._mode)
        state = self._arm.state(config.supervisor.max_data_age)
        check_ready(state)
        check_place(state)
        check_start(trajectory, state.q_commanded)
        reason = self._reason_to_stop()
        if reason:
            raise PersonNearError(f"{reason}: no motion")
        return world

    def _reason_to_stop(self) -> str:
        """Why a person forbids motion in this mode; empty if they do not."""
        if self._mode is Mode.UNATTENDED:
            return "somebody is within the arm's reach" if self._person.zone_occupied() else ""
        return (
            "" if self._person.enabling_switch_held() else "the person at the station does not hold the enabling switch"
        )

    def _move(self, trajectory: Trajectory, guard: ContactGuard | None, watch: MotionWatch | None) -> MotionReport:
        config = self._config.supervisor
        watch = watch or MotionWatch(config.tracking_error, config.data_cycles, config.overruns)
        try:
            with Watcher(self._reason_to_stop, self._arm.stop, UNKNOWN_OCCUPANCY) as person:
                report = self._arm.execute(trajectory, guard, watch)
        except MotionFaultError as fault:
            self._latch(str(fault))
            raise
        if person.reason:
            if self._mode is Mode.UNATTENDED:
                self._latch(person.reason)
            raise PersonNearError(f"{person.reason}: the arm was stopped", report)
        return report

    def _latch(self, reason: str) -> None:
        self._latched = reason
        self._swings_permitted = False

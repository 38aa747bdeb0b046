"""What a task moves: the arm from one standstill to the next, with a tool only while the hand holds it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress

import numpy as np

from toolee_robot.config import StationConfig
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.contact import ContactVerdict
from toolee_robot.control.modes import slowed_to
from toolee_robot.control.planning.strike import plan_straight
from toolee_robot.control.records import StrikePlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.control.supervisor import Supervisor
from toolee_robot.control.supervisor_checks import AT_REST
from toolee_robot.errors import DeviceError, MotionFaultError, PlanningError
from toolee_robot.frames import Array
from toolee_robot.hal import ContactGuard, MotionOutcome, MotionReport, Station
from toolee_robot.tasks.common.hand_watch import HandWatch, check_held
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.types import Trajectory

UP = (0.0, 0.0, 1.0)
STRAIGHT_SPEED = 0.25  # [m/s]
QUIET_TIME, QUIET_STEP, QUIET_PATIENCE = 0.1, 0.02, 2.0  # [s]
STILL_PATIENCE = 1.0
"""[s] for an arm that a contact has left swinging against what it touches; the supervisor refuses one that goes on."""
RETREAT, RETREAT_SPEED = 0.20, 0.15  # [m], [m/s]


class Motions:
    """The arm and what it carries. `arm` is the supervisor: nothing goes to the station's arm past it.

    q: joints (6,) [rad] that the arm holds; known after `begin`. X_hand_ee: 4x4, where the working end is believed to
    be. held: whether the hand has taken the tool.
    """

    q: Array

    def __init__(
        self,
        station: Station,
        config: StationConfig,
        robot: RobotModel,
        observer: TaskObserver,
        X_hand_ee: Array,
    ) -> None:
        self.X_hand_ee = X_hand_ee
        self.held = False
        self.arm = Supervisor(station.arm, station.person, robot, config, self.world)
        self._station = station
        self._config = config
        self._robot = robot
        self._observer = observer

    def begin(self) -> None:
        """Read where the arm holds itself. Raises StaleDataError when it does not say."""
        self.q = self.arm.state().q_commanded

    @property
    def q_hand(self) -> Array:
        """The hand's joints (n,) as measured now, wrist included."""
        return self._station.hand.state().joints.q

    @property
    def X_base_ee(self) -> Array:
        """The working end as believed, 4x4, where the arm stands."""
        return self._robot.X_base_ee(self.q, self.q_hand, self.X_hand_ee)

    def world(self) -> CollisionWorld:
        """What must not collide, as things are now."""
        return CollisionWorld(self._robot, self._config, self.q_hand, self.X_hand_ee if self.held else None)

    def execute(
        self, name: str, trajectory: Trajectory, guard: ContactGuard | None = None, *, at_work: bool = False
    ) -> MotionReport:
        """Move. Raises GripError when the tool is lost before or on the way, DeviceError when the hand that holds it
        complains or falls silent; the arm brakes at once. Raises what the supervisor raises; DeviceError when the arm
        was stopped."""
        with self._watched(name) as hand:
            report = self.arm.execute(trajectory, guard, at_work=at_work)
        self._done(name, report, hand)
        return report

    def transfer(self, name: str, trajectory: Trajectory) -> None:
        """Move through free space, slowed to what the mode allows. Raises as `execute`."""
        self.execute(name, slowed_to(trajectory, self.world(), self.arm.mode.speed(self._config.supervisor)))

    def swing(self, name: str, plan: StrikePlan) -> tuple[MotionReport, ContactVerdict]:
        """The strike of a plan, as planned or not at all. Raises as `execute`."""
        self.check_hand()
        guard = ContactGuard(self._config.strike.contact_force, ignore_before=0.5 * plan.contact_time)
        with self._watched(name) as hand:
            report, verdict = self.arm.swing(plan.strike, guard, plan.expected_contact)
        self._done(name, report, hand)
        return report, verdict

    def straight(self, name: str, direction: tuple[float, float, float], length: float) -> None:
        """Along a direction of `base` by a length [m], orientation kept; the tool may be at the work."""
        if abs(length) > 1e-4:
            world = self.world()
            speed = min(STRAIGHT_SPEED, 0.95 * self.arm.mode.speed(self._config.supervisor))
            move = plan_straight(self._robot, self._config, world, self.q, length, direction, speed)
            self.execute(name, move, at_work=True)

    def retreat(self) -> None:
        """The tool has dropped: slowly away from the person's place and up, or up, or not at all."""
        self.held = False
        with suppress(DeviceError):
            away = self._robot.fk(self.q, self.q_hand)[1][:3, 3] - np.asarray(self._config.scene.person_center)
            away[2] = 0.0
            x, y, _ = away / max(float(np.linalg.norm(away)), 1e-6)
            for direction in ((float(x), float(y), 1.0), UP):
                with suppress(PlanningError):
                    world = self.world()
                    move = plan_straight(self._robot, self._config, world, self.q, RETREAT, direction, RETREAT_SPEED)
                    self.execute("retreat", move)
                    return

    def wait_until_quiet(self, force: float) -> bool:
        """Stand until the arm has felt less than `force` [N] for QUIET_TIME: a tool that still swings would pass for a
        contact. False when it does not calm down within QUIET_PATIENCE."""
        quiet = 0.0
        for _ in range(int(QUIET_PATIENCE / QUIET_STEP)):
            self._station.clock.sleep(QUIET_STEP)
            felt = float(np.linalg.norm(self.arm.state().wrench[:3]))
            quiet = quiet + QUIET_STEP if felt < force else 0.0
            if quiet >= QUIET_TIME:
                return True
        return False

    def check_hand(self) -> None:
        """Raises DeviceError when the hand complains or is too hot: no further strike then; GripError without a
        tool."""
        hand, most = self._station.hand, self._config.supervisor.max_hand_temperature
        check_held(hand)
        state = hand.state()
        if state.temperature is not None and not state.temperature <= most:  # NaN included
            raise DeviceError(f"the hand is at {state.temperature:.0f} deg C, {most:.0f} are allowed: let it cool down")

    def stand_still(self) -> None:
        """Stop arm and fingers, as far as they can still be told; the hand keeps its grip."""
        for device in (self.arm, self._station.hand):
            with suppress(DeviceError):
                device.stop()

    @contextmanager
    def _watched(self, name: str) -> Iterator[HandWatch | None]:
        """A motion: from a standstill, with the tool still in the hand, all the way; what a fault leaves of it is told
        to the observer, too."""
        self._wait_until_still()
        watch = HandWatch(self._station.hand, self.arm.stop) if self.held else None
        if self.held:
            check_held(self._station.hand)
        try:
            with watch or nullcontext():
                yield watch
        except MotionFaultError as fault:
            if fault.report is not None and len(fault.report.stamps):
                self.q = fault.report.q_commanded[-1]
                with suppress(DeviceError):
                    self._report(name, fault.report)
            raise

    def _wait_until_still(self) -> None:
        with suppress(DeviceError):  # an arm that does not say is refused by the supervisor, which knows more reasons
            for _ in range(int(STILL_PATIENCE / QUIET_STEP)):
                if np.abs(self.arm.state().joints.qd).max() < AT_REST:
                    return
                self._station.clock.sleep(QUIET_STEP)

    def _done(self, name: str, report: MotionReport, hand: HandWatch | None) -> None:
        # The commanded position is what the arm holds and what the next motion must start from; a servo has a lag, but
        # none at rest.
        self.q = report.q_commanded[-1]
        self._report(name, report)
        if hand is not None and hand.error is not None:
            raise hand.error
        if report.outcome is MotionOutcome.STOPPED:
            raise DeviceError(f"the arm was stopped during the motion {name!r}")
        if self.held:
            check_held(self._station.hand)

    def _report(self, name: str, report: MotionReport) -> None:
        # However old the hand's state is: one that has fallen silent must not keep a motion out of the record.
        self._observer.motion(name, report, self._station.hand.state(max_age=np.inf).joints.q)

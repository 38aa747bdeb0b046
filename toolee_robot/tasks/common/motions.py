"""Motions of a task: from one standstill to the next, under the supervisor, with the hand's grip monitored."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress

import numpy as np
from numpy.typing import ArrayLike

from toolee_robot.control.arm_dynamics import ArmDynamics
from toolee_robot.control.collision import CollisionWorld
from toolee_robot.control.collision_shapes import Body
from toolee_robot.control.contact import ContactVerdict
from toolee_robot.control.limits import Mode, slowed_by, slowed_to
from toolee_robot.control.motion.contact_force import strike_guard, swing_sway
from toolee_robot.control.motion.touch_force import wrenches_at_rest
from toolee_robot.control.planning.straight import plan_straight, rise_to_clear
from toolee_robot.control.records import StrikePlan
from toolee_robot.control.robot_model import RobotModel
from toolee_robot.control.supervisor import Supervisor
from toolee_robot.control.supervisor_checks import AT_REST
from toolee_robot.errors import DeviceError, GripDoubtError, MotionFaultError, PersonNearError, PlanningError
from toolee_robot.frames import Array, inverse
from toolee_robot.hal import ContactGuard, KeepsCourse, MotionOutcome, MotionReport, Station
from toolee_robot.station import StationConfig, check_upright
from toolee_robot.tasks.common.held_tool import HeldTool
from toolee_robot.tasks.common.observer import Stages, TaskObserver
from toolee_robot.tasks.common.watches import HandWatch, PersonProof, check_held
from toolee_robot.types import Payload, Trajectory

UP = (0.0, 0.0, 1.0)
"""Straight up in `base`, which stands upright."""
STRAIGHT_SPEED = 0.25
"""Largest speed of a straight motion [m/s]."""
STILL_STEP, STILL_PATIENCE = 0.02, 1.0
"""Polling period and longest wait for an arm that oscillates after a contact [s]; the supervisor refuses one that still
moves."""
READINGS_PATIENCE = 1.0
"""Longest wait for the person's inputs before a motion, where they are not certain [s]: a late reading or a bounce is
no person, and would end a job."""
RETREAT, RETREAT_SPEED = 0.20, 0.15
"""Length [m] and speed [m/s] of the retreat after the tool has dropped."""
HOLD_SWITCH = "Release the hold-to-run switch, then hold it: the arm moves slowly."
"""Prompt before every motion in HANDOVER mode."""


class Motions:
    """The arm, and the motions with what the hand holds. Every command passes the supervisor.

    What is held is told with each motion; None for an empty hand.

    Args:
        station: The devices of the station.
        config: Configuration of the station.
        robot: Kinematic model of arm and hand.
        observer: Receives the motions.

    Raises:
        ConfigError: The arm's base is tilted (`config.mounting_tilted`).

    Attributes:
        station: The devices of the station.
        config: Configuration of the station.
        robot: Kinematic model of arm and hand.
        observer: Receives the motions, and other events of the task.
        stages: Times the stages of the task.
        arm: The supervisor around the station's arm.
        person: The person at the station, whose inputs must be seen to change before the arm moves fast.
        q: Joint positions that the arm holds, (6,) [rad]; set by `begin`.
        carried: The tool in the hand as told last; None where the hand is empty.
        in_the_way: Bodies of the work that nothing may touch, beside those of the station.
        payload: What the flange carries; None before it was set.
        noise: Readings of the force at rest, one a cycle, (N, 3) [N]; None before they were taken.
        readied: How often `begin` was called: at the job's begin and after every reset.
    """

    q: Array

    def __init__(self, station: Station, config: StationConfig, robot: RobotModel, observer: TaskObserver) -> None:
        check_upright(config.arm, "a task")
        self.station, self.config, self.robot, self.observer = station, config, robot, observer
        self.stages = Stages(observer)
        self.carried: HeldTool | None = None
        self.in_the_way: tuple[Body, ...] = ()
        self.payload: Payload | None = None
        self.noise: Array | None = None
        self.readied = 0
        self._zeroed: Array | None = None
        self._q_hand_seen: Array = np.zeros(len(robot.description.hand_joints))
        self.person = PersonProof(station.person)
        self.arm = Supervisor(station.arm, self.person, robot, config, self._carried_world)

    def begin(self) -> None:
        """Read the joint positions that the arm holds.

        Raises:
            StaleDataError: The arm's data is too old.
        """
        self.q = self.arm.state().q_commanded
        self._zeroed = None  # a reset may have undone it
        self.readied += 1

    @property
    def q_hand(self) -> Array:
        """Measured joint positions of the hand, wrist first, (n,) [rad]."""
        self._q_hand_seen = self.station.hand.state().joints.q
        return self._q_hand_seen

    def X_base_ee(self, held: HeldTool) -> Array:
        """Estimated pose of the held tool's end effector in `base`, (4, 4)."""
        return self.robot.X_base_ee(self.q, self.q_hand, held.X_hand_ee)

    def world(self, held: HeldTool | None) -> CollisionWorld:
        """Collision model of the present state, with what is held."""
        X_hand_ee, off = (None, 0.0) if held is None else (held.X_hand_ee, held.off)
        return CollisionWorld(self.robot, self.config, self.q_hand, X_hand_ee, self.in_the_way, off)

    def _carried_world(self) -> CollisionWorld:
        return self.world(self.carried)

    def carry(self, held: HeldTool | None) -> None:
        """Note what the hand holds from now on."""
        self.carried = held

    def keep_clear_of(self, bodies: tuple[Body, ...]) -> None:
        """Note which bodies of the work nothing may touch from now on, beside those of the station."""
        self.in_the_way = bodies

    @property
    def held(self) -> HeldTool:
        """The tool in the hand as told last, after whatever has interrupted a task."""
        assert self.carried is not None, "the hand is empty"
        return self.carried

    def set_payload(self, payload: Payload) -> None:
        """Tell the arm what its flange carries; see `hal.Arm`.

        Args:
            payload: Mass [kg] and centre of mass [m], flange frame.

        Raises:
            LimitError: The arm cannot carry it.
        """
        self.arm.set_payload(payload)
        self.payload, self._zeroed = payload, None

    def execute(
        self,
        name: str,
        trajectory: Trajectory,
        held: HeldTool | None,
        guard: ContactGuard | None = None,
        *,
        at_work: bool = False,
    ) -> MotionReport:
        """Execute a trajectory, slowed down to the robot's momentum; the arm brakes when the hand doubts its grip.

        In HANDOVER mode the person first takes the hold-to-run switch anew.

        Args:
            name: Name of the motion in the recording and in messages.
            trajectory: The motion, from rest to rest.
            held: What the hand holds.
            guard: Contact detection; None for none.
            at_work: Whether the tool may touch block and stand.

        Returns:
            What was commanded and measured.

        Raises:
            GripError: The tool was lost before or during the motion.
            GripDoubtError: The hand doubted its grip during the motion, and holds the tool after all.
            PersonNearError: The person did not take the hold-to-run switch, or a person is where they must not be.
            DeviceError: The hand reports a fault or does not answer, or the arm was stopped.
            TooleeError: What `Supervisor.execute` raises.
        """
        dynamics = ArmDynamics.with_payload(self.robot, self.q_hand, self.payload)
        momentum = float(np.max(dynamics.momentum(trajectory.q, trajectory.qd)))
        trajectory = slowed_by(trajectory, momentum / (0.99 * self.config.supervisor.momentum))
        with self._watched(name, held) as hand:
            report = self.arm.execute(trajectory, guard, at_work=at_work)
        self._done(name, report, hand)
        return report

    def transfer(self, name: str, trajectory: Trajectory, held: HeldTool | None, speed: float = np.inf) -> None:
        """Move through free space, slowed down to the speed limit of the mode.

        Args:
            name: Name of the motion.
            trajectory: The motion, from rest to rest.
            held: What the hand holds.
            speed: Largest speed of hand and tool, where it is less than the mode's [m/s].

        Raises:
            TooleeError: As `execute`.
        """
        speed = min(speed, self.arm.mode.speed(self.config.supervisor))
        self.execute(name, slowed_to(trajectory, self.world(held), speed), held)

    def swing(self, name: str, plan: StrikePlan, held: HeldTool) -> tuple[MotionReport, ContactVerdict]:
        """Execute the strike of a plan, without any modification.

        Args:
            name: Name of the motion.
            plan: The plan of the strike.
            held: What the hand holds.

        Returns:
            What was commanded and measured, and how the strike met the nail.

        Raises:
            TooleeError: As `execute`.
        """
        self.check_hand()
        X_flange_ee = inverse(self.robot.arm.fk(plan.q_contact)) @ plan.X_base_ee_contact
        face = (self.robot.arm.fk(plan.strike.q) @ X_flange_ee)[:, :3, 3]
        lag, early = self.config.servo.lag or 0.0, self.config.supervisor.early_contact
        sway = swing_sway(held.payload.mass, plan.strike.times, face, plan.contact_time, early, lag)
        guard = strike_guard(self.config.strike, plan.contact_time, self.noise, self.arm.rate, sway)
        with self._watched(name, held) as hand:
            report, verdict = self.arm.swing(plan.strike, guard, plan.expected_contact)
        self._done(name, report, hand)
        return report, verdict

    def straight(
        self,
        name: str,
        direction: ArrayLike,
        length: float,
        held: HeldTool | None,
        guard: ContactGuard | None = None,
        *,
        speed: float = STRAIGHT_SPEED,
        share: float = 0.0,
    ) -> bool:
        """Move on a straight line with constant orientation; the tool may touch the work.

        Args:
            name: Name of the motion.
            direction: Unit vector in `base`, (3,).
            length: Length along it [m]; negative for the opposite direction.
            held: What the hand holds.
            guard: Contact detection; None for none.
            speed: Largest speed [m/s]; less where the mode allows less.
            share: Largest velocity and acceleration of the joints as a share of a strike's, transfers' at least.

        Returns:
            Whether a contact ended the motion.

        Raises:
            TooleeError: As `execute`, and what `plan_straight` raises.
        """
        if abs(length) <= 1e-4:
            return False
        world = self.world(held)
        speed = min(speed, 0.95 * self.arm.mode.speed(self.config.supervisor))
        move = plan_straight(self.robot, self.config, world, self.q, length, direction, speed, share)
        return self.execute(name, move, held, guard, at_work=True).contact is not None

    def rise_from_among_nails(self, held: HeldTool | None) -> None:
        """Rise straight until the tool is clear of the nails that stand beside the one that is struck.

        A face on a nail that has been driven is lower than they are, and a transfer may not begin there.

        Raises:
            TooleeError: As `straight`.
        """
        if self.in_the_way and held is not None:
            self.rise("up from among the nails", held)

    def rise(self, name: str, held: HeldTool | None, least: float = 0.0) -> None:
        """Rise straight until a transfer may begin, by what is known of the tool.

        Args:
            name: Name of the motion.
            held: What the hand holds.
            least: Least height [m].

        Raises:
            TooleeError: As `straight`.
        """
        self.straight(name, UP, max(least, rise_to_clear(self.robot, self.world(held), self.q)), held)

    def retreat(self) -> bool:
        """After the tool has dropped, move slowly up and away from the person's place, else up, else not at all.

        For a person who has asked for it: the arm is in HANDOVER mode, and they hold the hold-to-run switch.

        Returns:
            Whether the arm has moved away.
        """
        self.carry(None)
        self.arm.mode = Mode.HANDOVER
        with suppress(DeviceError):
            away = self.robot.fk(self.q, self.q_hand)[1][:3, 3] - np.asarray(self.config.scene.person_center)
            away[2] = 0.0
            x, y, _ = away / max(float(np.linalg.norm(away)), 1e-6)
            for direction in ((float(x), float(y), 1.0), UP):
                with suppress(PlanningError):
                    world = self.world(None)
                    move = plan_straight(self.robot, self.config, world, self.q, RETREAT, direction, RETREAT_SPEED)
                    self.execute("retreat", move, None)
                    return True
        return False

    def zero_wrench(self) -> None:
        """Zero the force reading, at rest and away from everything; see `hal.Arm`.

        Raises:
            TooleeError: As `Supervisor.zero_wrench`.
        """
        self._wait_until_still()
        self.arm.zero_wrench()
        self._zeroed = self._flange()

    def zeroed_within(self, distance: float) -> bool:
        """Whether the force was zeroed with the flange within a distance [m] of its present place."""
        return self._zeroed is not None and bool(np.linalg.norm(self._flange() - self._zeroed) < distance)

    def forces(self, duration: float) -> Array:
        """Read the force of the arm at rest.

        Args:
            duration: Time over which it is read [s].

        Returns:
            The readings, one a cycle, (N, 3) [N], `base` axes.

        Raises:
            DeviceError: The arm does not answer.
        """
        return self.wrenches(duration)[:, :3]

    def read_noise(self, duration: float, before: Array) -> Array:
        """Read the force at rest once more, as `forces`, for the noise that a strike's contact detection bears.

        Args:
            duration: Time over which it is read [s].
            before: Readings that count, too, (N, 3) [N].

        Returns:
            All readings.

        Raises:
            DeviceError: The arm does not answer.
        """
        self.noise = np.concatenate([before, self.forces(duration)])
        return self.noise

    def wrenches(self, duration: float) -> Array:
        """Read the wrench of the arm at rest.

        Args:
            duration: Time over which it is read [s].

        Returns:
            The readings, one a cycle, (N, 6) [N, Nm], `base` axes.

        Raises:
            DeviceError: The arm does not answer.
        """
        return wrenches_at_rest(self.arm, self.station.clock, duration)

    def check_hand(self) -> None:
        """Check the hand before a strike.

        Raises:
            GripError: The hand has lost the tool.
            DeviceError: The hand reports a fault, or is too hot.
        """
        hand, most = self.station.hand, self.config.supervisor.max_hand_temperature
        check_held(hand, self.station.clock)
        state = hand.state()
        if state.temperature is not None and not state.temperature <= most:  # NaN included
            raise DeviceError(
                f"the hand is at {state.temperature:.0f} °C, above the allowed {most:.0f} °C: let it cool down"
            )

    def stand_still(self) -> None:
        """Stop arm and fingers, ignoring devices that have failed; the hand keeps its grip."""
        for device in (self.arm, self.station.hand):
            with suppress(DeviceError):
                device.stop()

    @contextmanager
    def _watched(self, name: str, held: HeldTool | None) -> Iterator[HandWatch | None]:
        """Context of a motion: starts at standstill, monitors the grip, and reports a motion that a fault ended."""
        self.carry(held)
        self._wait_until_still()
        watch = None if held is None else HandWatch(self.station.hand, self.arm.stop)
        if held is not None:
            check_held(self.station.hand, self.station.clock)
        if self.arm.mode is Mode.HANDOVER and not self.person.hold_switch(
            HOLD_SWITCH, self.config.task.handover_timeout
        ):
            raise PersonNearError(
                f"the hold-to-run switch was not pressed anew before {name!r}: no motion. Release it, then hold it. "
                "Check for a stuck switch",
                code="person_near.switch_not_taken",
            )
        self.wait_for_readings()
        try:
            with watch or nullcontext():
                yield watch
        except MotionFaultError as fault:
            if fault.report is not None and len(fault.report.stamps):
                self.q = fault.report.q_commanded[-1]
                self._report(name, fault.report, watch)
            raise

    def _flange(self) -> Array:
        """Position of the flange in `base`, (3,) [m]."""
        return self.robot.arm.fk(self.q)[:3, 3]

    def _wait_until_still(self) -> None:
        with suppress(DeviceError):  # the supervisor refuses an arm without data, with the specific reason
            for _ in range(int(STILL_PATIENCE / STILL_STEP)):
                if np.abs(self.arm.state().joints.qd).max() < AT_REST:
                    return
                self.station.clock.sleep(STILL_STEP)

    def wait_for_readings(self) -> None:
        """Wait until the person's inputs are known and have settled, for `READINGS_PATIENCE` at most."""
        clock = self.station.clock
        end = clock.now() + READINGS_PATIENCE
        while not self.person.readings_certain() and clock.now() < end:
            clock.sleep(STILL_STEP)

    def _done(self, name: str, report: MotionReport, hand: HandWatch | None) -> None:
        # The arm holds the commanded position, where the next motion must start; the servo's lag is zero at rest.
        self.q = report.q_commanded[-1]
        self._report(name, report, hand)
        if hand is not None and hand.error is not None:
            raise hand.error
        if self.carried is not None:
            check_held(self.station.hand, self.station.clock)
        if hand is not None and hand.doubted:
            raise GripDoubtError(f"the hand doubted its grip during the motion {name!r}, and still holds the tool")
        if report.outcome is MotionOutcome.STOPPED:
            raise DeviceError(f"the arm was stopped during the motion {name!r}")

    def _report(self, name: str, report: MotionReport, watch: HandWatch | None) -> None:
        # A hand that no longer answers, or is gone, must not prevent the recording: any age of its state is accepted.
        with suppress(DeviceError):
            self._q_hand_seen = self.station.hand.state(max_age=np.inf).joints.q
        begin = float(report.stamps[0]) if len(report.stamps) else self.station.clock.now()
        hand, course = self.station.hand, None if watch is None else watch.course
        if course is not None and isinstance(hand, KeepsCourse):
            course = list(hand.course(begin))
        course = [(stamp, q) for stamp, q in course or () if stamp >= begin]
        self.observer.motion(name, report, course or [(begin, self._q_hand_seen)])

"""Table of the faults of hand, camera, perception, nail, person and arm that a job must survive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.faults.record import Phase
from tests.faults.rows.job_fault import GRIP_DOUBTS, IN_STRIKE, INPUTS, RESUMES, Braking, JobFault, Scene
from tests.rigs.job_rig import CONFIG
from tests.rigs.people import Change, moved, unsure
from toolee_robot.control.contact import Meeting
from toolee_robot.sim_backend.physics.bodies import pb
from toolee_robot.tasks.common.outcome import Outcome, Stage

REST, SWING = Phase.REST, Phase.SWING
RUN_UP = "to the run-up"
FAULT, LOST, UNKNOWN, NEAR = Outcome.DEVICE_FAULT, Outcome.TOOL_LOST, Outcome.POSE_UNKNOWN, Outcome.PERSON_NEAR
STANDS = "arm stands, grip kept"
NO_STRIKE = "no strike, arm stands, grip kept"
NO_NEXT = "no further strike, arm stands, grip kept"
RETREATS = "aborts, asks the person, then retreats"
LOOKS = "looks again, then gives up"
RECORDS = "stops, records a failure"
BRAKES = "brakes on the path, latches, grip kept"
BRAKES_ONLY = "brakes on the path, " + STANDS
HOT = 71.0  # [deg C]
PLATE = (0.03, 0.03, 0.005)  # [m] half its size
PLATE_OVER = 0.10  # [m] over the nail's head: the face comes down from twice as high


def _nothing(_: Scene) -> None: ...


def _hang(s: Scene) -> None:
    s.bench.sim_hand.hangs = True


def _heat(s: Scene) -> None:
    s.bench.sim_hand.temperature = HOT


def _stall(s: Scene) -> None:
    s.bench.sim_hand.fault = "index finger stalled"


def _freeze(s: Scene) -> None:
    s.bench.sim_camera.freeze()


def _repeat(s: Scene) -> None:
    s.bench.sim_camera.read()
    s.bench.sim_camera.repeat()


def _unplug(s: Scene) -> None:
    s.bench.sim_camera.unplug()


def _blind(s: Scene) -> None:
    s.bench.sim_camera.blinded = True


def _cut(s: Scene) -> None:
    s.bench.arm.cut_link()
    s.bench.sim.world.advance(0.5)


def _decline(*answers: str) -> Callable[[Scene], None]:
    """Make the person refuse these requests."""

    def decline(s: Scene) -> None:
        for answer in answers:
            setattr(s.bench.people, answer, False)

    return decline


def _lose_feeling(s: Scene) -> None:
    s.bench.hand.closed = False


def _tell(change: Change) -> Callable[[Scene], None]:
    """Change all further estimates of the perception."""

    def tell(s: Scene) -> None:
        s.perception.changes[:] = [change]

    return tell


def _see_nothing(s: Scene) -> None:
    s.perception.sees = False


def _lay_a_plate(s: Scene) -> None:
    world = s.bench.sim.world
    x, y, z = CONFIG.work.X_base_nail()[:3, 3]
    shape = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=PLATE, physicsClientId=world.client)
    plate = pb.createMultiBody(0.0, shape, -1, [x, y, z + PLATE_OVER], physicsClientId=world.client)

    def watch() -> None:
        touching = pb.getContactPoints(bodyA=world.tool.body, bodyB=plate, physicsClientId=world.client)
        if s.happened is None and touching:
            s.happened = world.time

    world.after_step.append(watch)
    s.undo.append(lambda: pb.removeBody(plate, physicsClientId=world.client))


def _take_the_work_away(s: Scene) -> None:
    """Disable the tool's collisions with nail, block and stand."""
    world = s.bench.sim.world

    def collide(enabled: int) -> None:
        for body in (world.nail.body, world.furniture.block, world.furniture.stand):
            for link in range(-1, pb.getNumJoints(body, physicsClientId=world.client)):
                pb.setCollisionFilterPair(world.tool.body, body, -1, link, enabled, physicsClientId=world.client)

    collide(0)
    s.undo.append(lambda: collide(1))


def _bend(driven: float | None = None, aside: float = 0.0) -> Callable[[Scene], None]:
    """Move the nail's head to a depth from where it was set [m], or where it is, and to the side by an angle [rad]."""

    def bend(s: Scene) -> None:
        nail = s.bench.sim.world.nail
        nail.place(nail.protrusion if driven is None else nail.spec.protrusion - driven, (aside, 0.0))

    return bend


def _after(motion: str, inject: Callable[[Scene], None]) -> Callable[[Scene], None]:
    """Inject a fault after the next motion of this name."""

    def later(s: Scene) -> None:
        s.log.after[motion] = lambda: inject(s)

    return later


def _harden(s: Scene) -> None:
    nail = s.bench.sim.world.nail
    nail.spec = replace(nail.spec, specific_gravity=1.2, pilot_diameter=0.0)


def _stick(s: Scene) -> None:
    assert s.log.plan is not None
    s.bench.arm.block_joint(int(np.abs(s.log.plan.strike.qd).max(axis=0).argmax()))


HAND = (
    JobFault(15, "hand does not open in time", REST, STANDS, _hang, None, FAULT, "its grip", 0, None),
    JobFault(
        15, "hand does not close in time", REST, STANDS, _hang, Stage.GRIP, FAULT, "its grip", 0, "to the handover"
    ),
    JobFault(
        15, "hand falls silent", SWING, BRAKES_ONLY, lambda s: s.bench.sim_hand.cut_link(), IN_STRIKE,
        FAULT, "hand's newest state", 1, "strike", braking=Braking(None), before=0.3,
    ),
    JobFault(18, "hand too hot", REST, NO_STRIKE, _heat, RUN_UP, FAULT, "71 °C", 0, RUN_UP),
    JobFault(18, "hand too hot", SWING, NO_NEXT, _heat, IN_STRIKE, FAULT, "71 °C", 1, RUN_UP, max_strikes=2),
    JobFault(18, "finger stalled", REST, NO_STRIKE, _stall, RUN_UP, FAULT, "finger stalled", 0, RUN_UP),
    JobFault(18, "finger stalled", SWING, BRAKES_ONLY, _stall, IN_STRIKE, FAULT, "finger stalled", 1, "strike",
             braking=Braking(None), before=0.15),
    JobFault(21, "tool dropped", REST, RETREATS, lambda s: s.bench.drop(), RUN_UP, LOST, "lost the tool", 0, "retreat",
             keeps=False),
    JobFault(21, "tool dropped", SWING, "brakes on the path, " + RETREATS, lambda s: s.bench.drop(), IN_STRIKE, LOST,
             "lost the tool", 1, "retreat", braking=Braking(None), keeps=False, before=0.15),
    JobFault(21, "hand feels no grip", REST, RETREATS, _lose_feeling, RUN_UP, LOST, "lost the tool", 0, "retreat"),
    JobFault(21, "hand feels no grip", SWING, "brakes on the path, " + RETREATS, _lose_feeling, IN_STRIKE, LOST,
             "lost the tool", 1, "retreat", braking=Braking(None), before=0.15),
)  # fmt: skip

CAMERA = tuple(
    replace(fault, sees=True)
    for fault in (
        JobFault(20, "camera unplugged", REST, NO_STRIKE, _unplug, Stage.VIEW, FAULT, "unplugged", 0, "to a view"),
        JobFault(20, "camera unplugged", SWING, NO_NEXT, _unplug, IN_STRIKE, FAULT, "unplugged", 1, "to a view",
                 max_strikes=2),
        JobFault(22, "camera frozen", REST, NO_STRIKE, _freeze, Stage.VIEW, FAULT, "no new frame", 0, "to a view"),
        JobFault(22, "camera frozen", SWING, NO_NEXT, _freeze, IN_STRIKE, FAULT, "no new frame", 1, "to a view",
                 max_strikes=2),
        JobFault(22, "camera repeats a frame", REST, NO_STRIKE, _repeat, Stage.VIEW, FAULT, "repeats", 0, "to a view"),
        JobFault(22, "camera repeats a frame", SWING, NO_NEXT, lambda s: s.bench.sim_camera.repeat(), IN_STRIKE, FAULT,
                 "repeats", 1, "to a view", max_strikes=2),
        *(
            JobFault(23, name, phase, LOOKS, inject, when, outcome, message, strikes, "home", looks_again=True,
                     max_strikes=2)
            for phase, when, strikes in ((REST, Stage.VIEW, 0), (SWING, IN_STRIKE, 1))
            for name, inject, outcome, message in (
                ("camera has no depth", _blind, UNKNOWN, "lies where a held hammer cannot"),
                ("no points on the tool", _see_nothing, UNKNOWN, "lies where a held hammer cannot"),
                ("pose jumps by 200 mm", _tell(moved([0.20, 0.0, 0.0])), UNKNOWN, "where a held hammer can"),
                ("low confidence", _tell(unsure), UNKNOWN, "sigma 31 mm"),
            )
        ),
        # So far off a long handle may lie: the face then meets nothing, or has slipped.
        JobFault(23, "pose jumps by 130 mm", REST, LOOKS + ", no strike", _tell(moved([0.13, 0.0, 0.0])), Stage.VIEW,
                 Outcome.NAIL_MISSED, "met nothing", 0, "home", looks_again=True, max_strikes=2),
        JobFault(23, "pose jumps by 130 mm", SWING, LOOKS, _tell(moved([0.13, 0.0, 0.0])), IN_STRIKE,
                 Outcome.TOOL_SLIPPED, "grip it again", 1, "home", looks_again=True, max_strikes=2),
        JobFault(23, "pose jumps by 20 mm", SWING, LOOKS, _tell(moved([0.0, 0.02, 0.0])), IN_STRIKE,
                 Outcome.TOOL_SLIPPED, "grip it again", 1, "home", looks_again=True, max_strikes=2),
    )
)  # fmt: skip

WORK = (
    JobFault(25, "no contact by the expected depth", REST, "goes up, looks again, gives up, no strike",
             _take_the_work_away, Stage.TOUCH, Outcome.NAIL_MISSED, "met nothing", 0, "home", looks_again=True,
             sees=True),
    JobFault(25, "no contact by the expected depth", SWING, "brakes as planned, goes up, looks again, gives up",
             _take_the_work_away, RUN_UP, Outcome.NAIL_MISSED, "met nothing", 2, "home", looks_again=True,
             meetings=(Meeting.NONE, Meeting.NONE), sees=True, max_strikes=3),
    JobFault(25, "contact too early", SWING, "brakes on the path, goes up, looks again, gives up", _lay_a_plate,
             RUN_UP, Outcome.NAIL_MISSED, "before the nail", 2, "home", braking=Braking(2), looks_again=True,
             meetings=(Meeting.EARLY, Meeting.EARLY), sees=True, max_strikes=3),
    JobFault(26, "no progress", REST, RECORDS, _harden, None, Outcome.STUCK, "2 strikes", 2, "home", max_strikes=5),
    # The nail is measured after two strikes first, which can drive it by more than this.
    JobFault(26, "nail sinks too far after the first strike", SWING, RECORDS, _bend(0.011), "strike",
             Outcome.BENT, "has bent", 2, "home", max_strikes=5, sees=True),
    JobFault(26, "nail sinks too far", SWING, RECORDS, _after("touch the wood", _bend(0.019)), "strike",
             Outcome.BENT, "has bent", 3, "home", looks_again=True, max_strikes=5, sees=True),
    JobFault(26, "nail bends aside", SWING, "looks again, strikes once more, gives up, records a failure",
             _bend(aside=np.deg2rad(80)), "strike", Outcome.NAIL_MISSED, "not at the point of the strike", 3,
             "home", looks_again=True, max_strikes=5, sees=True),
    JobFault(26, "too many strikes", REST, RECORDS, _nothing, None, Outcome.OUT_OF_STRIKES, "after 1 strikes", 1,
             "home"),
)  # fmt: skip

PEOPLE = (
    JobFault(27, "nobody hands a tool over", REST, NO_STRIKE, _decline("gives", "steps_back"), None,
             Outcome.NO_HANDOVER, "nobody handed", 0, "to the handover"),
    JobFault(27, "nobody steps back", REST, NO_STRIKE, _decline("steps_back"), None, NEAR, "nobody confirmed", 0,
             "to the handover"),
    JobFault(27, "hold-to-run switch not held", REST, "no motion", _decline("holds_switch"), None, NEAR,
             "hold-to-run switch", 0, None),
    JobFault(27, "nobody confirmed the swing", REST, NO_STRIKE, _decline("confirms"), None, NEAR, "nobody confirmed", 0,
             RUN_UP),
    JobFault(27, "a person is in reach", REST, NO_STRIKE, lambda s: s.bench.people.step_in(), RUN_UP, NEAR,
             "within the arm's reach", 0, RUN_UP),
    JobFault(27, "a person comes into reach", SWING, BRAKES, lambda s: s.bench.people.step_in(), IN_STRIKE, NEAR,
             "within the arm's reach", 1, "strike", braking=Braking(None), job_latches=True, before=0.3),
)  # fmt: skip

ARM = (
    *(
        JobFault(number, name, SWING, BRAKES, inject, IN_STRIKE, FAULT, message, 1, "strike", braking=braking,
                 job_latches=True, arm_latches=True, person=person)
        for number, name, inject, message, braking, person in (
            (7, "a joint sticks", _stick, "away from its command", Braking(8, arm_off=True), False),
            (9, "network link cut", lambda s: s.bench.arm.cut_link(), "network link", Braking(4), True),
            (10, "commands go out late", lambda s: s.bench.arm.delay_commands(50), "sent late", Braking(5), False),
            (12, "protective stop", lambda s: s.bench.arm.protective_stop(), "protective", Braking(1), True),
            (13, "emergency stop", lambda s: s.bench.arm.emergency_stop(), "emergency", Braking(1), True),
        )
    ),
    JobFault(9, "network link cut", REST, "no motion", _cut, None, FAULT, "network link", 0, None),
    JobFault(12, "protective stop", REST, NO_STRIKE + ", latches", lambda s: s.bench.arm.protective_stop(), RUN_UP,
             FAULT, "protective stop", 0, RUN_UP, arm_latches=True, person=True),
    JobFault(13, "emergency stop", REST, NO_STRIKE + ", latches", lambda s: s.bench.arm.emergency_stop(), RUN_UP,
             FAULT, "emergency stop", 0, RUN_UP, arm_latches=True, person=True),
)  # fmt: skip

JOB_FAULTS = (*HAND, *GRIP_DOUBTS, *CAMERA, *WORK, *PEOPLE, *INPUTS, *ARM, *RESUMES)

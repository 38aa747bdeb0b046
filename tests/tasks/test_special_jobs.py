"""The job with a tool mount on the flange instead of a hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.nails import with_nails
from tests.rigs.job_rig import CONFIG, HOME, Bench, at_rest, grip_kept
from tests.rigs.people import ScriptedPerception
from tests.tasks.bench import Log, is_home, noting
from tests.tasks.noisy_arm import Rig
from toolee_robot.control import RobotModel, plan_transfer
from toolee_robot.control.collision_shapes import nail_bodies
from toolee_robot.errors import CollisionError
from toolee_robot.frames import transform
from toolee_robot.hal import ArmStatus
from toolee_robot.sim_backend import SimStation
from toolee_robot.sim_backend.devices.arm import SimArm
from toolee_robot.sim_backend.physics.bodies import pb
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.station import NailConfig, StationConfig, load_station
from toolee_robot.tasks.common.motions import UP
from toolee_robot.tasks.common.outcome import RESUME, Outcome, Stage
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tasks.hammering.handover import MOUNT_EMPTY
from toolee_robot.tasks.hammering.task import HammeringTask

pytestmark = pytest.mark.sim(seconds=125)

SEED = 100
EXAMPLE = load_station(Path(__file__).parents[2] / "examples" / "mount.yaml")
SHORT = replace(EXAMPLE, work=replace(EXAMPLE.work, nail_protrusion=0.004))
"""A nail that a few strikes drive."""


def _task(simulation: SimStation, config: StationConfig) -> HammeringTask:
    perception = PerfectPerception(simulation.judge)
    return HammeringTask(simulation.station, perception, config, nominal_grasp(simulation.tool, config))


@pytest.mark.nightly
def test_the_nail_is_driven_without_a_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    with SimStation.build(SHORT, SEED) as simulation:
        person, world, task = simulation.person, simulation.world, _task(simulation, SHORT)
        prompts: list[str] = []
        for question in ("request_handover", "confirm_inspection", "take_tool"):
            monkeypatch.setattr(person, question, noting(getattr(person, question), prompts))
        yielded: list[float] = []
        world.after_step.append(lambda: yielded.append(float(world.robot.hand_state()[0][0])))
        result = task.run()
        assert result.outcome is Outcome.FLUSH, result.reason
        verdict = simulation.judge.verdict(result.estimates)
        assert verdict.worst().outcome == "flush"
        assert verdict.misses == 0
        assert prompts[0] == MOUNT_EMPTY
        assert "mount" in prompts[1]
        assert Stage.GRIP in result.stage_seconds
        mount = SHORT.hand.mount
        assert mount is not None
        assert 0.1 < max(yielded) < mount.travel, "the mount gave way, and did not meet its end stop"
        np.testing.assert_array_equal(simulation.station.hand.state().joints.q, [0.0])
        assert task.holds_tool
        assert task.give_back()
        assert "mount" in prompts[-1]
        assert not simulation.station.hand.state().holding
        assert world.grip is None


def test_nothing_moves_until_a_person_says_that_the_mount_is_empty() -> None:
    with SimStation.build(SHORT, SEED) as simulation:
        simulation.person.confirms = False
        before = simulation.station.arm.state().q_commanded
        result = _task(simulation, SHORT).run()
        assert result.outcome is Outcome.NOT_READY
        assert result.stage is Stage.HANDOVER
        assert "mount" in result.reason
        np.testing.assert_array_equal(simulation.station.arm.state().q_commanded, before)


def watched(bench: Bench, zero: Callable[[], None], touching: list[bool]) -> Callable[[], None]:
    """The zero of the force, which notes whether the tool touches anything but the hand."""
    world = bench.sim.world

    def zeroed() -> None:
        others = {p[2] for p in pb.getContactPoints(bodyA=world.tool.body, physicsClientId=world.client)}
        touching.append(bool(others - {world.robot.body, world.tool.body}))
        zero()

    return zeroed


def test_softer_strikes_follow_one_over_the_limit_and_the_force_is_never_zeroed_while_touching(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    touching: list[bool] = []
    monkeypatch.setattr(bench.arm, "zero_wrench", watched(bench, bench.arm.zero_wrench, touching))
    config = replace(
        CONFIG, task=replace(CONFIG.task, max_strikes=5), strike=replace(CONFIG.strike, max_torque_share=0.3)
    )
    log = Log()
    result = bench.blind_task(log, config).run()
    assert result.outcome is Outcome.OVERLOAD
    assert "lower strike.speed" in result.reason
    assert len(result.strikes) == 3, "two softer ones follow"
    speeds = np.array([strike.speed for strike in result.strikes])
    assert np.all(speeds[1:] <= 0.751 * speeds[:-1])
    strike = result.strikes[-1]
    assert 0.3 < strike.load.torque_share < 1.0
    assert strike.load.impulse > 0.5
    assert strike.load.position_deviation_ratio is None
    assert strike.protrusion == pytest.approx(bench.sim.world.nail.protrusion, abs=0.001), "it is measured all the same"
    assert is_home(bench.sim)
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)
    assert sum(name.startswith("touch the") for name in log.motions) == 6, "first, by the forecast, at the end"
    assert touching, "zeroed before the first touch"
    assert not np.any(touching)


GAP = 0.01
"""[m] Between the hand, as the strike begins, and what it meets."""


def block(world: SimWorld) -> int:
    """Something hard under the hand, which moves down in a strike; pybullet's id."""
    x, y, _ = world.robot.link_pose(world.robot.palm)[:3, 3]
    robot, client = world.robot_body, world.client
    links = [link for link in world.robot.link_index.values() if link >= world.robot.sensor_link]
    lowest = min(float(pb.getAABB(robot, link, physicsClientId=client)[0][2]) for link in links)
    shape = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=[0.15, 0.15, 0.02], physicsClientId=client)
    at = [float(x), float(y), lowest - GAP - 0.02]
    body = int(pb.createMultiBody(0.0, shape, -1, at, physicsClientId=client))
    pb.setCollisionFilterPair(world.tool_body, body, -1, -1, 0, physicsClientId=client)
    return body


@pytest.mark.nightly
def test_a_hand_that_meets_something_hard_stops_the_robot_and_the_job_goes_on_after_a_person(bench: Bench) -> None:
    bench.arm = SimArm(bench.sim.world, wrench_errors=1.0)
    world, log, blocks = bench.sim.world, Log(), []
    log.at[Stage.STRIKE] = lambda: blocks.append(block(world))
    task = bench.seeing_task(log, perceiver=ScriptedPerception(bench.sim.judge))
    result = task.run()
    assert result.outcome is Outcome.DEVICE_FAULT
    assert "the robot made a protective stop: C1" in result.reason
    assert RESUME in result.reason
    assert result.stops == 1
    assert log.motions[-1] == "strike"
    assert log.reports[-1].commands is not None, "it was sent nothing more"
    state = bench.arm.state()
    assert state.status is ArmStatus.PROTECTIVE_STOP
    assert state.error_code is not None
    assert f"{state.error_code}: " in result.reason
    assert grip_kept(bench.sim)
    result = task.resume(confirmed=True)
    assert result.outcome is Outcome.DEVICE_FAULT, "a person has to make the robot ready first"
    assert f"the robot is in protective stop ({state.error_code}: " in result.reason
    assert log.motions[-1] == "strike"
    pb.removeBody(blocks[0], physicsClientId=world.client)
    bench.arm.make_ready()
    looked = log.stages.count(("begin", Stage.VIEW))
    result = task.resume(confirmed=True)
    assert result.outcome is Outcome.OUT_OF_STRIKES, "the bench's job has one"
    assert log.strikes[-1].protrusion is not None
    assert log.strikes[-1].protrusion < 0.018, "it drove the nail"
    assert log.stages.count(("begin", Stage.VIEW)) > looked, "it looked again"
    assert at_rest(bench.sim)


X, Y = CONFIG.work.nail_xy


def _config(nail: NailConfig, *others: NailConfig) -> StationConfig:
    return replace(CONFIG, work=with_nails(replace(CONFIG.work, block_size=(0.14, 0.14, 0.06)), nail, *others))


@pytest.mark.nightly
def test_the_wood_is_not_felt_where_another_nail_stands(bench: Bench) -> None:
    """A lone nail's wood is felt towards the handle, where the other one is here."""
    log = Log()
    bench.blind_task(log).run()
    assert log.plan is not None
    x, y, _ = 0.040 * log.plan.X_base_ee_contact[:3, 0]
    config = _config(NailConfig("struck", (X, Y)), NailConfig("beside", (X + x, Y + y), protrusion=0.010))
    among = Bench(config)
    with among.sim:
        perception, grasp = PerfectPerception(among.sim.judge), nominal_grasp(among.sim.tool, config)
        result = HammeringTask(among.station, perception, config, grasp, nails=("struck",)).run()
        assert result.outcome is Outcome.OUT_OF_STRIKES, result.reason
        nails = among.sim.world.nails
        assert result.strikes[0].protrusion == pytest.approx(nails["struck"].protrusion, abs=0.001)
        assert nails["beside"].protrusion == pytest.approx(0.010, abs=1e-4)


@pytest.mark.nightly
def test_a_tool_that_is_low_among_nails_rises_before_it_goes_anywhere() -> None:
    """A look has told that the face is elsewhere in the hand: it is then nearer to them than it was believed to be."""
    others = [NailConfig("left", (X, Y + 0.0365)), NailConfig("right", (X, Y - 0.0365))]
    config = _config(NailConfig("low", (X, Y), protrusion=0.004), *others)
    robot, bench = RobotModel.of_station(config), Bench(config)
    with bench.sim:
        rig = Rig(bench, 0, scale=0.0, config=config)
        motions = rig.motions
        motions.in_the_way = nail_bodies(config.work, ["left", "right"])
        rig.go_over(0.030)
        height = config.work.wood_height + 0.010 - float(motions.X_base_ee(rig.held)[2, 3])
        motions.straight("down", UP, height, rig.held)
        nearer = motions.X_base_ee(rig.held)[:3, :3].T @ [0.0, 0.004, 0.0]
        held = rig.held.moved(rig.held.X_hand_ee @ transform(p=nearer))
        with pytest.raises(CollisionError, match="tool head and nail left"):
            plan_transfer(robot, config, motions.world(held), motions.q, HOME)
        motions.rise_from_among_nails(held)
        motions.transfer("home", plan_transfer(robot, config, motions.world(held), motions.q, HOME), held)
        assert rig.log.motions[-2:] == ["up from among the nails", "home"]

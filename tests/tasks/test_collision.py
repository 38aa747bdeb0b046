"""A strike whose hand meets something hard: the robot stops itself, the job tells why, and goes on after a person."""

from __future__ import annotations

import pytest

from tests.rigs.job_rig import Bench, at_rest, grip_kept
from tests.rigs.scripted_perception import ScriptedPerception
from tests.tasks.bench import Log
from toolee_robot.hal import ArmStatus
from toolee_robot.sim_backend.devices.arm import SimArm
from toolee_robot.sim_backend.physics.bullet import pb
from toolee_robot.sim_backend.world import SimWorld
from toolee_robot.tasks.common.outcome import RESUME, Outcome, Stage

pytestmark = pytest.mark.sim(seconds=30)

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

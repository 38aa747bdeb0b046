"""A nail between others that stand: the wood is felt where none of them is, and the tool comes out from among them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.rigs.job_rig import CONFIG, HOME, Bench
from tests.tasks.bench import Log
from tests.tasks.noisy_arm import Rig
from toolee_robot.control import RobotModel, plan_transfer
from toolee_robot.control.collision_shapes import nail_bodies
from toolee_robot.errors import CollisionError
from toolee_robot.frames import transform
from toolee_robot.sim_backend.truth import PerfectPerception
from toolee_robot.station import NailConfig, StationConfig
from toolee_robot.tasks.common.motions import UP
from toolee_robot.tasks.common.outcome import Outcome
from toolee_robot.tasks.hammering.grasp import nominal_grasp
from toolee_robot.tasks.hammering.task import HammeringTask

pytestmark = pytest.mark.sim(seconds=15)

X, Y = CONFIG.work.nail_xy


def _config(nail: NailConfig, *others: NailConfig) -> StationConfig:
    return replace(CONFIG, work=replace(CONFIG.work, block_size=(0.14, 0.14, 0.06)).with_nails(nail, *others))


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

"""When the force is zeroed in a job, and a strike after which none follows: on the simulated station itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.rigs.job_rig import CONFIG, Bench, at_rest, grip_kept
from tests.tasks.bench import Log, is_home
from toolee_robot.sim_backend.physics.bullet import pb
from toolee_robot.tasks.common.outcome import Outcome

pytestmark = pytest.mark.sim(seconds=20)


def watched(bench: Bench, zero: Callable[[], None], touching: list[bool]) -> Callable[[], None]:
    """The zero of the force, which notes whether the tool touches anything but the hand."""
    world = bench.sim.world

    def zeroed() -> None:
        others = {p[2] for p in pb.getContactPoints(bodyA=world.tool.body, physicsClientId=world.client)}
        touching.append(bool(others - {world.robot.body, world.tool.body}))
        zero()

    return zeroed


def test_no_strike_follows_one_over_the_limit_and_the_force_was_never_zeroed_while_touching(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    touching: list[bool] = []
    monkeypatch.setattr(bench.arm, "zero_wrench", watched(bench, bench.arm.zero_wrench, touching))
    config = replace(
        CONFIG, task=replace(CONFIG.task, max_strikes=5), strike=replace(CONFIG.strike, max_torque_share=0.5)
    )
    log = Log()
    result = bench.blind_task(log, config).run()
    assert result.outcome is Outcome.OVERLOAD
    assert "lower strike.speed" in result.reason
    (strike,) = result.strikes
    assert 0.5 < strike.load.torque_share < 1.0
    assert strike.load.impulse > 0.5
    assert strike.load.position_deviation_ratio is None
    assert strike.protrusion == pytest.approx(bench.sim.world.nail.protrusion, abs=0.001), "it is measured all the same"
    assert is_home(bench.sim)
    assert at_rest(bench.sim)
    assert grip_kept(bench.sim)
    assert sum(name.startswith("touch the") for name in log.motions) == 4
    assert touching, "zeroed before the first touch"
    assert not np.any(touching)

"""The simulated world as a controller's plant: elastic joints follow the controller's ticks, too."""

from __future__ import annotations

import numpy as np
import pytest

from toolee_robot.sim_backend.options import SimOptions
from toolee_robot.sim_backend.station import build_world, draw_handover
from toolee_robot.sim_backend.world_plant import WorldPlant
from toolee_robot.station import sim_station

pytestmark = pytest.mark.sim

TURN = np.array([0.3, 0.2, -0.2, 0.3, 0.2, 0.4])  # [rad] in a second


@pytest.mark.parametrize("period", [0.008, 0.002], ids=["CB3", "e-Series"])
def test_elastic_joints_follow_a_controllers_ticks_and_come_to_rest(period: float) -> None:
    options = SimOptions(compliance=1.0, hands_over=False)
    world = build_world(sim_station(), draw_handover(1, options)[0], options)
    try:
        plant = WorldPlant(world, period)
        hand = world.robot.robot.hand_payload(world.robot.robot.hand_open)
        plant.set_payload(hand.mass, hand.center_of_mass)
        start = plant.q.copy()
        for k in range(round(1.7 / period)):
            q = start + 0.5 * (1.0 - np.cos(np.pi * min((k + 1) * period, 1.0))) * TURN
            plant.command(q, np.zeros(6))
            plant.step(period)
            np.testing.assert_allclose(plant.q, q, atol=1e-3)
        np.testing.assert_allclose(plant.q, start + TURN, atol=1e-6)
        assert np.abs(plant.qd).max() < 1e-3
        # 1 kg that it is not told of: the joints sag.
        plant.set_payload(hand.mass - 1.0, hand.center_of_mass)
        for _ in range(round(1.0 / period)):
            plant.command(q, np.zeros(6))
            plant.step(period)
        assert 1e-5 < np.abs(plant.q - q).max() < 5e-4
    finally:
        world.close()

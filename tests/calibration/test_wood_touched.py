"""Guarded touches of wood that is not level, by a simulated arm under the supervisor."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from toolee_robot.calibration.touches import add_touch
from toolee_robot.cli.app import run
from toolee_robot.control import CollisionWorld, Mode, RobotModel, Supervisor, plan_handover
from toolee_robot.control.planning.straight import plan_over_nail
from toolee_robot.control.planning.strike import plan_strike
from toolee_robot.frames import angle_between, inverse, transform
from toolee_robot.sim_backend import SimOptions, SimStation
from toolee_robot.station import load_station, sim_station
from toolee_robot.tasks.bring_up.slow_motions import MotionFrame, SlowStation, plan_line
from toolee_robot.tasks.bring_up.touch import approach, measured_settings
from toolee_robot.tasks.hammering.grasp import nominal_grasp

FAST = replace(sim_station().arm, transfer_velocity_scale=0.7, transfer_acceleration=5.0)
TOLD = replace(sim_station(), arm=FAST)
TRUE = replace(TOLD, work=replace(sim_station().work, stand_height=0.202, wood_rise=(0.03, -0.02)))
PLACES = ((0.032, 0.0), (-0.016, 0.028), (-0.016, -0.028), (-0.032, 0.0))
OVER = 0.03
"""Height over the wood at which an approach begins [m]: over the nail's head."""


@pytest.mark.nightly
@pytest.mark.sim(seconds=60)
def test_the_wood_is_found_by_guarded_touches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The tip is the face of a hammer in the hand, whose place is known; its rim touches first."""
    robot, home = RobotModel.of_station(TOLD), np.array(TOLD.scene.home)
    q_open = robot.description.hand_open
    begin = plan_handover(robot, TOLD, CollisionWorld(robot, TOLD, q_open), home, q_open).q[-1]
    touches = tmp_path / "wood.yaml"
    with SimStation.build(TRUE, 101, SimOptions(q_start=begin)) as simulation:
        station, world = simulation.station, simulation.world
        assert station.person.request_handover("", 10.0)
        station.hand.close()
        assert station.person.release("", 10.0)
        q_hand = station.hand.state().joints.q
        X_hand_ee = inverse(world.X_base_hand()) @ world.X_base_ee()
        X_hand_tool = inverse(world.X_base_hand()) @ world.X_base_tool()
        grasp = replace(nominal_grasp(simulation.tool, TOLD), X_hand_tool=X_hand_tool)
        around = CollisionWorld(robot, TOLD, q_hand, X_hand_ee)
        arm = Supervisor(station.arm, station.person, robot, TOLD, lambda: around)
        arm.set_payload(robot.payload(q_hand, grasp.X_hand_tool, grasp.mass, grasp.p_tool_com))
        arm.mode = Mode.UNATTENDED
        slow = SlowStation(TOLD, TOLD, robot, around)
        settings = measured_settings(arm, TOLD.strike, TOLD.strike.touch_force, station.clock)
        for x, y in PLACES:
            X_base_place = transform(p=[x, y, 0.0]) @ TOLD.work.X_base_nail(0.0)
            q = arm.state().q_commanded
            plan = plan_strike(robot, TOLD, around, q, q_hand, X_hand_ee, X_base_place, tool=grasp.swung)
            arm.execute(plan_over_nail(robot, TOLD, around, q, plan, OVER), at_work=True)
            down = plan_line(
                slow, arm.state().q_commanded, np.array([0.0, 0.0, -2 * OVER]), MotionFrame.BASE_LINK, settings.speed
            )
            touch = approach(arm, slow, down, settings, station.clock)
            assert touch is not None, "it met the wood"
            add_touch(touches, touch.q)
        tip = (robot.X_flange_hand(q_hand) @ X_hand_ee)[:3, 3] * 1e3
    lab = tmp_path / "lab.yaml"
    lab.write_text("version: 3\nframe: base_link\narm: {model: UR10, up: [0, 0, 1]}\nwork: {nail_xy: [0.75, 0.1]}\n")
    options = ["--wood", str(touches), "--tip-mm", *(f"{v:.4f}" for v in tip), "--station", str(lab)]
    assert run(["calibrate", "nail", *options, "--write", "--json"]) == 0
    told, work = json.loads(capsys.readouterr().out), load_station(lab).work
    print(told, work.stand_height, work.wood_rise)
    assert angle_between(work.wood_normal, TRUE.work.wood_normal) < np.deg2rad(1.0)
    assert abs(work.p_base_entry[2] - TRUE.work.p_base_entry[2]) < 1e-3

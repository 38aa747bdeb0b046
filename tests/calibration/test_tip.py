"""A tip on the flange from touches of one point: found within its uncertainty, refused where they tell nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.errors import raises
from toolee_robot.calibration.touches import locate_tip, read_touches
from toolee_robot.cli.app import run
from toolee_robot.control import RobotModel
from toolee_robot.errors import ConfigError, UserError
from toolee_robot.frames import Array, inverse, transform
from toolee_robot.station import sim_station

TIP = np.array([0.004, -0.002, 0.15])
DOWN = Rotation.from_euler("x", 180, degrees=True)
POINT = np.array([0.6, 0.1, 0.3])


def _touches(rng: np.random.Generator, count: int, tilt: float, noise: float = 0.0) -> list[Array]:
    found = []
    for _ in range(count):
        R = (Rotation.from_rotvec(rng.uniform(-tilt, tilt, 3)) * DOWN).as_matrix()
        found.append(transform(R, POINT + rng.normal(0.0, noise, 3) - R @ TIP))
    return found


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31))
def test_the_tip_is_found_within_its_uncertainty(seed: int) -> None:
    tip = locate_tip(_touches(np.random.default_rng(seed), 10, 0.8, 3e-4))
    off = tip.p_flange_tip - TIP
    assert off @ np.linalg.solve(tip.covariance, off) < 40.0
    assert np.linalg.norm(tip.p_base_point - POINT) < 2e-3
    assert tip.residual < 1.2e-3


def test_touches_that_tell_nothing_are_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    with raises(UserError, says="4 touches: give"):
        locate_tip(_touches(rng, 4, 0.8))
    with raises(UserError, says="the touches turn the flange by"):
        locate_tip(_touches(rng, 10, 0.1))
    slipped = _touches(rng, 10, 0.8)
    slipped[6] = transform(p=[0.02, 0.0, 0.0]) @ slipped[6]
    with raises(UserError, says="did the tip leave the point,") as error:
        locate_tip(slipped)
    assert "touch 7" in str(error.value)
    (tmp_path / "lab.yaml").write_text("work: {}\n")
    with raises(ConfigError):
        read_touches(tmp_path / "lab.yaml")


def test_the_mount_from_joint_positions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = RobotModel.of_station(sim_station())
    home = np.array(sim_station().scene.home)
    X_base_nail = sim_station().work.X_base_nail()
    rng, joints = np.random.default_rng(1), []
    for _ in range(8):
        R = (Rotation.from_rotvec(rng.uniform(-0.6, 0.6, 3)) * DOWN).as_matrix()
        joints.append(robot.ik.solve(transform(R, X_base_nail[:3, 3] - R @ TIP), home)[0])
        assert np.allclose((inverse(robot.arm.fk(joints[-1])) @ X_base_nail)[:3, 3], TIP, atol=1e-6)
    file = tmp_path / "touches.yaml"
    file.write_text(yaml.safe_dump({"touches": [q.tolist() for q in joints]}))
    (tmp_path / "lab.yaml").write_text("version: 3\nframe: base_link\narm: {model: UR10, up: [0, 0, 1]}\n")
    command = ["calibrate", "mount", "--touches", str(file), "--station", str(tmp_path / "lab.yaml"), "--json"]
    assert run(command) == 0
    found = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(found["p_flange_tip"], TIP, atol=1e-5)

"""The tightening job on a simulated station: a whole job, and its endings. Perception is the truth, or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from toolee_robot.app.tighten import nut_station
from toolee_robot.cli.app import run
from toolee_robot.end_effectors import CATEGORIES, Category
from toolee_robot.frames import Array, rotation_z, transform
from toolee_robot.robots import hand_model
from toolee_robot.sim_backend.bolt import Bolt, BoltJudge, BoltStation, X_base_bolt, bolt_station
from toolee_robot.sim_backend.options import InHandOffset, SimOptions
from toolee_robot.sim_backend.physics.nut import Jaw, NutSpec
from toolee_robot.sim_backend.truth import PerfectPerception, Truth
from toolee_robot.station import TaskConfig
from toolee_robot.tasks.common.observer import TaskObserver
from toolee_robot.tasks.common.outcome import Outcome
from toolee_robot.tasks.hammering.grasp import Grasp
from toolee_robot.tasks.tightening.records import NutWork, TightenResult
from toolee_robot.tasks.tightening.task import TighteningTask
from toolee_robot.types import CameraError, HoldingHand, InHandEstimate, RgbdFrame, ToolEstimate

CONFIG = replace(
    nut_station(),
    task=TaskConfig(views=1, views_again=1, handover_timeout=2.0),
    arm=replace(nut_station().arm, transfer_velocity_scale=0.7, transfer_acceleration=5.0),
)
SEED = 7
SOON_TIGHT = Bolt(NutSpec(run=0.7, stiffness=3.5), Jaw(), flats=0.3)


class SeenJaw(PerfectPerception):
    """The jaw's true pose, in the place of perception."""

    def __init__(self, judge: BoltJudge) -> None:
        super().__init__(cast("Truth", judge))  # only the poses are asked for

    def estimate(
        self, frame: RgbdFrame, hand: HoldingHand | None = None, categories: Sequence[Category] = CATEGORIES
    ) -> list[ToolEstimate]:
        found = super().estimate(frame, hand, categories)
        return [replace(e, detection=replace(e.detection, category=Category.WRENCH_HEAD)) for e in found]

    def fuse(
        self,
        estimates_per_frame: Sequence[Sequence[ToolEstimate]],
        Xs_camera_hand: Sequence[Array],
        category: Category | None = None,  # noqa: ARG002
        camera: CameraError | None = None,
    ) -> InHandEstimate:
        fused = super().fuse(estimates_per_frame, Xs_camera_hand, None, camera)
        return replace(fused, category=Category.WRENCH_HEAD)


class Log(TaskObserver):
    """Keeps the names of the motions, and the largest force at the flange."""

    def __init__(self) -> None:
        self.motions: list[str] = []
        self.force = 0.0

    def motion(self, name: str, report: object, hand: object) -> None:  # noqa: ARG002
        self.motions.append(name)
        self.force = max(self.force, float(np.linalg.norm(report.wrenches[:, :3], axis=1).max()))  # type: ignore[attr-defined]


def tighten(
    bolt: Bolt, *, looks: bool = True, beside: float = 0.0, torque: float = 4.0, log: Log | None = None
) -> tuple[TightenResult, BoltStation]:
    """Do a job with a nut that is measured so far beside its place [m]."""
    offset = InHandOffset(along=0.012, spin=0.3, tilt_x=0.1, tilt_y=-0.1)
    with bolt_station(CONFIG, SEED, SimOptions(offset=offset), bolt) as sim:
        tool = sim.world.tool.tool
        X_hand_tool = hand_model(CONFIG.hand).grasp.X_hand_tool(tool.handle.grip_radius)
        grasp = Grasp(X_hand_tool, tool.ee(Category.WRENCH_HEAD).X_tool_ee, tool.mass, tool.center_of_mass)
        X_base_nut = transform(p=[0.0, beside, 0.0]) @ X_base_bolt(CONFIG.work) @ transform(rotation_z(bolt.flats))
        task = TighteningTask(
            sim.station, SeenJaw(sim.judge) if looks else None, CONFIG, grasp, NutWork(X_base_nut, torque=torque),
            observer=log,
        )  # fmt: skip
        result = task.run()
        q = sim.world.robot.arm_state()[0]
        assert np.abs(q - CONFIG.scene.home).max() < 5e-3, "it is parked"
    return result, sim


@pytest.mark.sim(seconds=40)
def test_a_nut_is_tightened_stroke_by_stroke_and_the_arm_parked() -> None:
    log = Log()
    result, sim = tighten(SOON_TIGHT, log=log)
    assert (result.outcome, result.success) == (Outcome.TIGHTENED, True), result.reason
    nut = sim.world.nut
    assert nut.torque == pytest.approx(4.0, rel=0.25)
    assert result.torque == pytest.approx(nut.torque, rel=0.15)
    assert nut.angle == pytest.approx(0.7 + (nut.torque - 0.15) / 3.5, abs=1e-6)
    assert len(result.turns) == 2, "a sixth of a turn each"
    assert sum(turn.angle for turn in result.turns) == pytest.approx(nut.angle, abs=0.15)
    assert sim.world.slips == 0
    assert log.force < 60.0, "what a hand holds"
    order = [name for name in log.motions if name in ("above the nut", "onto the nut", "turn", "off the nut", "back")]
    assert order[:3] == ["above the nut", "onto the nut", "turn"]
    assert order[-1] == "off the nut"
    assert order.count("back") == 1, "turned back beside the nut, for the next stroke"
    assert log.motions[-1] == "home"


@pytest.mark.nightly
@pytest.mark.sim(seconds=40)
def test_the_side_of_a_misplaced_nut_is_felt() -> None:
    result, sim = tighten(SOON_TIGHT, beside=0.0025)
    assert result.outcome is Outcome.TIGHTENED, result.reason
    assert sim.world.nut.torque == pytest.approx(4.0, rel=0.25)


@pytest.mark.nightly
@pytest.mark.sim(seconds=40)
def test_a_tight_nut_is_told_from_one_that_was_tightened() -> None:
    result, sim = tighten(Bolt(NutSpec(run=-3.0, stiffness=3.5), Jaw(), flats=0.3))
    assert result.outcome is Outcome.ALREADY_TIGHT, result.reason
    assert not result.success
    assert sim.world.nut.angle < 0.02
    assert len(result.turns) == 1


@pytest.mark.nightly
@pytest.mark.sim(seconds=60)
def test_without_a_look_the_jaw_misses_the_nut() -> None:
    result, sim = tighten(SOON_TIGHT, looks=False)
    assert result.outcome in (Outcome.NOT_TIGHT, Outcome.SLIPPED_OFF)
    assert sim.world.nut.torque < 1.0


@pytest.mark.nightly
@pytest.mark.sim(seconds=20)
def test_a_nut_out_of_reach_ends_the_job() -> None:
    result, _ = tighten(SOON_TIGHT, beside=1.5)
    assert result.outcome is Outcome.OUT_OF_REACH
    assert not result.turns


@pytest.mark.parametrize(
    ("option", "value", "said"), [("--torque", "9", "2 to 4 Nm"), ("--seed", "-1", "--seed -1")], ids=["torque", "seed"]
)
def test_what_cannot_be_is_refused(
    option: str, value: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["sim", "tighten", option, value, "--out", str(tmp_path)]) == 2
    assert said in capsys.readouterr().err

"""Ablations: the alternatives to flow matching sample correctly; rows train, are evaluated and tabulated."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from toolee_robot.cli.app import run
from toolee_robot.end_effectors import Category
from toolee_robot.perception.offline.pose.config import TrainConfig
from toolee_robot.perception.offline.pose.recipe import DefaultRecipe
from toolee_robot.perception.offline.research import ablations
from toolee_robot.perception.offline.research.ablation_variants import POOLINGS, UncentredGenerator
from toolee_robot.perception.offline.research.tooleenet.rk45 import Rk45
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudConfig
from toolee_robot.perception.offline.synthetic_clouds.generator import CloudGenerator
from toolee_robot.perception.offline.synthetic_clouds.surface_samples import sample_hands, sample_tools
from toolee_robot.perception.pose.network import NetworkConfig
from toolee_robot.perception.pose.processes.edm import Edm
from toolee_robot.perception.pose.processes.flow import Euler, Process, RectifiedFlow
from toolee_robot.perception.pose.processes.variance_exploding import VarianceExploding

pytestmark = pytest.mark.sim

MEAN, SPREAD = torch.tensor([0.3, -0.8]), torch.tensor([0.3, 0.9])


@pytest.mark.parametrize("process", [RectifiedFlow(), Edm(high=40.0), VarianceExploding(start=1.0)])
def test_training_pairs_and_sampler_of_a_process_belong_together(process: Process) -> None:
    """The best linear network on the training pairs of a Gaussian, near each t, samples that Gaussian."""
    generator = torch.Generator().manual_seed(0)
    target = MEAN + SPREAD * torch.randn(200_000, 2, generator=generator)
    noised = process.noised(target, 1, generator)
    u, t, goal = noised.u[:, 0], noised.t[:, 0], noised.goal[:, 0]
    order = t.argsort()
    centres, slopes, offsets = [], [], []
    for rows in order.chunk(400):
        du, dg = u[rows] - u[rows].mean(0), goal[rows] - goal[rows].mean(0)
        slope = (du * dg).mean(0) / du.square().mean(0)
        centres.append(t[rows].mean())
        slopes.append(slope)
        offsets.append(goal[rows].mean(0) - slope * u[rows].mean(0))
    centre, slope, offset = torch.stack(centres), torch.stack(slopes), torch.stack(offsets)

    def network(u: Tensor, t: Tensor) -> Tensor:
        right = torch.searchsorted(centre, t.contiguous()).clamp(1, len(centre) - 1)
        share = ((t - centre[right - 1]) / (centre[right] - centre[right - 1])).clamp(0, 1)[..., None]
        return torch.lerp(slope[right - 1], slope[right], share) * u + torch.lerp(
            offset[right - 1], offset[right], share
        )

    data = Euler(60)(process, network, torch.randn(1, 4000, 2, generator=generator))[0]
    torch.testing.assert_close(data.mean(0), MEAN, atol=0.08, rtol=0)
    torch.testing.assert_close(data.std(0), SPREAD, atol=0.08, rtol=0)


def test_edm_solved_exactly_by_rk45() -> None:
    process = Edm(high=80.0)

    def network(u: Tensor, t: Tensor) -> Tensor:
        sigma = (4 * t).exp()[..., None]
        skip, out, scale = process._factors(sigma)
        x = u / scale
        denoised = (SPREAD**2 * x + sigma**2 * MEAN) / (SPREAD**2 + sigma**2)
        return (denoised - skip * x) / out

    data = Rk45()(process, network, torch.randn(1, 4000, 2, generator=torch.Generator().manual_seed(1)))[0]
    torch.testing.assert_close(data.mean(0), MEAN, atol=0.04, rtol=0)
    torch.testing.assert_close(data.std(0), SPREAD, atol=0.03, rtol=0)


def test_poolings_agree_on_one_tight_mode_and_clustering_survives_flips() -> None:
    rng = np.random.default_rng(0)
    group = Category.WRENCH_HEAD.symmetry
    R_true = Rotation.random(random_state=1)
    Xs = np.tile(np.eye(4), (60, 1, 1))
    Xs[:, :3, :3] = (R_true * Rotation.from_rotvec(rng.normal(0, 0.02, (60, 3)))).as_matrix()
    Xs[:, :3, 3] = rng.normal(0, 0.001, (60, 3))
    for pooling in POOLINGS.values():
        assert group.rotation_error(pooling(Xs, group)[:3, :3], R_true.as_matrix()) < np.deg2rad(1.5)
    Xs[:20, :3, :3] = (R_true * Rotation.from_euler("z", 70, degrees=True)).as_matrix()
    Xs[:20, 0, 3] += 0.03
    errors = {
        name: group.rotation_error(pooling(Xs, group)[:3, :3], R_true.as_matrix()) for name, pooling in POOLINGS.items()
    }
    assert errors["cluster"] < np.deg2rad(2)
    assert errors["cluster"] < errors["robust"] < errors["mean (the paper's)"]


def test_uncentred_clouds_are_the_same_clouds() -> None:
    samples, hands = sample_tools(False, 1, 1), sample_hands(2)
    centred = CloudGenerator(samples, hands, "cpu", 3, CloudConfig()).generate(24)
    seen = UncentredGenerator(samples, hands, "cpu", 3, CloudConfig()).generate(24)
    back = (seen.points - seen.centre[:, None]) @ centred.R_canonical.mT
    torch.testing.assert_close(back, centred.points, atol=1e-4, rtol=0)
    torch.testing.assert_close(centred.R_canonical @ seen.R, centred.R, atol=1e-5, rtol=0)


@pytest.mark.nightly
def test_rows_train_resume_and_are_tabulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = NetworkConfig(width=32, layers=1, heads=2, neighbours=8, flow_width=32, flow_blocks=1)
    names = ("base", "flow", "no-direction")
    rows = {}
    for name in names:
        recipe = ablations.ROWS[name].recipe
        assert isinstance(recipe, DefaultRecipe)
        rows[name] = replace(ablations.ROWS[name], recipe=replace(recipe, config=tiny))
    monkeypatch.setattr(ablations, "ROWS", rows)
    monkeypatch.setattr(ablations, "KS", (2,))
    monkeypatch.setattr(ablations, "STEPS", (2,))
    samples = sample_tools(False, 1, 1), sample_tools(True, 1, 1)
    config = TrainConfig(
        device="cpu", max_steps=2, batch=8, chunk=16, first_fill=16, capacity=32, validation=8, reuse=100
    )
    for name in names:
        ablations.run_row(name, tmp_path, config, samples, sample_hands(2))
    text = ablations.write_table(tmp_path)
    table = json.loads((tmp_path / "ablations.json").read_text())
    assert [r["row"] for r in table if r["row"] in names] == sorted(names, key=list(rows).index)
    assert {"K", "steps", "pooling"} <= {r["what"] for r in table}
    assert all(r["steps"] == 2 for r in table if r["row"] in names)
    assert len(text.splitlines()) == 2 + len(table) + 2
    assert list((tmp_path / "flow").glob("ablation-*.safetensors"))
    before = (tmp_path / "flow" / "row.json").read_text()
    ablations.run_row("flow", tmp_path, config, samples, sample_hands(2))
    assert (tmp_path / "flow" / "row.json").read_text() == before


def test_unknown_rows_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["train", "ablations", "--out", str(tmp_path), "--rows", "base,nothing"]) == 2
    assert "choose from base" in capsys.readouterr().err

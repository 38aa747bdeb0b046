"""The paper's estimator: its encoder, its sampler against exact answers, its pooling, its training."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from torch import Tensor

from tests.errors import raises
from tests.examples import seldom
from tests.paper_weights import untrained_paper_weights
from toolee_robot.cli.app import run
from toolee_robot.end_effectors import Category
from toolee_robot.errors import AssetError, TooleeError, UserError
from toolee_robot.frames import transform
from toolee_robot.perception import ToolPerception
from toolee_robot.perception.offline.research.tooleenet_training import (
    ColumnTraining,
    PaperOptions,
    PreparedClouds,
    category_priors,
    freeze_batchnorm,
    paper_source,
)
from toolee_robot.perception.offline.synthetic_clouds.rendered import RenderedClouds
from toolee_robot.perception.offline.training.loop import Distributed
from toolee_robot.perception.pose.canonical import farthest_points_first
from toolee_robot.perception.pose.cloud_estimator import PoseResult, with_hand
from toolee_robot.perception.pose.processes import Euler, VarianceExploding
from toolee_robot.perception.pose.tooleenet import COLUMNS, PaperEstimator, estimator
from toolee_robot.perception.pose.tooleenet.estimator import (
    NAME,
    Rk45,
    class_ambiguity,
    decode,
    encode,
    mean_pose,
    scatter,
    solve,
)
from toolee_robot.perception.pose.tooleenet.network import (
    Level,
    PaperNet,
    PointNet2,
    SharedMlp,
    ball_query,
)
from toolee_robot.perception.weight_files import load_weights, save_weights
from toolee_robot.types import HoldingHand, PoseHypotheses

CPU = Distributed(0, 1, torch.device("cpu"))
MEAN, SPREAD = torch.tensor([0.5, -0.3, 0.1]), torch.tensor([0.2, 0.6, 1.0])
SMALL = (
    Level(64, (0.02, 0.04), (8, 16), ((8, 16), (8, 16))),
    Level(16, (0.04, 0.08), (8, 16), ((16, 32), (16, 32))),
    Level(0, (), (), ((32, 64), (32, 64))),
)


@pytest.mark.sim
@pytest.mark.parametrize("sampler", [Rk45(), Euler(200)])
def test_the_samplers_recover_a_gaussian_from_its_exact_score(sampler: Rk45 | Euler) -> None:
    process = VarianceExploding(start=1.0)

    def field(u: Tensor, t: Tensor) -> Tensor:
        sigma = process.tau(t)[..., None]
        return -sigma * (u - MEAN) / (SPREAD**2 + sigma**2)

    u = sampler(process, field, torch.randn(2, 4000, 3, generator=torch.Generator().manual_seed(0)))
    torch.testing.assert_close(u.mean((0, 1)), MEAN, atol=0.03, rtol=0)
    covariance = torch.cov(u.flatten(0, 1).T)
    torch.testing.assert_close(covariance, torch.diag(SPREAD**2), atol=0.05, rtol=0)


@pytest.mark.sim
def test_rk45_agrees_with_scipy_and_each_row_has_its_own_step() -> None:
    y = torch.randn(3, 2, dtype=torch.double, generator=torch.Generator().manual_seed(1))
    stiffness = torch.tensor([1.0, 5.0, 40.0], dtype=torch.double)

    def derivative(t: Tensor, y: Tensor) -> Tensor:
        return stiffness[: len(y), None] * torch.stack([y[:, 1], -y[:, 0]], -1) * t.cos()[:, None]

    ours = solve(derivative, y, 0.0, 2.0, 1e-8, 1e-8)
    for row, k in enumerate(stiffness.tolist()):
        reference = solve_ivp(
            lambda t, v, k=k: k * np.cos(t) * np.array([v[1], -v[0]]), (0, 2), y[row].numpy(), rtol=1e-10, atol=1e-10
        )
        np.testing.assert_allclose(ours[row].numpy(), reference.y[:, -1], atol=1e-5)
    # A stiff neighbour in the batch changes nothing.
    torch.testing.assert_close(solve(derivative, y[:1], 0.0, 2.0, 1e-8, 1e-8), ours[:1], atol=0, rtol=0)
    with raises(TooleeError, code="toolee.stiff_ode"):
        solve(derivative, y, 0.0, 2.0, 1e-12, 1e-12, most_steps=5)


@pytest.mark.sim
def test_pointnet_sees_where_a_cloud_is_and_the_whole_of_each_ball() -> None:
    torch.manual_seed(0)
    net = PointNet2(SMALL).eval()
    points = farthest_points_first(0.03 * torch.randn(2, 400, 3), 64)
    assert net(points).shape == (2, net.size)
    assert not torch.allclose(net(points), net(points + 0.01))  # as the paper's encoder
    centre = points.norm(dim=-1).argmin(1)
    centres = points[torch.arange(2), centre][:, None]
    near = ball_query(centres, points, 0.04, 16)[:, 0]
    for of, chosen in zip((points - centres).norm(dim=-1), near, strict=True):
        inside = of[of < 0.04]
        assert len(inside) > 32
        assert len(chosen.unique()) == 16
        assert of[chosen].max() < 0.04
        assert of[chosen].mean() > inside.sort()[0][:32].mean(), "of the whole ball, not the nearest"


def plain_balls(centres: Tensor, points: Tensor, order: Tensor, radius: float, count: int) -> Tensor:
    """As the published kernel: go through the points, take those within the radius, repeat the first."""
    found = torch.zeros(*centres.shape[:2], count, dtype=torch.long)
    for b, c in np.ndindex(*centres.shape[:2]):
        away = (points[b] - centres[b, c]).square().sum(-1)
        inside = [int(i) for i in order if away[i] < radius**2][:count]
        found[b, c] = torch.tensor(inside + inside[:1] * (count - len(inside)))
    return found


def plainly(net: PointNet2, points: Tensor) -> Tensor:
    """PointNet++ as it is written down: every group's coordinates and features side by side, then the shared MLP."""
    feature: Tensor | None = None
    for level, stage in zip(net.levels, net.stages, strict=True):
        centres = points[:, : level.centres] if level.centres else torch.zeros(len(points), 1, 3)
        order = torch.arange(points.shape[1]) if feature is not None else net.order[net.order < points.shape[1]]
        scales = []
        for mlp, radius, count in zip(
            stage.children(), level.radii or (torch.inf,) * 2, level.neighbours or (points.shape[1],) * 2, strict=True
        ):
            assert isinstance(mlp, SharedMlp)
            near = plain_balls(centres, points, order, radius, count)
            batch = torch.arange(len(points))[:, None, None]
            x = points[batch, near] - centres[:, :, None]
            if feature is not None:
                x = torch.cat([x, feature[batch, near]], dim=-1)
            for linear, norm in zip(mlp.linears, mlp.norms, strict=True):
                x = torch.relu(norm(linear(x).flatten(0, 2)).view(*x.shape[:3], -1))
            scales.append(x.max(2)[0])
        points, feature = centres, torch.cat(scales, dim=-1)
    assert feature is not None
    return feature[:, 0]


@pytest.mark.sim
@pytest.mark.parametrize("frozen", [False, True])
def test_pointnet_and_its_gradients_are_those_of_the_plain_definition(frozen: bool) -> None:
    """With the balls' points found at once or before, and with normalisation by the batch or by kept statistics."""
    torch.manual_seed(0)
    net = PointNet2(SMALL)
    points = farthest_points_first(0.02 * torch.randn(3, 150, 3), 64) + torch.tensor([0.1, 0.0, 0.05])
    net(points)
    freeze_batchnorm(net, frozen)
    weight, neighbours = torch.randn(3, net.size), net.neighbours(points)
    results = []
    for encode_ in (net, lambda points: net(points, neighbours), lambda points: plainly(net, points)):
        net.zero_grad()
        feature = encode_(points)
        (feature * weight).sum().backward()
        results.append([feature, *(p.grad.clone() for p in net.parameters() if p.grad is not None)])
    assert len(results[0]) == 1 + len(list(net.parameters()))
    for ours, stored, plain in zip(*results, strict=True):
        torch.testing.assert_close(ours, stored, atol=0, rtol=0)
        torch.testing.assert_close(ours, plain, atol=1e-4, rtol=1e-3)


@pytest.mark.sim
def test_the_published_sizes() -> None:
    encoder = PointNet2()
    assert encoder.size == 1024
    assert sum(p.numel() for p in encoder.parameters()) == pytest.approx(1.0e6, rel=0.1)
    net = PaperNet()
    assert sum(p.numel() for p in net.parameters()) == pytest.approx(2.5e6, rel=0.05)


@pytest.mark.sim
def test_pose_vectors_there_and_back() -> None:
    R = torch.as_tensor(Rotation.random(20, random_state=0).as_matrix(), dtype=torch.float32)
    p = torch.randn(20, 3)
    for S in (None, class_ambiguity()[torch.arange(20) % 4]):
        back, p_back, S_back = decode(encode(R, p, S))
        torch.testing.assert_close(back, R, atol=1e-5, rtol=0)
        torch.testing.assert_close(p_back, p)
        torch.testing.assert_close(S_back, torch.zeros(20, 3) if S is None else S)


@pytest.mark.sim
def test_a_translation_is_learnt_and_given_from_the_mean_of_the_cloud() -> None:
    """The published code centres the pose, not the input: millimetres are to be learnt, not half a metre."""
    stored, column = stored_clouds(24), COLUMNS["symmetry-aware"]
    net = PaperNet(column.dim)
    clouds = PreparedClouds.of(net, column, stored, paper_source(stored, column, "cpu", 0), torch.arange(24))
    assert clouds.points.norm(dim=-1).min() > 0.4
    p = stored.X_camera_ee[:, :3, 3]
    torch.testing.assert_close(clouds.target[:, -3:], torch.as_tensor(p) - clouds.points.mean(1))
    assert clouds.target[:, -3:].abs().max() < 0.02
    batch = paper_source(stored, column, "cpu", 0).rows(torch.arange(24))
    exact = clouds.target[:, None].repeat(1, 20, 1)
    estimator = PaperEstimator(net, column, sampler=lambda _process, _field, _noise: exact)
    categories = [list(Category)[int(k)] for k in batch.category]
    draws = torch.Generator().manual_seed(0)
    results = estimator.infer(batch.cloud, categories, batch.direction, batch.visible.numpy(), draws, 20)
    np.testing.assert_allclose([r.X_camera_ee for r in results], stored.X_camera_ee, atol=1e-5)


@pytest.mark.sim
def test_mean_pooling_keeps_the_axis_of_a_free_spin_and_fails_on_flips() -> None:
    R = Rotation.random(random_state=3)
    spins = Rotation.from_rotvec(np.linspace(0, 2 * np.pi, 40, endpoint=False)[:, None] * [0.0, 0.0, 1.0])
    Xs = np.tile(np.eye(4), (40, 1, 1))
    Xs[:, :3, :3] = (R * spins).as_matrix()
    np.testing.assert_allclose(mean_pose(Xs)[:3, 2], R.as_matrix()[:, 2], atol=1e-9)
    wrench = Category.WRENCH_HEAD.symmetry
    tilt = Rotation.from_rotvec(np.random.default_rng(0).normal(0, 0.05, (40, 3)))
    flips = Rotation.from_rotvec(np.pi * (np.arange(40) % 2)[:, None] * np.asarray(wrench.axis))
    Xs[:, :3, :3] = (R * tilt * flips).as_matrix()
    plain, knowing = (wrench.rotation_error(mean_pose(Xs, g)[:3, :3], R.as_matrix()) for g in (None, wrench))
    assert knowing < np.deg2rad(3)
    assert plain > np.deg2rad(10)


@pytest.mark.sim
@pytest.mark.parametrize("labelled", [True, False])
def test_a_spin_that_the_samples_agree_on_is_the_hands_where_the_symmetry_label_says_so(labelled: bool) -> None:
    """The scatter of the axis is the samples' either way, and of an axis of no group everything is."""
    category, rng = Category.HAMMER_HEAD, np.random.default_rng(0)
    true, tilt = Rotation.random(random_state=3), Rotation.from_rotvec(rng.normal(0, 0.05, (400, 3)) * [1, 1, 0])
    spin = Rotation.from_rotvec([0.0, 0.0, 2.0]) * Rotation.from_rotvec(rng.normal(0, 0.02, (400, 3)) * [0, 0, 1])
    Xs = np.tile(np.eye(4), (400, 1, 1))
    Xs[:, :3, :3], Xs[:, :3, 3] = (true * tilt * spin).as_matrix(), rng.normal(0.5, 0.004, (400, 3))
    X = mean_pose(Xs)
    covariance = scatter(Xs, X, category.symmetry, 0.0 if labelled else 1.0)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)[:3]), 0.004, rtol=0.15)
    R = X[:3, :3]
    np.testing.assert_allclose(np.sqrt(np.diag(R.T @ covariance[3:, 3:] @ R))[:2], 0.05, rtol=0.15)
    hypotheses = PoseHypotheses(Xs, np.zeros((1, 3)), 0.0, 0.0, 0.0)
    result = PoseResult(
        category, X, covariance, 1.0, True, "ok", hypotheses, np.zeros(0), np.array([0.0, 0.0, labelled])
    )
    hand = HoldingHand(transform(true.as_matrix() @ category.spec.R_tool_ee.T, [0.0, 0.0, 0.0]), np.eye(3))
    fixed = with_hand(result, hand)
    off = Rotation.from_matrix(true.as_matrix().T @ fixed.X_camera_ee[:3, :3]).magnitude()
    assert (off < 0.1) == labelled
    assert (off > 1.5) == (not labelled)
    spread = scatter(Xs, X, Category.HAMMER_GRIP.symmetry, 1.0)
    assert np.sqrt(R[:, 2] @ spread[3:, 3:] @ R[:, 2]) == pytest.approx(0.02, rel=0.2)


@pytest.mark.sim
def test_a_job_takes_no_estimator_of_whole_tools(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(-0.02, 0.02, (400, 3)) + np.array([0.0, 0.0, 0.5])
    loaded = PaperEstimator.load_for_job(untrained_paper_weights(tmp_path / "ends"))
    assert loaded.estimate(points, Category.HAMMER_HEAD).usable, "it has no confidence"
    with raises(UserError, code="user.paper_column"):
        PaperEstimator.load_for_job(untrained_paper_weights(tmp_path / "tools", "object-prior"))
    with raises(AssetError, code="asset.missing") as missing:
        PaperEstimator.load_for_job(tmp_path)
    assert all(command in str(missing.value) for command in ("dataset generate", "train clouds", "train paper"))


@pytest.mark.sim
def test_the_pipeline_takes_it_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UserError, match="no estimator 'paper'"):
        ToolPerception.load(estimator="paper")  # type: ignore[arg-type]
    monkeypatch.setattr(estimator, "SHIPPED", tmp_path)
    with raises(AssetError, code="asset.missing"):
        ToolPerception.load(estimator="tooleenet")
    untrained_paper_weights(tmp_path)
    pose = ToolPerception.load(estimator="tooleenet").pose
    assert isinstance(pose, PaperEstimator)
    assert pose.column.name == "symmetry-aware"


@pytest.mark.nightly
def test_the_shipped_weights_repeat_the_papers_column(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["evaluate", "table1", "--images", "1", "--json"]) == 0
    groups = json.loads(capsys.readouterr().out)["groups"]
    seen, held_out = (groups[group]["table"]["average"] for group in ("seen", "held-out"))
    assert seen["instances"] > 55
    assert held_out["instances"] > 45
    assert seen["paper_10deg5cm"] > 0.95, "0.998 of 5,479 clouds when the weights were made"
    assert held_out["paper_10deg5cm"] > 0.9, "0.985 of 4,019"


def stored_clouds(count: int, of_tool: bool = False) -> RenderedClouds:
    """Clouds of flat rings, each with 60 to 120 points, half a metre from the camera."""
    rng = np.random.default_rng(0)
    R = Rotation.random(count, random_state=0).as_matrix()
    p = rng.uniform([-0.2, -0.1, 0.45], [0.2, 0.1, 0.55], (count, 3))
    X_camera_ee = np.stack([transform(*pose) for pose in zip(R, p, strict=True)])
    X_tool_ee = transform(np.eye(3), [0.0, 0.0, 0.1])
    counts = rng.integers(60, 120, count)
    angle = rng.uniform(0, 2 * np.pi, counts.sum())
    ring = 0.015 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    of = np.repeat(np.arange(count), counts)
    nothing, zeros = np.empty((0, 3), np.float32), np.zeros(count, np.int64)
    return RenderedClouds(
        points=(np.einsum("nij,nj->ni", R[of], ring) + p[of]).astype(np.float32),
        guessed=nothing,
        rest=nothing,
        counts=np.stack([counts, zeros, zeros], 1),
        X_camera_ee=X_camera_ee.astype(np.float32),
        X_camera_tool=(X_camera_ee @ np.linalg.inv(X_tool_ee)).astype(np.float32),
        of_tool=np.full(count, of_tool),
        p_camera_hand=p.astype(np.float32),
        category=np.arange(count) % len(Category),
        positive=zeros == 0,
        visible=counts,
        tells_spin=zeros,
        occlusion=zeros.astype(np.float32),
    )


FEW = PaperOptions(batch=16, judged=4, draws=4, epochs=8, freeze_epochs=4, ema=0.5, log_every=1, device="cpu")
"""Two steps an epoch of 40 clouds."""


def trained(out: Path, column: str = "symmetry-aware", **options: object) -> ColumnTraining:
    column_, few = COLUMNS[column], replace(FEW, **options)  # type: ignore[arg-type]
    clouds = stored_clouds(44, column_.of_tool)
    training = ColumnTraining(out, few, column_, clouds, CPU)
    training.loop()
    return training


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PointNet2.__init__, "__defaults__", (SMALL,))
    monkeypatch.setattr(ColumnTraining, "log_seconds", 0.0)


@pytest.mark.sim
@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("column", seldom("symmetry-aware", "object-prior", "ee-symmetry-prior"))
def test_every_column_learns_and_its_weights_load(column: str, tmp_path: Path) -> None:
    training = trained(tmp_path, column, epochs=30, freeze_epochs=10)
    losses = [entry["loss"] for entry in training.log]
    assert np.mean(losses[-5:]) < 0.8 * np.mean(losses[:5])
    points = np.random.default_rng(0).uniform(-0.02, 0.02, (400, 3)) + np.array([0.0, 0.0, 0.5])
    loaded = PaperEstimator.load(tmp_path).estimate(points, Category.WRENCH_HEAD, seed=1)
    before = PaperEstimator(training.export(), COLUMNS[column]).estimate(points, Category.WRENCH_HEAD, seed=1)
    np.testing.assert_allclose(loaded.X_camera_ee, before.X_camera_ee, atol=1e-4)
    assert loaded.hypotheses.Xs_camera_ee.shape == (20, 4, 4)
    if column != "symmetry-aware":
        np.testing.assert_array_equal(loaded.ambiguous, [1, 0, 0])
    priors = category_priors(stored_clouds(44))
    np.testing.assert_allclose(priors[:, :3, 3], np.tile([0.0, 0.0, 0.1], (4, 1)), atol=1e-6)


@pytest.mark.usefixtures("small")
def test_a_training_starts_from_the_weights_of_its_column(tmp_path: Path) -> None:
    before = trained(tmp_path / "before", max_steps=2)
    training = ColumnTraining(tmp_path / "after", FEW, COLUMNS["symmetry-aware"], stored_clouds(44), CPU)
    training.start_from(tmp_path / "before")
    for name, value in before.export().state_dict().items():
        assert torch.equal(value, training.net.state_dict()[name]), name
        if value.is_floating_point():
            assert torch.equal(value, training.average[name]), name
    other = ColumnTraining(tmp_path / "other", FEW, COLUMNS["ee"], stored_clouds(44), CPU)
    with pytest.raises(UserError, match="symmetry-aware, this training of ee"):
        other.start_from(tmp_path / "before")


@pytest.mark.nightly
@pytest.mark.sim
@pytest.mark.usefixtures("small")
def test_an_interrupted_training_gives_the_weights_of_one_without_a_break(tmp_path: Path) -> None:
    """Broken off within an epoch, and after the epoch from which on the norms keep their statistics."""
    whole = trained(tmp_path / "whole")
    assert whole.steps_per_epoch == 2
    assert whole.step == 16
    for steps in (3, 11, None):
        parted = trained(tmp_path / "parted", max_steps=steps)
    assert parted.step == 16
    for name, value in whole.net.state_dict().items():
        assert torch.equal(value, parted.net.state_dict()[name]), name
    for name, value in whole.averaged().items():
        assert torch.equal(value, parted.averaged()[name]), name
    seen = {int(x) for name, x in whole.net.named_buffers() if name.endswith("num_batches_tracked")}
    assert seen == {4 * 2}, "batch statistics for four epochs of two steps"
    rates = [entry["lr"] for entry in whole.log]
    assert rates[0] == pytest.approx(1e-3 / FEW.warmup_steps)
    assert whole.schedule(0.0) == pytest.approx(0.98**8)


@pytest.mark.sim
@pytest.mark.usefixtures("small")
def test_a_training_stops_on_a_loss_that_is_not_finite(tmp_path: Path) -> None:
    with raises(TooleeError, code="toolee.training_diverged"):
        trained(tmp_path, lr=1e30)


@pytest.mark.sim
def test_weights_that_learnt_another_translation_are_refused(tmp_path: Path) -> None:
    """Those of before 30 November 2026 know no order of points, and their translation is the camera's."""
    untrained_paper_weights(tmp_path)
    tensors, card = load_weights(tmp_path, NAME)
    del tensors["encoder.order"]
    save_weights(tmp_path, NAME, tensors, card)
    with raises(AssetError, code="asset.unreadable") as earlier:
        PaperEstimator.load(tmp_path)
    assert "train them again" in str(earlier.value)

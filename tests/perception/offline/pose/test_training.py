"""The pose network, its training clouds and its training, at the smallest size that still shows the behaviour."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.errors import raises
from toolee_robot.end_effectors import Category
from toolee_robot.errors import AssetError, PerceptionError, UserError
from toolee_robot.frames import transform_points
from toolee_robot.perception.offline.synthetic_clouds.batch import CloudBatch, CloudConfig
from toolee_robot.perception.offline.synthetic_clouds.generator import CloudGenerator
from toolee_robot.perception.offline.synthetic_clouds.surface_samples import (
    Float32,
    SurfaceSamples,
    sample_hands,
    sample_tools,
)
from toolee_robot.perception.offline.training.loop import Distributed
from toolee_robot.perception.offline.training.pose_losses import augment, canonical_rotation, context, pose_loss
from toolee_robot.perception.offline.training.pose_training import TrainConfig, Trainer, judge, train
from toolee_robot.perception.pose import PoseEstimator, weights
from toolee_robot.perception.pose.canonical import MIN_POINTS
from toolee_robot.perception.pose.confidence import fit
from toolee_robot.perception.pose.network import NetworkConfig, PoseNet, Seen
from toolee_robot.tools import ToolKind, make_tool
from toolee_robot.types import HoldingHand

pytestmark = pytest.mark.sim

CPU = Distributed(0, 1, torch.device("cpu"))

TINY = NetworkConfig(width=32, layers=1, heads=2, neighbours=8, flow_width=64, flow_blocks=1)
CLEAN = CloudConfig(
    hand_share=0.0,
    occluder_share=0.0,
    mask_error_share=0.0,
    chunk_share=0.0,
    negative_share=0.0,
    sensor_level=0.0,
    other_cut_share=0.0,
    border_share=0.0,
)


@pytest.fixture(scope="module")
def samples() -> SurfaceSamples:
    return sample_tools(held_out=False, seeds_per_kind=1, workers=1)


@pytest.fixture(scope="module")
def hands() -> Float32:
    return sample_hands(4)


@pytest.fixture(scope="module")
def clouds(samples: SurfaceSamples, hands: Float32) -> CloudBatch:
    return CloudGenerator(samples, hands, "cpu", 0).collect(32, 48)


def test_clean_clouds_lie_on_the_tools_surface(samples: SurfaceSamples, hands: Float32) -> None:
    batch = CloudGenerator(samples, hands, "cpu", 1, CLEAN).collect(12, 16)
    for i in range(len(batch)):
        # Back in the EE's frame every point is within the radius and near a surface sample.
        local = (batch.points[i] - batch.p[i]) @ batch.R[i]
        surface = torch.as_tensor(samples.ee_points[int(batch.item[i])])
        category = list(Category)[int(batch.category[i])]
        assert float(local.norm(dim=-1).max()) < category.spec.radius + 0.004
        distance = torch.cdist(local, surface).min(1).values
        assert float(distance.median()) < 0.0015
        assert float(distance.quantile(0.95)) < 0.004


@pytest.mark.nightly
def test_the_confidence_is_fitted_on_clouds_of_every_category(samples: SurfaceSamples, clouds: CloudBatch) -> None:
    """A claw's row follows that of its hammer's head: half of the rows, instead of half of the tools, had no claw."""
    model = judge(PoseNet(TINY), clouds, samples, "cpu")[1].confidence
    share = dict(zip(model.names, model.mean, strict=True))
    for category in Category:
        assert share[f"is_{category}"] > 0.05


@pytest.mark.nightly
def test_the_rest_may_begin_beyond_the_cut(samples: SurfaceSamples, hands: Float32) -> None:
    gaps = []
    for share in (0.0, 1.0):
        config = replace(CLEAN, rest_gap_share=share, rest_gap=0.02, rest_error_share=0.0, rest_chunk_share=0.0)
        batch = CloudGenerator(samples, hands, "cpu", 2, config).collect(24, 32)
        distance = torch.cdist(batch.rest, batch.points).amin((1, 2))[batch.rest_known]
        gaps.append(float(distance.median()))
    assert gaps[0] < 0.006
    assert gaps[0] + 0.004 < gaps[1] < 0.02


@pytest.mark.nightly
def test_masks_may_be_cut_at_another_radius(samples: SurfaceSamples, hands: Float32) -> None:
    batch = CloudGenerator(samples, hands, "cpu", 1, replace(CLEAN, other_cut_share=1.0)).collect(24, 32)
    nominal = torch.tensor([list(Category)[int(c)].spec.radius for c in batch.category])
    reach = ((batch.points - batch.p[:, None]).norm(dim=-1).max(1).values) / nominal
    assert float(reach.min()) < 0.75
    assert float(reach.max()) > 1.2


@pytest.mark.nightly
def test_the_image_may_end_near_the_end_effector(samples: SurfaceSamples, hands: Float32) -> None:
    """What lies beyond is not seen, and counts as hidden. (Of this seed no tool hides its own end effector.)"""
    whole, ended = (
        CloudGenerator(samples, hands, "cpu", 2, replace(CLEAN, border_share=share)).collect(48, 64)
        for share in (0.0, 1.0)
    )
    assert float(whole.occlusion.max()) < 0.02
    assert float((ended.occlusion > 0.1).float().mean()) > 0.3
    assert float(ended.visible.mean(dtype=torch.float32)) < 0.9 * float(whole.visible.mean(dtype=torch.float32))


@pytest.mark.nightly
def test_the_rest_of_the_tool_is_its_surface_beyond_the_end_effector(samples: SurfaceSamples, hands: Float32) -> None:
    clean = replace(CLEAN, rest_error_share=0.0, rest_chunk_share=0.0, wrong_rest_share=0.0)
    batch = CloudGenerator(samples, hands, "cpu", 1, clean).collect(12, 16)
    assert int(batch.rest_known.sum()) >= 10
    for i in np.flatnonzero(batch.rest_known.numpy()):
        local = (batch.rest[i] - batch.p[i]) @ batch.R[i]
        item = int(batch.item[i])
        # Denser than the samples, which are more than 4 mm apart on a large tool.
        kind, seed = samples.names[item].split("/")[0].split("-")
        points, _, _ = make_tool(ToolKind(kind), int(seed)).sample_surface(40_000, np.random.default_rng(0))
        points = transform_points(samples.X_ee_tool[item].astype(np.float64), points)
        surface = torch.as_tensor(points, dtype=local.dtype)
        assert float(torch.cdist(local, surface).min(1).values.median()) < 0.004
        radius = list(Category)[int(batch.category[i])].spec.radius
        assert float((local.norm(dim=-1) > radius - 0.008).float().mean()) > 0.95


def test_what_the_sensor_loses_is_completed_where_the_mask_says_that_it_is(
    samples: SurfaceSamples, hands: Float32
) -> None:
    batch = CloudGenerator(samples, hands, "cpu", 1, replace(CLEAN, sensor_level=1.0)).collect(12, 16)
    marked = batch.completed > 0
    assert 0.05 < float(marked.float().mean()) < 0.6
    for i in range(len(batch)):
        local = (batch.points[i] - batch.p[i]) @ batch.R[i]
        distance = torch.cdist(local[marked[i]], torch.as_tensor(samples.ee_points[int(batch.item[i])])).min(1).values
        assert float(distance.median()) < 0.004
    alone = CloudGenerator(samples, hands, "cpu", 1, replace(CLEAN, guessed=False)).collect(12, 16)
    assert not bool(alone.completed.any())


def test_hard_clouds_are_noisy_occluded_and_partly_negative(clouds: CloudBatch, samples: SurfaceSamples) -> None:
    assert bool(torch.isfinite(clouds.points).all())
    assert int(clouds.visible.min()) >= MIN_POINTS
    positive = clouds.positive
    assert 0.6 < float(positive.float().mean()) < 1.0
    assert float(clouds.occlusion[positive].max()) <= 0.7
    truth = torch.as_tensor(samples.category)[clouds.item]
    assert bool((clouds.category == truth)[positive].all())
    torch.testing.assert_close(clouds.direction[:, :3].norm(dim=-1), torch.ones(len(clouds)))


def test_augmentation_keeps_clouds_and_poses_together(samples: SurfaceSamples, hands: Float32) -> None:
    batch = CloudGenerator(samples, hands, "cpu", 2, CLEAN).collect(16, 24)
    turned = augment(batch, torch.Generator().manual_seed(0))
    R = turned.R
    torch.testing.assert_close(R @ R.mT, torch.eye(3).expand_as(R), atol=1e-5, rtol=0)
    assert bool((torch.linalg.det(R) > 0).all())
    # A mirrored hammer, screwdriver or claw is the same tool: the points still lie on its surface.
    mirror_in_y = [i for i in range(len(batch)) if int(batch.category[i]) != list(Category).index(Category.WRENCH_HEAD)]
    for i in mirror_in_y:
        local = (turned.points[i] - turned.p[i]) @ R[i]
        surface = torch.as_tensor(samples.ee_points[int(batch.item[i])])
        assert float(torch.cdist(local, surface).min(1).values.median()) < 0.002
    canonical = canonical_rotation(R, turned.category)
    for i, category in enumerate(turned.category):
        group = list(Category)[int(category)].symmetry
        assert group.rotation_error(canonical[i].double().numpy(), R[i].double().numpy()) < 1e-3


def test_the_loss_goes_down_and_the_sampler_is_deterministic(clouds: CloudBatch) -> None:
    torch.manual_seed(0)
    net = PoseNet(TINY)
    optimizer = torch.optim.AdamW(net.parameters(), 3e-3)
    generator = torch.Generator().manual_seed(0)
    batch = clouds.select(torch.arange(16))
    losses = []
    for _ in range(40):
        loss, _ = pose_loss(net, batch, 4, generator, net.process)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        losses.append(loss.item())
    assert np.mean(losses[-5:]) < 0.7 * np.mean(losses[:3])


def small(minutes: float) -> TrainConfig:
    return TrainConfig(
        minutes=minutes, batch=8, chunk=24, first_fill=24, capacity=64, validation=24, reuse=100, ema=0.9
    )


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, samples: SurfaceSamples, hands: Float32) -> Path:
    out = tmp_path_factory.mktemp("weights")
    Trainer(out, small(0.03), (samples, samples), hands, CPU, network=TINY).run()
    return out


def test_training_writes_weights_that_load_to_the_same_network(
    trained: Path,
    samples: SurfaceSamples,
    hands: Float32,
    capsys: pytest.CaptureFixture[str],
) -> None:
    card = json.loads((trained / "pose.json").read_text())
    assert card["report"]["steps"] > 0
    assert set(card["sigma_scale"]) == {c.value for c in Category}
    assert "10deg_2cm" in card["report"]["K20"]["average"]
    assert (trained / "log.jsonl").read_text().count("\n") >= 2
    # A second run finds its time used up, resumes and exports the same weights.
    (shard,) = trained.glob("pose-*.safetensors")
    before = shard.read_bytes()
    trainer = Trainer(trained, small(0.03), (samples, samples), hands, CPU, network=TINY)
    capsys.readouterr()
    trainer.run()
    assert shard.read_bytes() == before
    assert shard.stat().st_mode == (trained / "pose.json").stat().st_mode, "others may read it"
    said = capsys.readouterr().out.splitlines()
    assert any('"finished"' in line for line in said)
    assert all(len(line) < 300 for line in said), "the tables are in the log"
    checkpoint = trained / trainer.checkpoint_path.name
    sound = checkpoint.read_bytes()
    for damaged in (b"", sound[: len(sound) // 2], bytes(len(sound))):
        checkpoint.write_bytes(damaged)
        with raises(UserError, code="user.checkpoint") as refused:
            Trainer(trained, small(0.03), (samples, samples), hands, CPU, network=TINY).run()
        assert str(checkpoint) in str(refused.value)
    checkpoint.write_bytes(sound)
    points = np.random.default_rng(0).uniform(-0.02, 0.02, (400, 3)) + np.array([0.0, 0.0, 0.5])
    a = PoseEstimator.load(trained).estimate(points, Category.HAMMER_HEAD, seed=1)
    b = PoseEstimator.load(trained).estimate(points, Category.HAMMER_HEAD, seed=1)
    np.testing.assert_array_equal(a.X_camera_ee, b.X_camera_ee)
    exported = PoseEstimator(trainer.export(), PoseEstimator.load(trained).calibration)
    c = exported.estimate(points, Category.HAMMER_HEAD, seed=1)
    np.testing.assert_allclose(a.X_camera_ee, c.X_camera_ee, atol=1e-6)


def test_estimates_are_complete_and_follow_the_hand(trained: Path) -> None:
    estimator = PoseEstimator.load(trained)
    points = np.random.default_rng(0).uniform(-0.02, 0.02, (400, 3)) + np.array([0.1, 0.0, 0.5])
    X_camera_hand = np.eye(4)
    X_camera_hand[:3, 3] = [0.1, 0.2, 0.5]
    rest = points + np.linspace(0.03, 0.2, 400)[:, None] * [0.0, 1.0, 0.0]
    rest[:3] = np.nan
    alone = estimator.estimate(points, Category.SCREWDRIVER_HEAD, rest)
    held = estimator.estimate(points, Category.SCREWDRIVER_HEAD, rest, HoldingHand(X_camera_hand, np.eye(3)))
    np.testing.assert_allclose(held.X_camera_ee[:3, 2], alone.X_camera_ee[:3, 2], atol=1e-9)
    assert alone.hypotheses.Xs_camera_ee.shape == (20, 4, 4)
    assert np.linalg.eigvalsh(alone.covariance).min() > 0
    assert 0 <= alone.confidence <= 1
    assert alone.usable == (alone.reason == "ok")
    guessed = points[:100] + np.array([0.0, 0.004, 0.0])
    with_rim = estimator.estimate(points, Category.SCREWDRIVER_HEAD, rest, completed=guessed)
    assert not np.allclose(with_rim.X_camera_ee, alone.X_camera_ee)
    # Without any of these points it is as if they were not given.
    unseen = estimator.estimate(points, Category.SCREWDRIVER_HEAD, np.empty((0, 3)))
    np.testing.assert_array_equal(unseen.X_camera_ee, estimator.estimate(points, Category.SCREWDRIVER_HEAD).X_camera_ee)
    assert not np.allclose(unseen.X_camera_ee, alone.X_camera_ee)


def test_too_few_points_are_refused_and_nan_does_not_count(trained: Path) -> None:
    estimator = PoseEstimator.load(trained)
    points = np.full((200, 3), np.nan)
    points[:20] = np.random.default_rng(0).uniform(-0.02, 0.02, (20, 3)) + np.array([0, 0, 0.5])
    with raises(PerceptionError, code="perception.too_few_points", says="20 points of the claw"):
        estimator.estimate(points, Category.HAMMER_GRIP)


def test_a_training_starts_from_weights_of_its_architecture(
    tmp_path: Path, trained: Path, samples: SurfaceSamples, hands: Float32
) -> None:
    def trainer(width: int) -> Trainer:
        return Trainer(tmp_path, small(1.0), (samples, samples), hands, CPU, network=replace(TINY, width=width))

    begun = trainer(TINY.width)
    begun.start_from(trained)
    kept = weights.load(trained)[0].state_dict()
    assert all(torch.equal(value, kept[name]) for name, value in begun.net.state_dict().items())
    assert all(torch.equal(value, kept[name]) for name, value in begun.export().state_dict().items())
    with raises(AssetError, code="asset.architecture"):
        trainer(2 * TINY.width).start_from(trained)


def test_a_training_may_keep_a_share_of_the_weights_it_started_from(
    tmp_path: Path, trained: Path, samples: SurfaceSamples, hands: Float32
) -> None:
    config = replace(small(1.0), init_share=0.25)
    trainer = Trainer(tmp_path, config, (samples, samples), hands, CPU, network=TINY)
    trainer.start_from(trained)
    with torch.no_grad():
        for name, _ in trainer.net.named_parameters():
            trainer.average[name].add_(1.0)
    before = weights.load(trained)[0].state_dict()
    for name, value in trainer.export().named_parameters():
        torch.testing.assert_close(value, before[name] + 0.75, atol=2e-3, rtol=2e-3)
    with raises(UserError, code="user.init_share"):
        train(tmp_path / "without", config)


def test_the_mirrored_view_is_the_view_of_the_mirror_image(trained: Path, clouds: CloudBatch) -> None:
    net = weights.load(trained)[0]
    few = clouds.select(torch.arange(8))
    x = torch.tensor([-1.0, 1.0, 1.0])
    direction = torch.cat([few.direction[:, :3] * x, few.direction[:, 3:]], 1)
    other = replace(few, points=few.points * x, rest=few.rest * x, direction=direction)
    seen, image = (Seen.of(b.cloud, b.category, b.direction, context(b)) for b in (few, other))
    with torch.inference_mode():
        both = net.encode(seen, mirror=True)
        torch.testing.assert_close(both, torch.cat([net.encode(seen), net.encode(image)]), atol=1e-5, rtol=1e-4)


def test_missing_or_broken_weights_say_what_to_do(tmp_path: Path) -> None:
    with raises(AssetError, code="asset.missing"):
        PoseEstimator.load(tmp_path)
    (tmp_path / "pose.json").write_text("{}")
    with raises(AssetError, code="asset.missing"):
        PoseEstimator.load(tmp_path)


def test_confidence_is_calibrated_on_what_it_was_fitted_to() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(4000, 15))
    success = (rng.random(4000) < 1 / (1 + np.exp(-(1 + 2 * x[:, 0] - x[:, 3])))).astype(float)
    model = fit(x, success)
    p = model.probability(x)
    for low in (0.1, 0.4, 0.7):
        rows = (p > low) & (p < low + 0.2)
        assert success[rows].mean() == pytest.approx(p[rows].mean(), abs=0.06)
    assert success[p >= model.threshold].mean() > 0.93

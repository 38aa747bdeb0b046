"""The networks in bfloat16, as on CPUs with matrix units for it, against float32."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.errors import raises
from tests.perception.data_sets import frames
from toolee_robot.errors import UserError
from toolee_robot.perception import precision
from toolee_robot.perception.detection.instances import mask_iou
from toolee_robot.perception.detection.segmenter import Segmenter
from toolee_robot.perception.offline.dataset.scenes import load_scenes
from toolee_robot.perception.offline.evaluation.examples import collect
from toolee_robot.perception.pose import PoseEstimator, weights
from toolee_robot.perception.pose.network import PoseNet
from toolee_robot.perception.precision import prefers_bfloat16, single_thread, torch_device

swift = pytest.mark.skipif(
    "AVX512" not in torch.backends.cpu.get_cpu_capability(),
    reason="bfloat16 without AVX-512 is emulated, slowly: not what is shipped there",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return frames(tmp_path_factory, "test")


@pytest.mark.nightly
@swift
def test_the_detector_finds_the_same(folder: Path) -> None:
    data = load_scenes([folder / "test" / "000000"])
    exact, fast = Segmenter.load(bfloat16=False), Segmenter.load(bfloat16=True)
    seen = 0
    for i in range(len(data)):
        frame = data.frame(i)
        also = fast.instances(frame)
        for one in exact.instances(frame):
            if one.score > 0.3:
                like = max((o for o in also if o.label == one.label), key=lambda o: mask_iou(one.mask, o.mask))
                assert mask_iou(one.mask, like.mask) > 0.9
                assert like.score == pytest.approx(one.score, abs=0.05)
                seen += 1
    assert seen >= 3


@swift
def test_poses_are_the_same_to_a_fraction_of_their_error(folder: Path) -> None:
    examples = collect(folder)
    exact, fast = (PoseEstimator(*weights.load(), bfloat16=b) for b in (False, True))
    seen = 0
    for case in examples.cases["truth"]:
        if not case.cloud.usable:
            continue
        both = [
            e.estimate(case.cloud.points, case.category, case.cloud.rest, completed=case.cloud.completed)
            for e in (exact, fast)
        ]
        if both[0].confidence > 0.9:
            X, Y = (result.X_camera_ee for result in both)
            assert np.linalg.norm(X[:3, 3] - Y[:3, 3]) < 5e-4
            assert case.category.symmetry.rotation_error(X[:3, :3], Y[:3, :3]) < np.deg2rad(0.5)
            assert both[1].confidence == pytest.approx(both[0].confidence, abs=0.02)
            seen += 1
    assert seen >= 2


@pytest.mark.parametrize("packs", [pytest.param(True, marks=swift), False])
@pytest.mark.parametrize("bias", [True, False])
def test_packed_weights_give_what_the_layer_gives(packs: bool, bias: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not packs:
        monkeypatch.setattr(precision, "_PACKS", False)  # as without the operator or the CPU instructions for it
    network = torch.nn.Sequential(torch.nn.Linear(40, 24, bias=bias), torch.nn.SiLU(), torch.nn.Linear(24, 7))
    x = torch.randn(2, 33, 40)
    wanted = copy.deepcopy(network).to(torch.bfloat16)(x.to(torch.bfloat16))
    with torch.no_grad():
        precision.in_bfloat16(network)
        assert not any(isinstance(m, torch.nn.Linear) for m in network.modules())
        torch.testing.assert_close(network(x), wanted)


def test_the_network_that_an_estimator_is_given_stays_as_it_is() -> None:
    net = PoseNet()
    PoseEstimator(net, bfloat16=True)
    assert {p.dtype for p in net.parameters()} == {torch.float32}


def test_a_gpu_is_left_to_its_own_arithmetic() -> None:
    assert not prefers_bfloat16(torch.device("cuda"))


def test_a_device_that_is_not_there_is_refused_by_its_name() -> None:
    assert torch_device("cpu") == torch.device("cpu")
    for name in ("cuda:77", "gpu"):
        with raises(UserError, code="user.device") as raised:
            torch_device(name)
        assert name in str(raised.value)


def test_the_other_threads_come_back_after_an_error() -> None:
    inside = []

    @single_thread()
    def fails() -> None:
        inside.append(torch.get_num_threads())
        raise ValueError("inside")

    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        with pytest.raises(ValueError, match="inside"):
            fails()
        assert inside == [1]
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)

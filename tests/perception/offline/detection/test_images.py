"""The trainer reads what the data-set generator writes."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.errors import raises
from tests.perception.toy_scenes import toy_scenes
from toolee_robot.errors import AssetError
from toolee_robot.perception.detection.detector import TOOL
from toolee_robot.perception.detection.inputs import STRIDE
from toolee_robot.perception.offline.dataset.records import HEIGHT, WIDTH, EeTable, Example
from toolee_robot.perception.offline.dataset.scenes import load, write_scene
from toolee_robot.perception.offline.dataset.spec import DESCRIPTION, DatasetSpec
from toolee_robot.perception.offline.evaluation.segmentation import true_instances
from toolee_robot.perception.offline.training.detector_training import instances_from_maps
from toolee_robot.perception.offline.training.image_training import DeviceStore, SceneStream
from toolee_robot.perception.offline.training.images import DeviceImages, augment
from toolee_robot.types import CameraIntrinsics


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    scenes = toy_scenes(3, height=HEIGHT, width=WIDTH)
    examples = []
    for i in range(3):
        table = EeTable.empty()
        category = table.category.copy()
        category[0] = scenes.categories[i, 0]
        depth = np.full((HEIGHT, WIDTH), 800, np.uint16)
        camera = CameraIntrinsics(365.5, 365.5, 254.9, 205.4, WIDTH, HEIGHT)
        table = replace(table, category=category)
        table.obj_id[0] = 1
        table.visible[0] = np.count_nonzero(scenes.ee[i])
        examples.append(Example(scenes.rgb[i], depth, scenes.ee[i], scenes.tool[i], table, camera, 0, scenes.ee[i]))
    write_scene(tmp_path / "000000", examples)
    return tmp_path


def test_a_data_set_becomes_targets(folder: Path) -> None:
    images = load(folder)
    data = DeviceImages(images, torch.device("cpu"))
    sample = data.sample(3)
    categories = sample.categories
    batch, maps = augment(sample, (HEIGHT, WIDTH), strength=0.0)
    assert batch.pixels.shape[2] % STRIDE == 0
    assert batch.pixels.shape[3] % STRIDE == 0
    torch.testing.assert_close(batch.depth[:, :HEIGHT, :WIDTH], torch.full((3, HEIGHT, WIDTH), 0.8))
    torch.testing.assert_close(batch.focal, torch.full((3,), 365.5))
    instances = instances_from_maps(maps, categories, data.tools)
    for b in range(3):
        labels = sorted(instances.labels[b][instances.labels[b] > 0].tolist())
        assert labels == [int(categories[b, 0]), TOOL]
        for g in torch.nonzero(instances.labels[b])[:, 0].tolist():
            seen = (maps[b, instances.plane[b, g]] == instances.ids[b, g]).numpy()
            rows, columns = np.nonzero(seen)
            box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
            assert instances.boxes[b, g].tolist() == box


def test_evaluation_sees_the_same_instances(folder: Path) -> None:
    images = load(folder)
    labels = [label for label, *_ in true_instances(images, 1)]
    assert labels == [int(images.categories[1, 0]), TOOL]
    assert true_instances(images, 1)[0][1].sum() == (images.ee[1] == 1).sum()


@pytest.mark.nightly
def test_ranks_share_a_data_set_without_overlap_while_it_grows(folder: Path) -> None:
    streams = [SceneStream(folder, (rank, 2)) for rank in range(2)]
    try:
        assert [len(images.rgb) for images in streams[0].take(60.0)] == [3]
        assert streams[1].take() == []
        shutil.copytree(folder / "000000", folder / ".000001.part")
        (folder / ".000001.part").rename(folder / "000001")
        assert [len(images.rgb) for images in streams[1].take(60.0)] == [3]
        assert streams[0].take() == []
    finally:
        for stream in streams:
            stream.close()


def test_memory_is_taken_once_for_all_images_that_the_data_set_promises(tmp_path: Path) -> None:
    """A growing copy beside the old one would need 2.5 times the memory, which a GPU has not."""
    spec = DatasetSpec("hard", size=10, test_share=0.0, scene_size=4)
    (tmp_path / DESCRIPTION).write_text(json.dumps(spec.to_json()))
    for rank, count in ((0, 4 + 2), (1, 4)):
        stream = SceneStream(tmp_path / "train", (rank, 2))
        stream.close()
        assert stream.expected == count
    scenes = toy_scenes(2)
    for expected, rows in ((7, (7, 7, 7, 12)), (0, (2, 4, 6, 12))):
        store = DeviceStore(torch.device("cpu"), tools=True, expected=expected)
        for k, more in enumerate((scenes, scenes, scenes, toy_scenes(6))):
            place = store.rgb.data_ptr()
            store.extend(more)
            assert len(store.rgb) == rows[k], "also more than was promised"
            assert not 0 < k < 3 or (store.rgb.data_ptr() == place) is (expected > 0)
        assert len(store) == 12
        torch.testing.assert_close(store.rgb[4:6], torch.from_numpy(scenes.rgb))


def test_a_folder_without_data_is_named(tmp_path: Path) -> None:
    with raises(AssetError, code="asset.no_scene"):
        load(tmp_path)

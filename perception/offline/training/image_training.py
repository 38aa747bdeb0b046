"""Labelled images for trainings: a stream of scenes that appear, storage on a device, and the run on them."""

from __future__ import annotations

import os
import queue
import threading
from abc import abstractmethod
from collections import deque
from concurrent.futures import Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from toolee_robot.errors import TooleeError, UserError
from toolee_robot.perception.offline.dataset.scenes import SegmentationSet, load_scenes, scene_folders
from toolee_robot.perception.offline.dataset.spec import DESCRIPTION, DatasetSpec, refuse_test_set
from toolee_robot.perception.offline.processes import WorkerPool
from toolee_robot.perception.offline.training.loop import TrainingRun
from toolee_robot.perception.offline.training.options import CHECKPOINT, CONFIG, TrainingOptions, options_of, remember
from toolee_robot.perception.weight_files import save_weights

_CHUNK = 512
"""Images copied to the device at a time."""


class DeviceStore:
    """A data set, or one rank's part of it, as bytes on the device.

    It may grow: of its M rows the first `len` are images.

    Args:
        device: torch device.
        tools: Whether to store the ids of tools, too.
        expected: Number of images that will come, for which memory is taken with the first ones. Without it, and beyond
            it, the rows are copied into larger ones, and for that time need 2.5 times their memory.

    Attributes:
        rgb: (M, H, W, 3) uint8.
        maps: Ids of EE and, if `tools`, of tool, (M, 1 or 2, H, W) uint8.
        focal: Focal length, (M,) [px].
    """

    def __init__(self, device: torch.device, tools: bool, expected: int = 0) -> None:
        self.device = device
        self._expected = expected
        self._count = 0
        self.rgb = torch.empty((0, 0, 0, 3), dtype=torch.uint8, device=device)
        self._millimetres = torch.empty((0, 0, 0), dtype=torch.int16, device=device)
        self.maps = torch.empty((0, 2 if tools else 1, 0, 0), dtype=torch.uint8, device=device)
        self.focal = torch.empty(0, device=device)

    def __len__(self) -> int:
        return self._count

    def depth(self, which: Tensor) -> Tensor:
        """Depth (B, H, W) float32 [m], 0 where unknown, of the images `which` (B,)."""
        return self._millimetres[which].float() / 1000.0

    def extend(self, more: SegmentationSet) -> None:
        """Add more images, all of one size."""
        first, end = self._count, self._count + len(more.rgb)
        if end > len(self.rgb):
            # Grow geometrically, so that not every scene copies all stored images.
            capacity = max(end, self._expected, 3 * first // 2)
            size = more.rgb.shape[1:3]
            self.rgb = grown(self.rgb, (capacity, *size, 3))
            self._millimetres = grown(self._millimetres, (capacity, *size))
            self.maps = grown(self.maps, (capacity, self.maps.shape[1], *size))
            self.focal = grown(self.focal, (capacity,))
        for start in range(0, len(more.rgb), _CHUNK):
            part = slice(start, min(start + _CHUNK, len(more.rgb)))
            place = slice(first + part.start, first + part.stop)
            self.rgb[place] = torch.from_numpy(more.rgb[part]).to(self.device)
            millimetres = np.minimum(more.depth_mm[part], np.iinfo(np.int16).max).astype(np.int16)
            self._millimetres[place] = torch.from_numpy(millimetres).to(self.device)
            for k, ids in enumerate((more.ee, more.tool)[: self.maps.shape[1]]):
                self.maps[place, k] = torch.from_numpy(ids[part]).to(self.device)
        focal = np.sqrt(more.intrinsics[:, 0] * more.intrinsics[:, 1])
        self.focal[first:end] = torch.from_numpy(focal.astype(np.float32)).to(self.device)
        self._count = end


def grown(old: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Grow a tensor.

    Args:
        old: The tensor.
        shape: The new shape, nowhere smaller.

    Returns:
        A tensor of that shape: the old one in its first corner, zero elsewhere.
    """
    new = old.new_zeros(shape)
    if old.numel():
        new[tuple(slice(n) for n in old.shape)] = old
    return new


_DECODERS = 8
"""Largest number of processes that decode images."""


class SceneStream:
    """The scenes of a split's folder in order, each decoded in a process once it exists.

    A training can begin while `toolee dataset generate` still writes.

    Args:
        folder: Folder of the split.
        part: (i, n): take every n-th scene, from the i-th on.

    Attributes:
        expected: Number of images that the data set's specification promises for that part; 0 without one.
    """

    def __init__(self, folder: Path, part: tuple[int, int] = (0, 1)) -> None:
        self._folder, self._part = folder, part
        self.expected = _expected(folder, part)
        self._decoded: queue.SimpleQueue[SegmentationSet | TooleeError] = queue.SimpleQueue()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def take(self, timeout: float = 0.0) -> list[SegmentationSet]:
        """The images decoded since the last call.

        Args:
            timeout: How long to wait for the first scene [s].

        Returns:
            The images of each scene.

        Raises:
            AssetError: A file is damaged; the message names it.
            TooleeError: A decoding process was killed.
        """
        images: list[SegmentationSet] = []
        while True:
            try:
                item = self._decoded.get(timeout=timeout) if timeout > 0 and not images else self._decoded.get_nowait()
            except queue.Empty:
                return images
            if isinstance(item, TooleeError):
                raise item
            images.append(item)

    def close(self) -> None:
        """Stop the decoding."""
        self._closed.set()
        self._thread.join()

    def _watch(self) -> None:
        workers = max(1, min(_DECODERS, (os.cpu_count() or 1) // (2 * self._part[1])))
        seen: set[Path] = set()
        todo: deque[Path] = deque()
        running: deque[Future[SegmentationSet]] = deque()
        # Processes, because threads would compete with the training for the interpreter's lock.
        with WorkerPool(workers) as pool:
            while not self._closed.is_set():
                if not todo:
                    fresh = [p for p in scene_folders(self._folder) if int(p.name) % self._part[1] == self._part[0]]
                    todo.extend(p for p in fresh if p not in seen)
                    seen.update(todo)
                while todo and len(running) < 2 * workers:
                    running.append(pool.submit(load_scenes, [todo.popleft()], threads=1))
                if not running:
                    self._closed.wait(0.5)
                elif wait([running[0]], 0.5).done:
                    self._decoded.put(_outcome(running.popleft()))


def _expected(folder: Path, part: tuple[int, int]) -> int:
    root = folder.resolve().parent
    if not (root / DESCRIPTION).is_file():
        return 0
    jobs = [job for job in DatasetSpec.read(root).jobs() if job.split == folder.resolve().name]
    return sum(job.last - job.first for job in jobs if job.scene % part[1] == part[0])


def _outcome(decoded: Future[SegmentationSet]) -> SegmentationSet | TooleeError:
    try:
        return decoded.result()
    except TooleeError as error:
        return error
    except BrokenProcessPool:
        return TooleeError(
            "a process that decodes images was killed (out of memory?): the same command resumes the training"
        )


@dataclass(frozen=True)
class ImageTraining(TrainingOptions):
    """A training on the images of a data set.

    Attributes:
        data: Folder of a split.
        out: Folder for checkpoint, weights and log; a run whose checkpoint lies there goes on.
        init: Folder of exported weights to start from.
        patience: How long to wait for the first scene of a data set that is still being generated [s].

    Raises:
        UserError: The data are a test set, or a value is out of range.
    """

    data: Path
    out: Path
    init: Path | None = None
    patience: float = 120.0

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_test_set(self.data)

    def to_json(self) -> dict[str, Any]:
        """The options as a JSON object, without paths of this machine."""
        return {**asdict(self), "data": self.data.name, "out": self.out.name, "init": self.init is not None}


Training = TypeVar("Training", bound=ImageTraining)


def begin(
    kind: type[Training],
    given: dict[str, Any],
    checkpoint: str = CHECKPOINT,
    config: str = CONFIG,
    **own: Path | None,
) -> tuple[Training, bool]:
    """Set up a training and store its options.

    Args:
        kind: The training.
        given: Options of the command line, "data", "out", "init" and "config" (a file of options) among them.
        checkpoint: Name of its checkpoint.
        config: Name of the file that keeps its options.
        **own: Options that no file may give.

    Returns:
        The training, and whether it continues from a checkpoint.

    Raises:
        UserError: The data are missing or a test set, an option is unknown, or another one than when it began.
    """
    data, out = given["data"], given["out"]
    if not data.is_dir():
        raise UserError(f"--data {data} is not a folder: make it with `toolee dataset generate`")
    names = {f.name for f in fields(kind)} - {"data", "out", "model", "init", *own}
    options = options_of(given, given["config"], names) | own
    training = kind(data, out, init=given["init"], **options)
    resumed = (out / checkpoint).is_file()
    about = {name: getattr(training, name) for name in sorted(names)}
    about |= {name: None if path is None else str(path) for name, path in own.items()}
    remember(out, resumed, about, config)
    return training, resumed


class ImageTrainingRun(TrainingRun):
    """A training on images; more may be added while it runs."""

    config: ImageTraining

    @abstractmethod
    def images(self) -> int:
        """Number of images of this rank."""

    @abstractmethod
    def extend(self) -> None:
        """Add the images that have been decoded since."""

    @abstractmethod
    def described(self) -> dict[str, Any]:
        """Description of the network, stored beside the weights."""

    def grow(self) -> dict[str, float]:
        """See `TrainingRun`: add images; their number over all ranks."""
        self.extend()
        return {"images": self.images() * self.distributed.world}

    def write(self) -> None:
        """Write the averaged weights as safetensors, with configuration and log as JSON."""
        description = {
            **self.described(),
            "training": self.config.to_json(),
            "steps": self.step,
            "minutes": self.elapsed / 60,
            "images": self.images() * self.distributed.world,
            "device": self.distributed.device_name,
            "torch": torch.__version__,
            "log": self.log[:: max(1, len(self.log) // 200)],
        }
        save_weights(self.out, self.name, self.averaged(), description)
        print(f"{self.name}: wrote {self.out / self.name}*.safetensors after {self.step} steps", flush=True)

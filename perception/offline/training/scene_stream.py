"""Stream of a data set's scenes for a training, decoded in the background as they appear."""

from __future__ import annotations

import os
import queue
import threading
from collections import deque
from concurrent.futures import Future, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from toolee_robot.errors import TooleeError
from toolee_robot.perception.offline.dataset.scene_reader import load_scenes, scene_folders
from toolee_robot.perception.offline.dataset.spec import DESCRIPTION, DatasetSpec
from toolee_robot.perception.offline.processes import WorkerPool
from toolee_robot.perception.offline.training.labelled_images import SegmentationImages

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
        self._decoded: queue.SimpleQueue[SegmentationImages | TooleeError] = queue.SimpleQueue()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def take(self, timeout: float = 0.0) -> list[SegmentationImages]:
        """The images decoded since the last call.

        Args:
            timeout: How long to wait for the first scene [s].

        Returns:
            The images of each scene.

        Raises:
            AssetError: A file is damaged; the message names it.
            TooleeError: A decoding process was killed.
        """
        images: list[SegmentationImages] = []
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
        running: deque[Future[SegmentationImages]] = deque()
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


def _outcome(decoded: Future[SegmentationImages]) -> SegmentationImages | TooleeError:
    try:
        return decoded.result()
    except TooleeError as error:
        return error
    except BrokenProcessPool:
        return TooleeError(
            "a process that decodes images was killed (out of memory?): the same command resumes the training",
            code="toolee.process_killed",
        )

"""Rendered frames for several files of tests, made once for all processes of a run. Nobody writes into them."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from toolee_robot.perception.offline.dataset.scenes import write_scene
from toolee_robot.perception.offline.dataset.spec import DatasetSpec
from toolee_robot.perception.offline.synthesis.example import examples_of
from toolee_robot.perception.offline.synthesis.generate import generate


def _once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    base = factory.getbasetemp()
    root = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
    root.mkdir(exist_ok=True)
    with (root / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (root / "made").exists():
            make(root / "data")
            (root / "made").touch()
    return root / "data"


def frames(factory: pytest.TempPathFactory, split: str) -> Path:
    """Four frames of a split, as a folder with that split."""
    share = 0.5 if split == "test" else 0.0

    def make(folder: Path) -> None:
        (folder / split).mkdir(parents=True)
        write_scene(folder / split / "000000", examples_of(DatasetSpec("hard", 8, 5, share), split, 0, 4))

    return _once(factory, f"frames-{split}", make)


def held_out_tools(factory: pytest.TempPathFactory) -> Path:
    """A data set of 24 images with held-out tools."""
    return _once(factory, "held-out", lambda folder: generate(DatasetSpec("hard", 24, 6, 1.0), folder, 1))

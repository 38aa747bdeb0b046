"""TensorBoard curves of a training, where the `train` extra is installed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

FOLDER = "tensorboard"


class Scalars:
    """Writer of TensorBoard curves in out/tensorboard; without the extra nothing is written.

    Args:
        out: Folder of the training.
    """

    def __init__(self, out: Path) -> None:
        self._out = out
        self._writer: Any = None
        self._tried = False

    def add(self, step: int, values: Mapping[str, Any], under: str = "train") -> None:
        """Write numbers at a step; those of nested mappings under their key.

        Args:
            step: Step of the training.
            values: Names and values; values that are not numbers are skipped.
            under: Prefix of the curves.
        """
        if not self._tried:
            self._tried = True
            try:
                from torch.utils.tensorboard.writer import SummaryWriter
            except ImportError:
                return
            self._writer = SummaryWriter(str(self._out / FOLDER))
        if self._writer is None:
            return
        self._add(step, values, under)
        self._writer.flush()

    def _add(self, step: int, values: Mapping[str, Any], under: str) -> None:
        for name, value in values.items():
            if isinstance(value, Mapping):
                self._add(step, value, f"{under}/{name}")
            elif isinstance(value, int | float) and not isinstance(value, bool):
                self._writer.add_scalar(f"{under}/{name}", value, step)

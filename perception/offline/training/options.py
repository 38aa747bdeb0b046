"""Options of every training: their defaults, what a file and a command give, what is kept beside a checkpoint."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any, ClassVar, get_args, get_type_hints

from toolee_robot.errors import UserError, words_of
from toolee_robot.runtime.files import read_json, write_atomic
from toolee_robot.runtime.yaml_files import read_yaml

CONFIG, CHECKPOINT = "config.json", "checkpoint.pt"
"""Files in the folder of a training: its configuration and its state."""
MOST = 2**31 - 1
"""Largest whole number of an option."""
_AT_LEAST_ONE = {"batch", "max_steps", "log_every", "epochs", "train_seeds", "test_seeds", "validation", "draws"}
_DURATION = {"minutes", "max_steps", "session_minutes", "epochs", "patience"}
_MAY_CHANGE = _DURATION | {"device", "checkpoint_minutes", "log_every", "compile"}


@dataclass(frozen=True, kw_only=True)
class TrainingOptions:
    """The options of every training.

    Attributes:
        minutes: Wall-clock budget of the optimisation; with `max_steps`, whichever ends first. None: `USUAL_MINUTES`,
            or, with `max_steps`, no limit.
        max_steps: Budget in steps.
        session_minutes: Part of the budget that this process uses (None: all that is left); the next one resumes.
        batch: Examples per step and rank.
        lr: Learning rate after the warm-up, decayed over the budget as a cosine.
        warmup_steps: Steps over which the learning rate rises.
        weight_decay: Weight decay of AdamW.
        clip_norm: Largest norm of the gradient.
        ema: Decay of the averaged weights, which are exported.
        seed: Seed of weights, order and augmentation.
        device: "cpu", "cuda", "cuda:1"; "auto": a GPU if there is one, under torchrun one per process.
        checkpoint_minutes: Time between checkpoints [min].
        log_every: Steps between readings of the clock and the loss, each of which waits for the GPU.
        compile: Whether the network is compiled on a GPU.
    """

    USUAL_MINUTES: ClassVar[float] = 12.0
    """Default budget [min]."""

    minutes: float | None = None
    max_steps: int | None = None
    session_minutes: float | None = None
    batch: int = 32
    lr: float = 1e-3
    warmup_steps: int = 200
    weight_decay: float = 0.05
    clip_norm: float = 10.0
    ema: float = 0.999
    seed: int = 0
    device: str = "auto"
    checkpoint_minutes: float = 2.0
    log_every: int = 20
    compile: bool = True

    def __post_init__(self) -> None:
        for name, kind in get_type_hints(type(self)).items():
            if name in self.__dict__ and (why := _wrong(name, kind, getattr(self, name))):
                raise UserError(f"{name}: {why}", code="user.training_options")
        if self.minutes is not None and self.minutes <= 0:
            raise UserError("minutes must be positive", code="user.minutes")
        if not (self.batch > 0 and self.lr > 0 and 0 < self.ema < 1):
            raise UserError("batch and lr must be positive, ema between 0 and 1", code="user.training_options")

    def progress(self, minutes: float, steps: int) -> float:
        """Share of the budget that is used.

        Args:
            minutes: Time used [min].
            steps: Steps done.

        Returns:
            The share, 1 at the end of the budget.
        """
        by_steps = steps / self.max_steps if self.max_steps else 0.0
        limit = self.minutes if self.minutes is not None else None if self.max_steps else self.USUAL_MINUTES
        return by_steps if limit is None else max(by_steps, minutes / limit)


def _wrong(name: str, kind: Any, value: Any) -> str:
    """What is wrong with the value of an option; empty if nothing is. A file may hold anything."""
    kinds = set(get_args(kind) or (kind,)) - {NoneType}
    if not kinds <= {int, float, bool, str} or (value is None and kind not in kinds):
        return ""
    wanted = " or ".join(sorted(kind.__name__ for kind in kinds))
    if type(value) not in (kinds | {int} if float in kinds else kinds):
        return f"{value!r} is no {wanted}"
    if isinstance(value, str | bool):
        return ""
    least, most = (1 if name in _AT_LEAST_ONE else 0), (MOST if type(value) is int else sys.float_info.max)
    return "" if least <= value <= most else f"{value} is not between {least} and {most}"


def options_of(given: dict[str, Any], file: Path | None, names: set[str]) -> dict[str, Any]:
    """Collect the options of a training; those of the command line override those of the file.

    Args:
        given: Those of the command line; None where left out.
        file: YAML or JSON file with options; None without one.
        names: Names of the options.

    Returns:
        Name -> value of the options that are given.

    Raises:
        UserError: The file has an unknown option.
    """
    options: dict[str, Any] = {}
    if file is not None:
        read = read_yaml(file, "options")
        if not isinstance(read, dict) or (unknown := sorted(set(map(str, read)) - names)):
            what = f"has no option {', '.join(unknown)}" if isinstance(read, dict) else "is no mapping of options"
            raise UserError(f"--config {file}: {what}; there are {', '.join(sorted(names))}")
        options |= read
    return options | {k: v for k, v in given.items() if k in names and v is not None}


def remember(out: Path, resume: bool, config: dict[str, Any], name: str = CONFIG) -> None:
    """Store the configuration, or check that a resumed run uses the one it started with.

    Args:
        out: Folder of the training.
        resume: Whether the training continues from a checkpoint.
        config: The configuration.
        name: Name of the configuration file.

    Raises:
        UserError: The configuration has changed, or that of the beginning is damaged.
    """
    path = out / name
    if resume and path.is_file():
        try:
            before = dict(read_json(path))
        except (OSError, ValueError, TypeError) as error:
            raise UserError(
                f"cannot read {path}, the options of the training there: give another --out, or delete it to go on "
                f"with these options ({words_of(error)})",
                code="user.training_config",
            ) from error
        # The duration may change, what is learnt may not.
        changed = {k for k in before.keys() | config.keys() if before.get(k) != config.get(k)} - _MAY_CHANGE
        if changed:
            raise UserError(
                f"{out} was begun with another {', '.join(sorted(changed))} ({path}): use those values or another --out"
            )
    if is_first():
        make_folder(out)
        write_atomic(path, (json.dumps(config, indent=1, default=str) + "\n").encode())


def is_first() -> bool:
    """Whether this process, of those that torchrun started, is the one that writes."""
    return os.environ.get("RANK", "0") == "0"


def make_folder(folder: Path) -> None:
    """Make a folder if it is missing, and look whether it can be written: before the work, which may take hours.

    Args:
        folder: The folder.

    Raises:
        UserError: It cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UserError(f"cannot make or write the folder {folder}: {words_of(error)}; choose another place") from error

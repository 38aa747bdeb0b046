"""Options of the trainings, from a file and the command line, stored beside the checkpoint."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import tyro

from toolee_robot.cli.options import Flag
from toolee_robot.errors import UserError, words_of
from toolee_robot.runtime.files import write_atomic
from toolee_robot.runtime.json_line import json_line
from toolee_robot.runtime.yaml_files import read_yaml

CONFIG = "config.json"
"""File beside the checkpoint with the configuration of the training."""
CHECKPOINT = "checkpoint.pt"
"""Name of the checkpoint in the folder of a training."""
OutDir = Annotated[Path, tyro.conf.arg(metavar="DIR")]
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]
Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]
Number = Annotated[float | None, tyro.conf.arg(metavar="X", help_behavior_hint="")]
Count = Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")]

_MAY_CHANGE = {"minutes", "max_steps", "session_minutes", "device", "checkpoint_minutes", "log_every", "patience"}


@dataclass(frozen=True)
class TrainingCommand:
    """Options of every training."""

    out: OutDir
    """Checkpoint, weights with their configuration, log, TensorBoard curves (extra `train`)."""
    config: File = None
    """YAML or JSON of options, any subset; the command line's win."""
    minutes: Number = None
    """Wall-clock of the optimisation."""
    max_steps: Count = None
    """Budget in steps; with --minutes too, whichever ends first."""
    batch: Count = None
    """Examples a step, of each GPU."""
    lr: Number = None
    """Learning rate (default: 0.001)."""
    seed: Count = None
    """Of weights, order and augmentation (default: 0)."""
    checkpoint_minutes: Number = None
    """Between checkpoints (default: 2)."""
    device: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """cpu, cuda, cuda:1 (default: a GPU if there is one)."""
    init: Folder = None
    """Start from the weights exported there."""
    json: Flag = False
    """Print one line of JSON last on standard output."""

    def end(self, resumed: bool, **more: Any) -> int:
        """Print the result if --json is given, and return the exit code.

        Args:
            resumed: Whether the training continued from a checkpoint.
            more: Further values to print.
        """
        if self.json and is_first():
            print(json_line({"out": str(self.out), "resumed": resumed, **more}), flush=True)
        return 0


def options_of(command: Any, file: Path | None, names: set[str]) -> dict[str, Any]:
    """Collect the options of a training; those of the command line override those of the file.

    Args:
        command: The command, a dataclass.
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
            raise UserError(
                f"--config {file}: {what}; there are {', '.join(sorted(names))}", code="user.unknown_option"
            )
        options |= read
    given = {f.name: getattr(command, f.name) for f in fields(command) if f.name in names}
    return options | {name: value for name, value in given.items() if value is not None}


def remember(out: Path, resume: bool, config: dict[str, Any], name: str = CONFIG) -> None:
    """Store the configuration, or check that a resumed run uses the one it started with.

    Args:
        out: Folder of the training.
        resume: Whether the training continues from a checkpoint.
        config: The configuration.
        name: Name of the configuration file.

    Raises:
        UserError: The configuration has changed.
    """
    path = out / name
    if resume and path.is_file():
        before = json.loads(path.read_text())
        # The duration may change, what is learnt may not.
        changed = {k for k in before.keys() | config.keys() if before.get(k) != config.get(k)} - _MAY_CHANGE
        if changed:
            raise UserError(
                f"{out} was begun with another {', '.join(sorted(changed))} ({path}): use those values or "
                "another --out",
                code="user.config_changed",
            )
    if is_first():
        make_folder(out)
        write_atomic(path, (json.dumps(config, indent=1, default=str) + "\n").encode())


def is_first() -> bool:
    """Whether this process, of those that torchrun started, is the one that writes."""
    return os.environ.get("RANK", "0") == "0"


def make_folder(folder: Path) -> None:
    """Make a folder if it is missing.

    Args:
        folder: The folder.

    Raises:
        UserError: It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(
            f"cannot make the folder {folder}: {words_of(error)}", code="user.folder_not_writable"
        ) from error

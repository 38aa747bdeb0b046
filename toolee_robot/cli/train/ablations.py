"""`toolee train ablations`: one network for each decision of the design."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from toolee_robot.cli.options import Flag
from toolee_robot.cli.train.options import Count, Number, OutDir, make_folder
from toolee_robot.errors import UserError

_MINUTES = 10.0


@dataclass(frozen=True)
class Ablations:
    """Train one pose network for each design decision, on the same clouds and budget, and write the table.

    Example: toolee train ablations --out runs/ablations --max-steps 30000

    Several processes may share --out, each with its own --rows and --device. The same command again resumes.
    """

    out: OutDir
    """A folder for each row, and ablations.json and ablations.md from all rows that are there."""
    rows: Annotated[str | None, tyro.conf.arg(metavar="NAME,NAME", help_behavior_hint="")] = None
    """Some of the rows (default: all)."""
    minutes: Number = None
    """Training time of each row (default: 10)."""
    max_steps: Count = None
    """Budget of each row in steps; with --minutes too, whichever ends first."""
    batch: Count = None
    """Clouds a step (default: 512)."""
    seed: Count = None
    """Of weights, clouds and order (default: 0)."""
    device: Annotated[str, tyro.conf.arg(metavar="NAME")] = "auto"
    """cpu, cuda, cuda:1; auto: a GPU if there is one."""
    train_seeds: Count = None
    """Tools of each kind to learn from (default: 480)."""
    test_seeds: Count = None
    """Held-out tools of each kind (default: 30)."""
    validation: Count = None
    """Held-out clouds (default: 4096)."""
    table_only: Flag = False
    """Just write the table."""

    def run(self) -> int:
        from toolee_robot.perception.offline.pose.config import TrainConfig
        from toolee_robot.perception.offline.research.ablations import ROWS, run_rows, write_table

        names = list(ROWS) if self.rows is None else [name for name in self.rows.split(",") if name]
        unknown = [name for name in names if name not in ROWS]
        if unknown:
            raise UserError(f"--rows {','.join(unknown)}: choose from {', '.join(ROWS)}", code="user.rows")
        make_folder(self.out)
        if not self.table_only:
            given = {
                name: getattr(self, name)
                for name in ("batch", "seed", "train_seeds", "test_seeds", "validation", "max_steps")
                if getattr(self, name) is not None
            }
            batch = given.get("batch", TrainConfig.batch)
            config = TrainConfig(
                minutes=self.minutes if self.minutes or self.max_steps else _MINUTES,
                device=self.device,
                chunk=max(32, min(TrainConfig.chunk, 4 * batch)),
                first_fill=min(TrainConfig.first_fill, 32 * batch),
                **given,
            )
            run_rows(names, self.out, config)
        print(write_table(self.out))
        return 0

"""Make a synthetic data set.

Example: toolee dataset generate --config hard --size 1000 --out data/hard
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.markup import escape

from toolee_robot.cli.output import Flag, JsonOption, progress_bars
from toolee_robot.depth_noise import SensorKind
from toolee_robot.errors import UserError

if TYPE_CHECKING:
    from toolee_robot.perception.offline.dataset.catalogue import CustomMesh
    from toolee_robot.perception.offline.dataset.spec import DatasetSpec

_Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]


@dataclass(frozen=True)
class Generate(JsonOption):
    """Generate RGB-D examples with masks, poses and clouds.

    The data set has BOP scenes and COCO files.

    Example: toolee dataset generate --config hard --size 1000 --out data/hard

    The same options give the same bytes, with any number of workers. Start an interrupted run again to continue it.
    Train with DIR/train; DIR/test shows held-out tools.
    """

    config: Literal["paper", "hard"]
    """paper: upright tool, no roll, one grasp, no noise. hard: any orientation, hands, occlusion, noise."""
    size: Annotated[int, tyro.conf.arg(metavar="N")]
    """Examples in all."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the data set."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="W", help_behavior_hint="(default: one per core)")] = None
    """Processes at a time."""
    seed: int = 0
    """Seed of the data set."""
    test_share: Annotated[float | None, tyro.conf.arg(metavar="X", help_behavior_hint="(default: 0.1; own: 1)")] = None
    """Share of the examples with held-out tools, textures and backgrounds, from 0 to 1."""
    tools: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Your own tools instead of generated ones, all kept for tests: a folder for each, with tool.yaml
    (docs/dataset.md) and a mesh.
    """
    device: Literal["cpu", "cuda"] = "cpu"
    """Device that renders. cuda: the GPUs of this machine, which the processes share. Pixels may
    differ by a rounding."""
    test_set: Flag = False
    """Mark it as a test set: every evaluation on it is logged (docs/results/protocol.md)."""
    sensor: SensorKind = "time-of-flight"
    """Depth camera of `hard`: docs/dataset.md. mixed draws one for each image."""
    kinds: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: all)")] = None
    """Draw from the first N kinds of tools: 13 for a data set whose dataset.json does not say from how many."""

    def custom_tools(self) -> tuple[CustomMesh, ...]:
        """The tools of `--tools`; none without it.

        Raises:
            UserError: `--kinds` is given as well, or the folder is none of tools.
            ConfigError: A tool's description is invalid.
        """
        if self.tools is None:
            return ()
        if self.kinds is not None:
            raise UserError(
                "give --kinds or --tools, not both: your own tools have no kinds",
                code="user.kinds",
            )
        from toolee_robot.perception.offline.synthesis.custom_tool_reader import read_custom_tools

        return read_custom_tools(self.tools)

    def spec(self, custom_tools: Sequence[CustomMesh]) -> DatasetSpec:
        """What the options ask for.

        Args:
            custom_tools: What `custom_tools` gives.

        Raises:
            UserError: An option is out of range, or two of them exclude each other.
        """
        from toolee_robot.perception.offline.dataset.spec import DatasetSpec

        share = self.test_share if self.test_share is not None else 1.0 if custom_tools else DatasetSpec.test_share
        return DatasetSpec(
            self.config,
            self.size,
            self.seed,
            share,
            tools=tuple(tool.record for tool in custom_tools),
            device=self.device,
            test_set=self.test_set,
            sensor=self.sensor,
            kinds=DatasetSpec.kinds if self.kinds is None else self.kinds,
        )

    def run(self) -> int:
        from toolee_robot.perception.offline.synthesis.generate import Cost, generate

        custom_tools = self.custom_tools()
        spec = self.spec(custom_tools)
        workers = len(os.sched_getaffinity(0)) if self.workers is None else self.workers
        console = self.console
        began = time.monotonic()
        counts: list[int] = []
        with progress_bars(console) as report:

            def count(done: int, total: int) -> None:
                counts.append(done)
                report("rendering", done, total)

            made = generate(spec, self.out, workers, count, custom_tools)
        seconds = time.monotonic() - began
        cost = Cost.of_workers(spec.size - counts[0], seconds) if made else None
        if made:
            console.print(f"{spec.size} examples in {escape(str(self.out))}, {seconds:.0f} s", soft_wrap=True)
            if cost is not None:
                console.print(
                    f"{cost.per_second:.1f} examples/s with {workers} processes, {cost.cpu_ms:.0f} ms of CPU time "
                    f"each, at most {cost.worker_mb:.0f} MB per process"
                )
        else:
            console.print(f"{escape(str(self.out))} already holds these {spec.size} examples", soft_wrap=True)
        record = {"out": str(self.out), "spec": spec.to_json(), "made": made, "seconds": seconds}
        self.tell({**record, "workers": workers, "cost": cost and asdict(cost)})
        return 0


COMMANDS = {"dataset": {"generate": Generate}}

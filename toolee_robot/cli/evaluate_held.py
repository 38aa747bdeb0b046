"""`toolee evaluate held`: perception with the hand's pose, about the hand and in the whole image."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.table import Table

from toolee_robot.cli.evaluate_tables import text_table
from toolee_robot.cli.host_info import describe_machine
from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.cli.progress import progress_bars
from toolee_robot.errors import UserError

if TYPE_CHECKING:
    from toolee_robot.perception.offline.evaluation.held import Seen

_TIMES = ("median_ms", "p90_ms", "median_cpu_ms")


@dataclass(frozen=True)
class EvaluateHeld:
    """Held tools with the hand's pose, as in a job: looked for about the hand, and in the whole image.

    Example: toolee evaluate held data/hard --tools validation

    The frames are those with a tool in a right hand; only its end effectors count. Differences to the whole image are
    paired, ± is half of their 95 % confidence interval, in points. docs/results/protocol.md defines the figures.
    """

    data: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """A data set made by `toolee dataset generate`, or one split's folder of it."""
    tools: Literal["all", "validation", "test"] = "all"
    """Which tools: of the held-out ones half are for validation, by which choices are made, half for tests."""
    limit: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None
    """Only so many frames."""
    pose_error: Annotated[float, tyro.conf.arg(metavar="METRES")] = 0.0
    """Bound of the error of the hand's pose, by which the region is widened."""
    ablate: Flag = False
    """Also crops of other sizes and with further stages, without the whole image after them."""
    weights: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder of weights (the shipped ones if left out)."""
    json: Flag = False
    """Print one line of JSON; everything for people goes to standard error."""

    def run(self) -> int:
        from toolee_robot.perception.offline.evaluation.held import WHOLE, compare, held_tools, perceive, ways
        from toolee_robot.perception.offline.evaluation.ledger import Ledger
        from toolee_robot.perception.pipeline import ToolPerception

        if self.limit is not None and self.limit < 1:
            raise UserError(f"--limit {self.limit}: give 1 or more", code="user.count")
        console = Console(stderr=self.json, highlight=False)
        ledger = Ledger.of(self.data)
        compared = ways(ToolPerception.load(self.weights), self.ablate)
        rows: dict[str, list[Seen]] = {name: [] for name in compared}
        role = None if self.tools == "all" else self.tools
        with progress_bars(console) as report:
            for k, held in enumerate(held_tools(self.data, role, self.limit, self.pose_error)):
                for name, way in compared.items():
                    rows[name].append(perceive(held, way))
                report("frames", k + 1, self.limit or k + 1)
        if not rows[WHOLE]:
            raise UserError(
                f"{self.data} shows no tool of these in a right hand: generate more images", code="user.no_held_tool"
            )
        table = compare(rows, WHOLE)
        if ledger is not None:
            ledger.enter("held", {"ours": self.weights}, table, self.limit)
        for printed in _tables(table):
            console.print(printed)
        if self.json:
            print(json_line({"machine": asdict(describe_machine()), "data": self.data.name, "ways": table}))
        return 0


def _tables(found: dict[str, dict[str, Any]]) -> Iterator[Table]:
    first = next(iter(found.values()))
    keys, heads = ("found", "usable_right", "wrong"), ("", "5deg2cm", "usable, right", "wrong")
    shares, points, times = [], [], []
    for name, row in found.items():
        shares.append([name, *(f"{row[key]:.3f}" for key in keys)])
        differences = ((100 * row[f"{key}_difference"], 100 * row[f"{key}_interval"]) for key in keys)
        points.append([name, *(f"{difference:+.1f} ± {interval:.1f}" for difference, interval in differences)])
        errors = ["–" if row[f"median_{key}"] is None else f"{row[f'median_{key}']:.1f}" for key in ("mm", "deg")]
        times.append([name, *errors, *(f"{row[key]:.0f}" for key in _TIMES), f"{row['whole_image']:.2f}"])
    title = f"{first['frames']} frames, {first['end_effectors']} end effectors"
    yield text_table(title, heads, shares)
    yield text_table("Points against the first row, 95 %", heads, points)
    yield text_table("Medians; CPU ms over all threads", ("", "mm", "deg", "ms", "p90", "CPU ms", "whole image"), times)

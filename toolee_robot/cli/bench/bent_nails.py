"""`toolee bench-bent-nails`: how well the camera sees that a nail leans or is bent, over many simulated labs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.table import Table

from toolee_robot.cli.options import Flag
from toolee_robot.cli.output import json_line
from toolee_robot.cli.progress import progress_bars
from toolee_robot.errors import UserError

if TYPE_CHECKING:
    from toolee_robot.stations.bent_nails import Seen

LEAST_SEEN, MOST_FALSE = 0.95, 0.02
"""Share of bent nails that is to be seen at least, and of straight ones that may be taken for bent ones."""
ROWS = {
    "bent": "bent, head 3 to 8 mm aside",
    "leaning": "leans by 12 to 25° as set",
    "straight": "straight, driven",
    "set": "straight, as set",
}


@dataclass(frozen=True)
class BenchBentNails:
    """Measure how well the camera sees that a nail leans or is bent, over many simulated labs.

    Example: toolee bench-bent-nails --runs 100

    Each run draws a room, the camera's calibration, how a nail was set and how it is driven, and looks at rendered
    frames. A job ends where two looks in a row, two strikes apart, see a nail bent, or the first one sees it lean. Exit
    code 1: a figure is not met.
    """

    runs: Annotated[int, tyro.conf.arg(metavar="N")] = 100
    """Simulated labs."""
    seed: int = 0
    """Seed of the first; the others follow."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="YAML", help_behavior_hint="")] = None
    """Station file, such as `examples/nails.yaml`: of several nails one is looked at after the other."""
    json: Flag = False
    """Print one line of JSON last on standard output; everything for people goes to standard error."""

    def run(self) -> int:
        if self.runs < 5 or self.seed < 0:
            raise UserError("give --runs 5 or more, and --seed 0 or more", code="user.option")
        from toolee_robot.station import load_station
        from toolee_robot.stations.bent_nails import look_at_nails

        config = None if self.config is None else load_station(self.config)
        console = Console(stderr=self.json, highlight=False)
        looks: list[Seen] = []
        with progress_bars(console) as report:
            for k in range(self.runs):
                looks.extend(look_at_nails(self.seed + k, config))
                report("labs", k + 1, self.runs)
        figures = {kind: _figures([look for look in looks if look.kind == kind]) for kind in ROWS}
        table = Table()
        for column in ("nail", "taken for bent or leaning", "job ends", "not seen", "off by, median", "95 %"):
            table.add_column(column, justify="left" if column == "nail" else "right")
        for kind, words in ROWS.items():
            f = figures[kind]
            off = (f"{f[name]:.1f} mm" for name in ("median_mm", "p95_mm"))
            table.add_row(words, f"{f['alarms']} of {f['of']}", f"{f['ends']}", f"{f['unseen']}", *off)
        console.print(table)
        seen = figures["bent"]["alarms"] / figures["bent"]["of"]
        wrong = sum(figures[kind]["alarms"] for kind in ("straight", "set")) / self.runs
        met = seen >= LEAST_SEEN and wrong <= MOST_FALSE
        console.print(f"asked: {LEAST_SEEN:.0%} of the bent ones, {MOST_FALSE:.0%} of the straight ones at most")
        if self.json:
            print(json_line({"runs": self.runs, "seed": self.seed, "looks": figures, "met": met}), flush=True)
        return int(not met)


def _figures(looks: list[Seen]) -> dict[str, float]:
    import numpy as np

    from toolee_robot.tasks.hammering.nail_watch import is_aside, is_bent, leans

    said = [(look, look.found) for look in looks if look.found is not None]
    if looks[0].kind in ("set", "leaning"):
        alarms = ends = sum(leans(found, look.height) for look, found in said)
    else:
        alarms = sum(is_aside(found) for _, found in said)
        ends = sum(is_bent(found, look.later) for look, found in said)
    off = [1e3 * float(np.linalg.norm(found.offset - look.offset)) for look, found in said]
    median, p95 = np.quantile(off, [0.5, 0.95]).tolist() if off else (np.nan, np.nan)
    unseen = len(looks) - len(said)
    return {"of": len(looks), "alarms": alarms, "ends": ends, "unseen": unseen, "median_mm": median, "p95_mm": p95}


COMMANDS = {"": BenchBentNails}

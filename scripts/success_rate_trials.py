"""Success rate of the simulated hammering job over many seeds, with and without the in-hand correction.
Example: `python scripts/success_rate_trials.py --first-seed 100 --trials 20 --jobs 2 --out trials.json`"""

import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import rich
import tyro
from rich.table import Table
from scipy.stats import binomtest


def trial(options: list[str]) -> dict[str, float | None]:
    command = [sys.executable, "-c", "from toolee_robot.cli.app import main; main()", "hammer", "--json", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(f"exit code {done.returncode}:\n{done.stderr}")
    return dict(json.loads(done.stdout.splitlines()[-1]))


def main(first_seed: int = 100, trials: int = 20, jobs: int = 1, out: Path = Path("trials.json")) -> None:
    names = ("blows", "pose_error_mm", "pose_error_deg", "strike_offset_mm", "strike_tilt_deg")
    table, records = Table("mode", "success", "95 % (Wilson)", *(f"median {name}" for name in names)), {}
    for mode, options in {"correction": [], "no correction": ["--no-correction"]}.items():
        todo = [["--seed", str(first_seed + i), *options] for i in range(trials)]
        runs = records[mode] = list(ThreadPoolExecutor(jobs).map(trial, todo))
        wins = sum(bool(run["success"]) for run in runs)
        ci = binomtest(wins, trials).proportion_ci(method="wilson")
        medians = (f"{np.nanmedian(np.array([run.get(name) for run in runs], dtype=float)):.1f}" for name in names)
        table.add_row(mode, f"{wins}/{trials}", f"{ci.low:.2f} to {ci.high:.2f}", *medians)
    out.write_text(json.dumps(records, indent=1) + "\n")
    rich.print(table)


if __name__ == "__main__":
    tyro.cli(main)

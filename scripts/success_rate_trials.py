"""Success rate of the simulated hammering job over many seeds, with and without the in-hand correction.

Example: `python scripts/success_rate_trials.py --first-seed 100 --trials 20 --jobs 2 --out trials.json`
`toolee hammer`'s own options come last: `... --no-baseline -- --arm ur-rtde --robot-host 127.0.0.2 --world pybullet`.
With the driver, a job that ended because the machine itself stalled is repeated, and counted.
"""

import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

AGAIN = 5  # repetitions at most
OUR_OWN = {"--seed", "--no-correction", "--json"}  # of `toolee hammer`, set by the trials


def trial(options: list[str]) -> dict[str, float | None]:
    run, tries = job(options), 1
    while run.get("machine_stalled") and tries <= AGAIN:
        run, tries = job(options), tries + 1
    return {**run, "tries": tries}


def job(options: list[str]) -> dict[str, float | None]:
    command = [sys.executable, "-c", "from toolee_robot.cli import main; main()", "hammer", "--json", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stderr
    return dict(json.loads(done.stdout.splitlines()[-1]))


def median(runs: list[dict[str, float | None]], name: str) -> str:
    """The median over the jobs that have a figure.

    Args:
        runs: The jobs' records.
        name: Key of the figure.

    Returns:
        The median with one decimal; "-" where no job has the figure.
    """
    known = [value for run in runs if (value := run.get(name)) is not None]
    return f"{np.median(known):.1f}" if known else "-"


def main(options: tyro.conf.Positional[tuple[str, ...]] = (), first_seed: int = 100, trials: int = 20, jobs: int = 1,
         baseline: bool = True, out: Path = Path("trials.json")) -> None:  # fmt: skip
    """Run the trials.

    Args:
        options: Of `toolee hammer`, after a `--`.
        first_seed: Each seed is another hammer, grasp and room.
        trials: Jobs of each mode.
        jobs: Side by side.
        baseline: Also without the in-hand correction.
        out: Every job's record, as JSON.
    """
    if given := sorted({option.split("=")[0].replace("_", "-") for option in options} & OUR_OWN):
        print(f"error: {', '.join(given)}: the trials say this themselves (--first-seed, --baseline)", file=sys.stderr)
        raise SystemExit(2)
    names = (
        "strikes",
        "pose_error_mm",
        "pose_error_deg",
        "strike_offset_mm",
        "strike_tilt_deg",
        "robot_seconds",
        "nail_seconds",
    )
    table = Table("mode", "success", "95 % (Wilson)", *(f"median {name}" for name in names))
    records: dict[str, list[dict[str, float | None]]] = {}
    for mode, more in {"correction": [], **({"no correction": ["--no-correction"]} if baseline else {})}.items():
        todo = [["--seed", str(first_seed + i), *more, *options] for i in range(trials)]
        runs = records.setdefault(mode, [])
        for run in ThreadPoolExecutor(jobs).map(trial, todo):
            runs.append(run)
            out.write_text(json.dumps(records, indent=1) + "\n")
            ending = "flush" if run["success"] else f"failed: {run['reason']}"
            tries = "" if run["tries"] == 1 else f", try {run['tries']}: the machine had stalled"
            print(f"{mode}, seed {run['seed']}: {ending}{tries}", file=sys.stderr, flush=True)
        ci = binomtest(wins := sum(bool(run["success"]) for run in runs), trials).proportion_ci(method="wilson")
        table.add_row(mode, f"{wins}/{trials}", f"{ci.low:.2f} to {ci.high:.2f}", *(median(runs, n) for n in names))
    Console(width=None if sys.stdout.isatty() else 180).print(table)  # a file takes whole rows


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)

"""Success rate of the hammering job over many seeds, with and without the in-hand correction.

It does what `toolee trials` does, for a plan that is given here instead of in a file.

Example: `python scripts/success_rate_trials.py --first-seed 100 --trials 20 --jobs 2 --out trials`
"""

import sys
from pathlib import Path

import tyro

from toolee_robot.app.variant import Variant
from toolee_robot.errors import TooleeError
from toolee_robot.trials import TrialPlan, run_trials, write_report
from toolee_robot.trials.plan import InRehearsal, InSimulation
from toolee_robot.trials.results import of_arm, share


def main(first_seed: int = 100, trials: int = 20, jobs: int = 1, baseline: bool = True, exact: bool = False,
         config: str = "", rehearse: str = "", real_time_factor: float | None = None,
         out: Path = Path("trials")) -> None:  # fmt: skip
    """Run the trials.

    Args:
        first_seed: Each seed is another hammer, grasp and room.
        trials: Jobs of each arm.
        jobs: Side by side.
        baseline: Also without the in-hand correction.
        exact: Whether the jobs are told exactly what is there.
        config: Changes of the simulated station, a YAML file.
        rehearse: A lab's station file, to rehearse the jobs instead of simulating them.
        real_time_factor: Of the rehearsals.
        out: Folder of results and report; the same command again goes on where it stopped.
    """
    arms = (Variant.FULL, Variant.NO_CORRECTION) if baseline else (Variant.FULL,)
    try:
        where = InRehearsal(rehearse, real_time_factor) if rehearse else InSimulation(config)
        plan = TrialPlan("Success rate", first_seed, trials, arms, "exact" if exact else "nominal", where)
        records = run_trials(plan, out, jobs, lambda text: print(text, file=sys.stderr, flush=True))
    except (TooleeError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    for arm in arms:
        print(f"{arm.replace('_', ' ')}: {share([record.success for record in of_arm(records, arm)])} flush")
    print(write_report(plan, out))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)

"""Trials: a plan that is fixed before the run, its jobs, and a report that counts them.

plan = load_plan(Path("plan.yaml"))
records = run_trials(plan, Path("trials"), jobs=2, tell=print)
write_report(plan, Path("trials"))
"""

from toolee_robot.trials.attended import lead_trials
from toolee_robot.trials.plan import Trial, TrialPlan, load_plan
from toolee_robot.trials.report import write_report
from toolee_robot.trials.results import Record
from toolee_robot.trials.run import run_trials

"""A plan's trials: paired, resumable, counted once; a plan does not change once they have begun."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import threading
import time
from collections.abc import Sequence
from dataclasses import fields, replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pyarrow import compute, parquet

from tests.errors import raises
from tests.paper_weights import untrained_paper_weights
from toolee_robot.cli.app import run
from toolee_robot.errors import AssetError, ConfigError, TooleeError, UserError
from toolee_robot.frames import transform
from toolee_robot.perception.weight_files import weights_hash
from toolee_robot.runtime.yaml_files import read_record
from toolee_robot.sim_backend.cell_errors import NOMINAL, CellErrors, draw_errors
from toolee_robot.tasks.hammering.learnt_grasp import LEAST_JOBS, learn_shift
from toolee_robot.trials import Arm, Trial, TrialPlan, load_plan, run_trials, write_report
from toolee_robot.trials.attended_plan import option
from toolee_robot.trials.report import ERRORS
from toolee_robot.trials.results import RESULTS, Happened, Record, read_results
from toolee_robot.trials.sweeps import UNITS
from toolee_robot.trials.tasks import check_needed

EXAMPLES = Path(__file__).parents[2] / "examples"
PLAN = TrialPlan("three hammers", 40, 3, (Arm.FULL, Arm.NO_CORRECTION), {"camera_position": 0.004})


def job(options: Sequence[str]) -> dict[str, Any]:
    """A job whose outcome follows from its options alone, as a simulated one's does."""
    seed = int(options[options.index("--seed") + 1])
    success = "--no-correction" not in options and seed != 41
    return {
        "success": success,
        "outcome": "flush" if success else "nail_missed",
        "reason": "for a test; the arm stands still with the tool in the hand. Look at it",
        "stage": "strike" if seed % 2 else "touch",
        "strikes": seed,
        "tool": f"hammer-{seed % 2}",
        "errors": {"camera_mm": float(seed)},
        "run_folder": None,
    }


def finished(plan: TrialPlan, folder: Path) -> list[Record]:
    return read_results(plan, folder)[0]


def quietly(_: str) -> None:
    pass


class Asked:
    """Runs jobs, and keeps what was asked."""

    def __init__(self) -> None:
        self.options: list[list[str]] = []

    def __call__(self, options: Sequence[str]) -> dict[str, Any]:
        self.options.append(list(options))
        return job(options)


def test_every_arm_has_the_same_seeds_and_its_own_options(tmp_path: Path) -> None:
    asked = Asked()
    records = run_trials(PLAN, tmp_path, 1, quietly, asked)
    assert [record.trial for record in records] == [Trial(arm, s) for s in (40, 41, 42) for arm in PLAN.arms]
    assert all(("--no-correction" in options) == (i % 2 == 1) for i, options in enumerate(asked.options))
    assert all(
        Path(options[options.index("--errors") + 1]).read_text() == "camera_position: 0.004\n"
        for options in asked.options
    )
    assert finished(PLAN, tmp_path) == records


def test_seeds_that_are_left_out_are_made_up_for() -> None:
    plan = replace(PLAN, arms=(Arm.FULL,), left_out=(41, 43))
    assert [trial.seed for trial in plan.jobs()] == [40, 42, 44]
    assert plan.hash != PLAN.hash
    assert replace(plan, arms=PLAN.arms, left_out=()).hash == PLAN.hash
    for wrong in (39, 45):
        with pytest.raises(ValueError, match=f"left_out: {wrong}"):
            replace(plan, left_out=(41, wrong))


def _earlier(folder: Path, X_hand_ee: list[list[float]]) -> str:
    """Jobs of the whole system in a folder."""
    for i in range(LEAST_JOBS):
        looks = {"looks": [{"X_hand_ee": X_hand_ee}], "nominal_X_hand_ee": np.eye(4).tolist()}
        whole = {"correction": True, "perfect_perception": False, "ablation": None, "hand": "inspire", "seed": i}
        (folder / f"run{i}").mkdir(parents=True, exist_ok=True)
        (folder / f"run{i}" / "summary.json").write_text(json.dumps({**looks, **whole}))
    return str(folder)


def test_the_learnt_grasp_needs_earlier_jobs_that_stay_as_they_are(tmp_path: Path) -> None:
    earlier = _earlier(tmp_path / "earlier", np.eye(4).tolist())
    plan = replace(PLAN, arms=(Arm.FULL, Arm.LEARNT_GRASP), learnt_from=earlier)

    class Learns(Asked):
        def __call__(self, options: Sequence[str]) -> dict[str, Any]:
            folder = option(options, "--learnt-from")
            learnt = None if folder is None else learn_shift(Path(folder), "inspire").figures
            return {**super().__call__(options), "learnt_grasp": learnt}

    asked = Learns()
    run_trials(plan, tmp_path / "own", 1, quietly, asked)
    given = [(option(one, "--ablation"), option(one, "--learnt-from")) for one in asked.options]
    assert given == [(None, None), ("learnt_grasp", earlier)] * 3
    for arms, folder in ((plan.arms, ""), ((Arm.FULL,), earlier)):
        with pytest.raises(ValueError, match="learnt_from"):
            replace(plan, arms=arms, learnt_from=folder)
    for own in (tmp_path / "earlier", tmp_path / "earlier" / "own", tmp_path):
        with raises(UserError, code="user.learnt_from_own"):
            check_needed(plan, own, ())
    with raises(UserError, code="user.too_few_runs"):
        run_trials(replace(plan, learnt_from=str(tmp_path / "none")), tmp_path / "other", 1, quietly, asked)
    _earlier(tmp_path / "earlier", transform(p=(0.0, 0.01, 0.0)).tolist())
    with raises(UserError, code="user.other_jobs"):
        run_trials(plan, tmp_path / "own", 1, quietly, asked)


@pytest.mark.parametrize("after", [0, 1, 4])
@pytest.mark.parametrize("torn", ["", '{"trial": {"arm": "fu'])
def test_a_run_that_was_ended_goes_on_where_it_stopped(tmp_path: Path, after: int, torn: str) -> None:
    """Whatever was being written when the power went is run again, and nothing that was finished."""
    whole = run_trials(PLAN, tmp_path / "whole", 1, quietly, job)
    lines = (tmp_path / "whole" / RESULTS).read_text().splitlines(keepends=True)
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut" / RESULTS).write_text("".join(lines[: 1 + after]) + torn)
    asked = Asked()
    records = run_trials(PLAN, tmp_path / "cut", 1, quietly, asked)
    assert len(asked.options) == 6 - after
    assert [(r.trial, r.figures) for r in records] == [(r.trial, r.figures) for r in whole]
    assert (tmp_path / "cut" / RESULTS).read_text().count("\n") == 7


@pytest.mark.parametrize("jobs", [1, 3])
def test_a_job_that_crashes_ends_no_other_and_is_tried_again(tmp_path: Path, jobs: int) -> None:
    """One simulation that cannot be built once ended a plan of 720, with 62 jobs under way."""
    told: list[str] = []

    def crashes(options: Sequence[str]) -> dict[str, Any]:
        if "41" in options and "--no-correction" in options:
            raise TooleeError("it died", code="trials.crashed")
        return job(options)

    with raises(TooleeError, code="trials.crashed") as raised:
        run_trials(PLAN, tmp_path, jobs, told.append, crashes)
    assert "1 job crashed, and 1 of the trials are not done" in str(raised.value)
    records, events = read_results(PLAN, tmp_path)
    lost = Trial(Arm.NO_CORRECTION, 41)
    assert [record.trial for record in records] == [trial for trial in PLAN.jobs() if trial != lost]
    assert [(event.what, event.trial) for event in events] == [(Happened.NOT_BEGUN, lost)]
    assert any("seed 41: crashed: it died" in line for line in told)
    asked = Asked()
    assert len(run_trials(PLAN, tmp_path, jobs, quietly, asked)) == 6
    assert len(asked.options) == 1


def test_a_plan_whose_jobs_all_crash_is_given_up(tmp_path: Path) -> None:
    asked: list[Sequence[str]] = []

    def crashes(options: Sequence[str]) -> dict[str, Any]:
        asked.append(options)
        raise TooleeError("no such device", code="trials.crashed")

    with raises(TooleeError, code="trials.crashed"):
        run_trials(PLAN, tmp_path, 1, quietly, crashes)
    assert len(asked) <= 4  # the next one may have begun
    assert not finished(PLAN, tmp_path)


def test_jobs_that_crash_at_their_start_do_not_end_those_beside_them(tmp_path: Path) -> None:
    """Three of six that run side by side crash at once, before any other can have ended."""
    crashed = threading.Barrier(3, timeout=20.0)
    others = threading.Event()

    def crashes(options: Sequence[str]) -> dict[str, Any]:
        if "--no-correction" in options:
            crashed.wait()
            others.set()
            raise TooleeError("it died", code="trials.crashed")
        assert others.wait(20.0)
        time.sleep(0.2)
        return job(options)

    with raises(TooleeError, code="trials.crashed"):
        run_trials(PLAN, tmp_path, 6, quietly, crashes)
    assert [record.trial.arm for record in finished(PLAN, tmp_path)] == [Arm.FULL] * 3


@pytest.mark.sim(seconds=10)
def test_a_job_that_is_refused_before_it_begins_is_no_result(tmp_path: Path) -> None:
    """It has no figures, which the report could not show."""
    plan = replace(PLAN, trials=1, arms=(Arm.FULL,), errors={"kinematics": 0.1})
    with raises(TooleeError, code="trials.crashed") as raised:
        run_trials(plan, tmp_path, 1, quietly)
    assert "not those of a UR arm" in str(raised.value)
    assert not finished(plan, tmp_path)


def test_an_error_that_no_job_can_mend_ends_the_plan(tmp_path: Path) -> None:
    def refused(_: Sequence[str]) -> dict[str, Any]:
        raise UserError("no folder", code="user.option")

    with raises(UserError, code="user.option"):
        run_trials(PLAN, tmp_path, 1, quietly, refused)


def test_the_outcomes_do_not_depend_on_how_many_run_side_by_side(tmp_path: Path) -> None:
    both = threading.Barrier(2, timeout=20.0)

    def together(options: Sequence[str]) -> dict[str, Any]:
        both.wait()  # two are under way at any time
        return job(options)

    one = run_trials(PLAN, tmp_path / "one", 1, quietly, job)
    two = run_trials(PLAN, tmp_path / "two", 2, quietly, together)
    assert [(r.trial, r.figures) for r in one] == [(r.trial, r.figures) for r in two]


def test_a_job_that_the_machine_stalled_is_repeated_and_counted(tmp_path: Path) -> None:
    stalls = iter([True, True, False])
    plan = replace(PLAN, trials=1, arms=(Arm.FULL,))
    (record,) = run_trials(
        plan, tmp_path, 1, quietly, lambda options: {**job(options), "machine_stalled": next(stalls)}
    )
    assert record.figures["tries"] == 3


def test_a_plan_does_not_change_once_its_trials_have_begun(tmp_path: Path) -> None:
    run_trials(PLAN, tmp_path, 1, quietly, job)
    with raises(UserError, code="user.other_plan"):
        run_trials(replace(PLAN, trials=4), tmp_path, 1, quietly, job)
    assert len(finished(PLAN, tmp_path)) == 6


def test_a_plans_hash_is_of_what_it_says(tmp_path: Path) -> None:
    texts = ["name: a\nfirst_seed: 3\ntrials: 2\n", "{trials: 2, name: a, arms: [full], first_seed: 3}  # the same"]
    hashes = set()
    for i, text in enumerate(texts):
        (tmp_path / f"{i}.yaml").write_text(text)
        hashes.add(load_plan(tmp_path / f"{i}.yaml").hash)
    assert len(hashes) == 1
    assert replace(load_plan(tmp_path / "0.yaml"), trials=3).hash not in hashes
    assert load_plan(EXAMPLES / "trials.yaml").trials == 20


def test_results_of_before_are_read_and_their_plans_keep_their_hash(tmp_path: Path) -> None:
    """What is kept beside the results on this site: other trials go on with such files."""
    kept = EXAMPLES.parent / "docs" / "benchmark"
    shutil.copy(kept / "paired_trials.jsonl", tmp_path / RESULTS)
    plan = load_plan(kept / "paired_trials.yaml")
    assert plan.hash.startswith("c786fec342f8")
    records = finished(plan, tmp_path)
    assert len(records) == len(list(plan.jobs())) == 1600
    assert load_plan(kept / "sweep.yaml").hash.startswith("122b571a6722")


def test_the_site_s_own_results_have_their_report_by_one_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = EXAMPLES.parent / "docs" / "benchmark"
    command = ["trials", str(kept / "distinct_hammers.yaml"), "--out", str(tmp_path / "out"), "--results"]
    assert run([*command, str(kept / "distinct_hammers.jsonl")]) == 0
    assert capsys.readouterr().out.count("199 of 200 flush (0.97 to 1.00)") == 2
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<b>200</b><span>distinct tools</span>" in page
    assert page.count(">toolee hammer --seed 13019 --perfect-perception<") == 1
    assert "the hand has lost the tool" in page
    links = re.findall(r'href="([^"]*13019/[a-z.]*)"', page)
    assert {Path(link).name for link in links} == {"picture.png", "recording.mcap"}
    assert all((tmp_path / "out" / link).is_file() for link in links), "beside the results"
    assert not (tmp_path / "out" / RESULTS).exists(), "they are no trials of this folder"


def test_the_report_of_a_file_of_results_takes_a_folder_that_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The default folder may have the report of its own trials; one that is named may have another plan's trials."""
    kept = EXAMPLES.parent / "docs" / "benchmark"
    monkeypatch.chdir(tmp_path)
    own = tmp_path / "trials"
    run_trials(PLAN, own, 1, quietly, job)
    write_report(PLAN, own)
    before = {file.name: file.read_bytes() for file in own.iterdir() if file.is_file()}
    command = ["trials", str(kept / "distinct_hammers.yaml"), "--results", str(kept / "distinct_hammers.jsonl")]
    assert run(command) == 2
    assert "--results without --out: give the folder" in " ".join(capsys.readouterr().err.split())
    assert {file.name: file.read_bytes() for file in own.iterdir() if file.is_file()} == before
    assert run([*command, "--out", "trials"]) == 0
    assert (own / RESULTS).read_bytes() == before[RESULTS]
    assert "<b>200</b><span>distinct tools</span>" in (own / "report.html").read_text()


@pytest.mark.parametrize("run_folder", ["runs/..", "..", ".", "/", "runs/full/../..", ""])
def test_a_run_s_folder_lies_in_that_of_its_trials(tmp_path: Path, run_folder: str) -> None:
    """A file of results may say anything: the report leads to no file outside."""

    def elsewhere(options: Sequence[str]) -> dict[str, Any]:
        return {**job(options), "run_folder": run_folder}

    run_trials(PLAN, tmp_path, 1, quietly, elsewhere)
    for folder in (tmp_path, tmp_path / "runs", tmp_path / "runs" / "full"):
        folder.mkdir(exist_ok=True)
        for name in ("picture.png", "recording.mcap"):
            (folder / name).touch()
    page = write_report(PLAN, tmp_path).read_text()
    assert "picture.png" not in page
    assert "recording.mcap" not in page


def test_a_command_in_the_report_is_one_of_a_shell(tmp_path: Path) -> None:
    plan = replace(PLAN, options=("--config", "my lab's; x.yaml"))
    failed = next(record for record in run_trials(plan, tmp_path, 1, quietly, job) if not record.success)
    page = write_report(plan, tmp_path).read_text()
    commands = re.findall(r">toolee hammer ([^<]*)<", page)
    assert list(failed.command) in [shlex.split(unescape(command)) for command in commands]
    (first,) = re.findall(r"the first one by: toolee hammer ([^<]*)<", page)
    assert "my lab's; x.yaml" in shlex.split(unescape(first))


@pytest.mark.parametrize("name", ["sweep.jsonl", "rehearsals.jsonl", "accuracy.png", "nothing.jsonl"])
def test_a_file_without_a_plan_s_results_is_refused(tmp_path: Path, name: str) -> None:
    kept = EXAMPLES.parent / "docs" / "benchmark"
    code = "user.other_plan" if name == "sweep.jsonl" else "user.no_results"
    with raises(UserError, code=code) as refused:
        write_report(load_plan(kept / "distinct_hammers.yaml"), tmp_path, kept / name)
    assert name in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_the_table_has_a_row_for_each_trial(tmp_path: Path) -> None:
    kept = EXAMPLES.parent / "docs" / "benchmark"
    shutil.copy(kept / "sweep.jsonl", tmp_path / RESULTS)
    plan = load_plan(kept / "sweep.yaml")
    records = finished(plan, tmp_path)
    write_report(plan, tmp_path)
    table = parquet.read_table(tmp_path / "trials.parquet")
    assert table.schema.metadata[b"hash"].decode() == plan.hash
    rows = table.to_pylist()
    assert len(rows) == len(records) == 700
    for row, record in zip(rows, records, strict=True):
        figures = record.figures
        assert row["trial.arm"] == record.trial.arm
        assert (row["trial.error"], row["trial.size"]) == (record.trial.error, record.trial.size)
        assert row["success"] is figures["success"]
        assert row["errors.camera_mm"] == figures["errors"]["camera_mm"]
        assert row["stage_seconds.strike"] == figures["stage_seconds"].get("strike"), "null where it came to no strike"
        assert [nail["outcome"] for nail in row["nails"]] == [nail["outcome"] for nail in figures["nails"]]
        assert row["command"].split() == list(record.command)
    flush = table.filter(compute.equal(table["trial.error"], "payload")).column("success")
    assert 0 < compute.sum(flush).as_py() < len(flush)


def test_a_figure_of_several_kinds_is_text_in_the_table(tmp_path: Path) -> None:
    def odd(options: Sequence[str]) -> dict[str, Any]:
        made = job(options)
        return {**made, "odd": made["strikes"] if made["strikes"] % 2 else "none", "big": 2**70}

    run_trials(PLAN, tmp_path, 1, quietly, odd)
    write_report(PLAN, tmp_path)
    rows = parquet.read_table(tmp_path / "trials.parquet").to_pylist()
    assert {json.loads(row["odd"]) for row in rows} == {"none", *(r["strikes"] for r in rows if r["strikes"] % 2)}
    assert {json.loads(row["big"]) for row in rows} == {2**70}


def test_a_plan_without_results_has_an_empty_table(tmp_path: Path) -> None:
    write_report(PLAN, tmp_path)
    assert parquet.read_table(tmp_path / "trials.parquet").num_rows == 0


def test_every_seed_and_arm_gets_every_nail_in_every_wood(tmp_path: Path) -> None:
    plan = replace(load_plan(EXAMPLES / "nail_trials.yaml"), trials=2, arms=(Arm.FULL, Arm.ONE_VIEW))
    asked = Asked()
    records = run_trials(plan, tmp_path, 1, quietly, asked)
    assert len({record.trial for record in records}) == 2 * 2 * 3 * 3
    setups = [Path(options[options.index("--setup") + 1]) for options in asked.options]
    told = {(work["nail_diameter"], work["wood_specific_gravity"]) for work in map(_work, setups)}
    assert told == {(d, g) for d in (0.0022, 0.0025, 0.0031) for g in (0.35, 0.42, 0.68)}
    assert len({options[options.index("--out") + 1] for options in asked.options}) == 2 * 3 * 3
    assert finished(plan, tmp_path) == records
    page = write_report(plan, tmp_path).read_text()
    made = json.loads((tmp_path / "report.json").read_text())["arms"]["full"]["conditions"]
    assert {words: of["of"] for words, of in made.items()}["3.1 x 65, oak"] == 2
    assert "tool, nail, wood" in page
    assert made["2.2 x 30, white pine"]["hits"] == 2


def test_every_seed_and_arm_gets_every_kind_of_sensor(tmp_path: Path) -> None:
    plan = replace(PLAN, trials=2, sensors=("active-stereo", "mixed"))
    assert plan.hash != PLAN.hash
    asked = Asked()
    records = run_trials(plan, tmp_path, 1, quietly, asked)
    given = [option(options, "--sensor") for options in asked.options]
    assert given == ["active-stereo", "active-stereo", "mixed", "mixed"] * 2
    assert len({option(options, "--out") for options in asked.options}) == 4, "arm and sensor"
    assert finished(plan, tmp_path) == records
    write_report(plan, tmp_path)
    made = json.loads((tmp_path / "report.json").read_text())["arms"]["full"]["conditions"]
    assert {words: of["of"] for words, of in made.items()} == {"active-stereo": 2, "mixed": 2}


@pytest.fixture
def paper(tmp_path: Path) -> TrialPlan:
    """A plan whose second arm is the paper's estimator."""
    weights = untrained_paper_weights(tmp_path / "weights")
    return replace(PLAN, arms=(Arm.FULL, Arm.PAPER), paper_weights=str(weights))


class PaperJobs(Asked):
    """Jobs that tell which weights they had."""

    def __call__(self, options: Sequence[str]) -> dict[str, Any]:
        weights = option(options, "--paper-weights")
        return {**super().__call__(options), "paper_weights": weights and weights_hash(Path(weights))}


def test_the_papers_arm_gets_its_weights_and_no_other_arm_does(paper: TrialPlan, tmp_path: Path) -> None:
    asked = PaperJobs()
    run_trials(paper, tmp_path / "out", 1, quietly, asked)
    given = [(option(options, "--ablation"), option(options, "--paper-weights")) for options in asked.options]
    assert given == [(None, None), ("paper", paper.paper_weights)] * 3
    assert replace(paper, paper_weights="other").hash != paper.hash
    for arms, weights in (((Arm.FULL, Arm.PAPER), ""), ((Arm.FULL,), paper.paper_weights)):
        with pytest.raises(ValueError, match="paper_weights"):
            replace(paper, arms=arms, paper_weights=weights)


def test_a_plan_does_not_go_on_with_other_weights_of_the_papers_estimator(paper: TrialPlan, tmp_path: Path) -> None:
    run_trials(paper, tmp_path / "out", 1, quietly, PaperJobs())
    asked = PaperJobs()
    run_trials(paper, tmp_path / "out", 1, quietly, asked)
    untrained_paper_weights(Path(paper.paper_weights), seed=1)
    with raises(UserError, code="user.other_weights"):
        run_trials(paper, tmp_path / "out", 1, quietly, asked)
    assert not asked.options


def test_weights_that_no_job_could_take_are_refused_before_the_first_one(paper: TrialPlan, tmp_path: Path) -> None:
    asked = PaperJobs()
    with raises(AssetError, code="asset.missing") as missing:
        run_trials(replace(paper, paper_weights=str(tmp_path / "none")), tmp_path / "a", 1, quietly, asked)
    assert "toolee train pose --estimator paper" in str(missing.value)
    of_tools = untrained_paper_weights(tmp_path / "tools", "object-prior")
    with raises(UserError, code="user.paper_column"):
        run_trials(replace(paper, paper_weights=str(of_tools)), tmp_path / "b", 1, quietly, asked)
    assert not asked.options


def _work(setup: Path) -> dict[str, float]:
    return dict(yaml.safe_load(setup.read_text())["work"])


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ("arms: [full, full]", "arms"),
        ("arms: [ful]", "arms"),
        ("trials: 0", "trials"),
        ("errors: {camera_position: -1}", "errors"),
        ("options: [--seed, '3']", "--seed"),
        ("seeds: 3", "seeds"),
        ("sweep: {ruler: []}", "sweep"),
        ("sweep: {ruler: [-0.001]}", "sweep"),
        ("nails: [{name: a, diameter: 0.003}]", "nails.0"),
        ("woods: {oak: 680}", "woods"),
        ("options: [--setup, a.yaml]", "--setup"),
        ("options: [--paper-weights, a]", "--paper-weights"),
        ("options: [--sensor, mixed]", "--sensor"),
        ("sensors: [lidar]", "sensors"),
        ("sensors: [mixed, mixed]", "sensors"),
        ("arms: [paper]", "paper_weights"),
        ("instructions: look", "instructions"),
        ("sensors: [mixed]\noptions: [--station, lab.yaml, --rehearse]", "sensors"),
        ("sensors: [mixed]\noptions: [--arm, ur-rtde, --world, pybullet]", "sensors: they cannot be tried with"),
        ("sensors: [mixed]\noptions: [--arm=ur-rtde, --robot-host, 127.0.0.2]", "sensors: they cannot be tried with"),
    ],
)
def test_what_is_no_plan_is_refused_by_the_field(tmp_path: Path, change: str, what: str) -> None:
    lines = {"name": "a", "first_seed": "3", "trials": "2"}
    key, value = change.split(": ", 1)
    text = "\n".join(f"{k}: {v}" for k, v in {**lines, key: value}.items())
    (tmp_path / "plan.yaml").write_text(text)
    with raises(ConfigError, code="config.invalid") as refused:
        load_plan(tmp_path / "plan.yaml")
    assert what in str(refused.value)


def test_the_report_tells_shares_pairs_failures_and_distinct_tools(tmp_path: Path) -> None:
    plan = replace(PLAN, trials=8)
    run_trials(plan, tmp_path, 1, quietly, job)
    page = write_report(plan, tmp_path).read_text()
    made = json.loads((tmp_path / "report.json").read_text())
    assert (made["finished"], made["of"], made["distinct_tools"]) == (16, 16, 2)
    full, without = made["arms"]["full"], made["arms"]["no_correction"]
    assert full["flush"]["hits"] == 7
    assert without["against_first"] == {"pairs": 8, "better": 0, "worse": 7, "p": pytest.approx(2 / 2**7)}
    assert without["outcomes"] == {"nail_missed": 8}
    assert full["failures"] == [{"stage": "strike", "outcome": "nail_missed", "count": 1}]
    assert sorted((kind["stage"], kind["count"]) for kind in without["failures"]) == [("strike", 4), ("touch", 4)]
    assert page.index(">touch</td>") < page.index(">strike</td>"), "as they follow each other in a job"
    assert "for a test<" in page, "without what a person is to do about the arm"
    assert "data:image/png;base64," in page, "success against the size of the errors"
    assert "7 of 8" in page
    assert plan.hash in page
    assert "http" not in page.replace("http://www.w3.org", ""), "one file, nothing is loaded"


def test_each_failure_leads_to_its_picture_and_its_recording(tmp_path: Path) -> None:
    def kept(options: Sequence[str]) -> dict[str, Any]:
        run = Path(options[options.index("--out") + 1], options[options.index("--seed") + 1])
        run.mkdir(parents=True)
        for name in ("picture.png", "recording.mcap"):
            (run / name).touch()
        return {**job(options), "run_folder": str(run)}

    plan = replace(PLAN, trials=8, arms=(Arm.FULL,))
    (failed,) = [r for r in run_trials(plan, tmp_path, 1, quietly, kept) if not r.success]
    page = write_report(plan, tmp_path).read_text()
    run = f"runs/full/{failed.trial.seed}"
    assert page.count(f'href="{run}/picture.png"') == 2, "among the failures and among all trials"
    assert page.count(f'href="{run}/recording.mcap"') == 1
    moved = tmp_path.with_name(f"{tmp_path.name}-moved")
    tmp_path.rename(moved)
    assert write_report(plan, moved).read_text() == page, "a folder may be moved"
    shutil.rmtree(moved / "runs")
    page = write_report(plan, moved).read_text()
    assert 'href="runs' not in page, "no link leads nowhere"
    assert f">toolee hammer {' '.join(failed.command)}<" in page, "how the failure is seen again"


def test_a_nail_that_is_flush_for_the_robot_alone_is_a_failure_with_a_name(tmp_path: Path) -> None:
    def deceived(options: Sequence[str]) -> dict[str, Any]:
        return {**job(options), "success": False, "outcome": "flush", "reason": "the robot takes the nail for flush"}

    run_trials(replace(PLAN, trials=2), tmp_path, 1, quietly, deceived)
    page = write_report(replace(PLAN, trials=2), tmp_path).read_text()
    made = json.loads((tmp_path / "report.json").read_text())
    assert made["arms"]["full"]["outcomes"] == {"flush_by_the_robot_alone": 2}
    assert "flush by the robot alone" in page
    assert "conditions" not in page, "no trial has any"


def swept(options: Sequence[str]) -> dict[str, Any]:
    """A job that succeeds up to 4 mm of error of the camera, whatever the ruler's is."""
    given = dict(line.split(": ") for line in Path(options[options.index("--errors") + 1]).read_text().splitlines())
    success = float(given.get("camera_position", 0.0)) < 0.0041
    return {**job(options), "success": success, "given": given, "outcome": "flush" if success else "nail_missed"}


SWEEP = replace(
    PLAN, trials=6, arms=(Arm.FULL,), errors={"balance": 0.003},
    sweep={"camera_position": (0.002, 0.004, 0.006, 0.008), "ruler": (0.001, 0.005)},
)  # fmt: skip


def test_a_sweep_changes_one_error_at_a_time_of_the_same_seeds(tmp_path: Path) -> None:
    records = run_trials(SWEEP, tmp_path, 1, quietly, swept)
    assert len(records) == 6 * (1 + 4 + 2), "once with the errors as they are"
    for record in records:
        given = {name: float(value) for name, value in record.figures["given"].items()}
        own = {} if record.trial.error is None else {record.trial.error: record.trial.size}
        assert given == {"balance": 0.003, **own}
    outs = {(record.trial.seed, record.command) for record in records}
    assert len(outs) == len(records)
    assert finished(SWEEP, tmp_path) == records
    asked = Asked()
    assert run_trials(SWEEP, tmp_path, 1, quietly, asked) == records
    assert not asked.options, "all of them are there already"
    assert replace(SWEEP, sweep={}).hash != SWEEP.hash
    with pytest.raises(ValueError, match="exact"):
        replace(SWEEP, errors="exact")


def test_the_report_tells_the_size_that_is_too_much(tmp_path: Path) -> None:
    plan = replace(SWEEP, trials=10)
    run_trials(plan, tmp_path, 1, quietly, swept)
    page = write_report(plan, tmp_path).read_text()
    camera, ruler = json.loads((tmp_path / "report.json").read_text())["sweeps"]
    assert camera["sizes"] == [0.002, 0.004, 0.006, 0.008], "the usual size is among them"
    assert [(share["hits"], share["of"]) for share in camera["shares"]] == [(20, 20), (10, 10), (0, 10), (0, 10)]
    assert ruler["sizes"] == [0.001, 0.005]
    assert 0.004 < camera["limit"]["size"] < 0.006
    low, size, high = (camera["limit"][name] for name in ("low", "size", "high"))
    assert low - 1e-6 <= size <= high + 1e-6  # every seed has the same outcomes: but for what the fit is off by
    assert ruler["too_much"] == "not up to 5"
    assert "One error at a time" in page
    assert "place, mm along each axis" in page


def test_the_report_tells_success_by_the_handover_and_by_the_data_of_another_hammer(tmp_path: Path) -> None:
    """What a job is told wrong of its tool, and how the tool is laid into the hand."""

    def fails_far_off(options: Sequence[str]) -> dict[str, Any]:
        file = Path(options[options.index("--errors") + 1]) if "--errors" in options else None
        sizes = NOMINAL if file is None else read_record(file, CellErrors, "list of errors")
        facts = draw_errors(sizes, int(options[options.index("--seed") + 1])).facts
        success = abs(facts["handover_mm"] or 0.0) < 30.0
        return {**job(options), "success": success, "outcome": "flush" if success else "tool_lost", "errors": facts}

    sweep: dict[str, tuple[float, ...]] = {"handover": (0.5, 3.0), "other_tool": (0.5, 1.0)}
    plan = replace(PLAN, trials=10, arms=(Arm.FULL,), errors="nominal", sweep=sweep)
    records = run_trials(plan, tmp_path, 1, quietly, fails_far_off)
    page = write_report(plan, tmp_path).read_text()
    handover, other = json.loads((tmp_path / "report.json").read_text())["sweeps"]
    assert (handover["sizes"], other["sizes"]) == ([0.5, 1.0, 3.0], [0.0, 0.5, 1.0])
    assert [share["hits"] for share in other["shares"]] == [10, 10, 10]
    assert [share["hits"] for share in handover["shares"]][:2] == [10, 10]
    assert handover["shares"][2]["hits"] < 10
    assert "<td>handover, times the nominal range</td>" in page.replace(' class="left"', "")
    assert "of the way to another hammer" in page
    table = parquet.read_table(tmp_path / "trials.parquet").to_pylist()
    for row, record in zip(table, records, strict=True):
        assert row["errors.handover_mm"] == record.figures["errors"]["handover_mm"]
        assert row["errors.other_tool_percent"] == (
            100.0 * row["trial.size"] if row["trial.error"] == "other_tool" else 0.0
        )


def test_every_error_has_a_name_in_the_report() -> None:
    assert set(ERRORS) == set(draw_errors(NOMINAL, 3).facts)
    assert set(UNITS) == {field.name for field in fields(CellErrors)}


def test_of_a_few_seeds_no_size_is_told_that_is_too_much(tmp_path: Path) -> None:
    run_trials(SWEEP, tmp_path, 1, quietly, swept)
    write_report(SWEEP, tmp_path)
    told = json.loads((tmp_path / "report.json").read_text())["sweeps"]
    assert [sweep["limit"] for sweep in told] == [None, None]
    assert "too few seeds" in told[0]["too_much"]

"""A plan's trials: paired, resumable, counted once; a plan does not change once they have begun."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import threading
import time
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from tests.errors import raises
from tests.paper_weights import untrained_paper_weights
from toolee_robot.app.job import JobSpec
from toolee_robot.app.simulated import Simulated
from toolee_robot.app.variant import Variant
from toolee_robot.cli.app import run
from toolee_robot.errors import AssetError, ConfigError, TooleeError, UserError
from toolee_robot.perception.weight_files import weights_hash
from toolee_robot.sim_backend.cell_errors import CellErrors
from toolee_robot.trials import Trial, TrialPlan, load_plan, run_trials, write_report
from toolee_robot.trials.plan import InSimulation
from toolee_robot.trials.results import RESULTS, Happened, Record, read_results

EXAMPLES = Path(__file__).parents[2] / "examples"
PLAN = TrialPlan("three hammers", 40, 3, (Variant.FULL, Variant.NO_CORRECTION), {"camera_position": 0.004})


def job(spec: JobSpec, out: Path) -> dict[str, Any]:  # noqa: ARG001
    """A job whose outcome follows from what it is alone, as a simulated one's does."""
    seed = source(spec).seed
    success = spec.variant.corrects and seed != 41
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


def source(spec: JobSpec) -> Simulated:
    assert isinstance(spec.source, Simulated)
    return spec.source


def finished(plan: TrialPlan, folder: Path) -> list[Record]:
    return read_results(plan, folder)[0]


def quietly(_: str) -> None:
    pass


class Asked:
    """Does jobs, and keeps what was asked, and the folder of each."""

    def __init__(self) -> None:
        self.specs: list[JobSpec] = []
        self.outs: list[Path] = []

    def __call__(self, spec: JobSpec, out: Path) -> dict[str, Any]:
        self.specs.append(spec)
        self.outs.append(out)
        return job(spec, out)


def test_every_arm_has_the_same_seeds_and_its_own_variant(tmp_path: Path) -> None:
    asked = Asked()
    records = run_trials(PLAN, tmp_path, 1, quietly, asked)
    assert [record.trial for record in records] == [Trial(arm, s) for s in (40, 41, 42) for arm in PLAN.arms]
    assert [spec.variant for spec in asked.specs] == [*PLAN.arms] * 3
    assert {source(spec).errors for spec in asked.specs} == {CellErrors(camera_position=0.004)}
    errors = tmp_path / "errors.yaml"
    assert errors.read_text() == "camera_position: 0.004\n"
    assert records[1].repeated_by == f"toolee sim hammer --seed 40 --variant no_correction --errors {errors}"
    assert finished(PLAN, tmp_path) == records


def test_seeds_that_are_left_out_are_made_up_for() -> None:
    plan = replace(PLAN, arms=(Variant.FULL,), left_out=(41, 43))
    assert [trial.seed for trial in plan.jobs()] == [40, 42, 44]
    assert plan.hash != PLAN.hash
    assert replace(plan, arms=PLAN.arms, left_out=()).hash == PLAN.hash
    for wrong in (39, 45):
        with pytest.raises(ValueError, match=f"left_out: {wrong}"):
            replace(plan, left_out=(41, wrong))


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
    assert len(asked.specs) == 6 - after
    assert [(r.trial, r.figures) for r in records] == [(r.trial, r.figures) for r in whole]
    assert (tmp_path / "cut" / RESULTS).read_text().count("\n") == 7


@pytest.mark.parametrize("jobs", [1, 3])
def test_a_job_that_crashes_ends_no_other_and_is_tried_again(tmp_path: Path, jobs: int) -> None:
    """One simulation that cannot be built once ended a plan of 720, with 62 jobs under way."""
    told: list[str] = []

    def crashes(spec: JobSpec, out: Path) -> dict[str, Any]:
        if source(spec).seed == 41 and not spec.variant.corrects:
            raise TooleeError("it died", code="trials.crashed")
        return job(spec, out)

    with raises(TooleeError, code="trials.crashed") as raised:
        run_trials(PLAN, tmp_path, jobs, told.append, crashes)
    assert "1 job crashed, and 1 of the trials are not done" in str(raised.value)
    records, events = read_results(PLAN, tmp_path)
    lost = Trial(Variant.NO_CORRECTION, 41)
    assert [record.trial for record in records] == [trial for trial in PLAN.jobs() if trial != lost]
    assert [(event.what, event.trial) for event in events] == [(Happened.NOT_BEGUN, lost)]
    assert any("seed 41: crashed: it died" in line for line in told)
    asked = Asked()
    assert len(run_trials(PLAN, tmp_path, jobs, quietly, asked)) == 6
    assert len(asked.specs) == 1


def test_a_plan_whose_jobs_all_crash_is_given_up(tmp_path: Path) -> None:
    asked = Asked()

    def crashes(spec: JobSpec, out: Path) -> dict[str, Any]:
        asked(spec, out)
        raise TooleeError("no such device", code="trials.crashed")

    with raises(TooleeError, code="trials.crashed"):
        run_trials(PLAN, tmp_path, 1, quietly, crashes)
    assert len(asked.specs) <= 4  # the next one may have begun
    assert not finished(PLAN, tmp_path)


def test_jobs_that_crash_at_their_start_do_not_end_those_beside_them(tmp_path: Path) -> None:
    """Three of six that run side by side crash at once, before any other can have ended."""
    crashed = threading.Barrier(3, timeout=20.0)
    others = threading.Event()

    def crashes(spec: JobSpec, out: Path) -> dict[str, Any]:
        if not spec.variant.corrects:
            crashed.wait()
            others.set()
            raise TooleeError("it died", code="trials.crashed")
        assert others.wait(20.0)
        time.sleep(0.2)
        return job(spec, out)

    with raises(TooleeError, code="trials.crashed"):
        run_trials(PLAN, tmp_path, 6, quietly, crashes)
    assert [record.trial.arm for record in finished(PLAN, tmp_path)] == [Variant.FULL] * 3


@pytest.mark.nightly
@pytest.mark.sim(seconds=10)
def test_a_job_that_is_refused_before_it_begins_is_no_result(tmp_path: Path) -> None:
    """It has no figures, which the report could not show."""
    plan = replace(PLAN, trials=1, arms=(Variant.FULL,), errors={"kinematics": 0.1})
    with raises(TooleeError, code="trials.crashed") as raised:
        run_trials(plan, tmp_path, 1, quietly)
    assert "not those of a UR arm" in str(raised.value)
    assert not finished(plan, tmp_path)


def test_an_error_that_no_job_can_mend_ends_the_plan(tmp_path: Path) -> None:
    def refused(*_: object) -> dict[str, Any]:
        raise UserError("no folder")

    with raises(UserError, says="no folder"):
        run_trials(PLAN, tmp_path, 1, quietly, refused)


def test_a_job_that_the_machine_stalled_is_repeated_and_counted(tmp_path: Path) -> None:
    stalls = iter([True, True, False])
    plan = replace(PLAN, trials=1, arms=(Variant.FULL,))
    (record,) = run_trials(
        plan, tmp_path, 1, quietly, lambda spec, out: {**job(spec, out), "machine_stalled": next(stalls)}
    )
    assert record.figures["tries"] == 3


def test_a_plan_does_not_change_once_its_trials_have_begun(tmp_path: Path) -> None:
    run_trials(PLAN, tmp_path, 1, quietly, job)
    with raises(UserError, says="other plan"):
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
    shutil.copy(kept / "one_strike.jsonl", tmp_path / RESULTS)
    plan = load_plan(kept / "one_strike.yaml")
    assert plan.hash.startswith("b4ec43a64f15")
    records = finished(plan, tmp_path)
    assert [record.trial for record in records] == list(plan.jobs())[: len(records)]
    assert len(records) == 210


def test_the_site_s_own_results_have_their_report_by_one_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = EXAMPLES.parent / "docs" / "benchmark"
    command = ["trials", str(kept / "one_strike_ur10e.yaml"), "--out", str(tmp_path / "out"), "--results"]
    assert run([*command, str(kept / "one_strike_ur10e.jsonl")]) == 0
    assert re.search(r"106 of 110 flush \(0\.91 to 0\.99\)", capsys.readouterr().out)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<b>107</b><span>distinct tools</span>" in page
    assert page.count(">toolee sim hammer --robot UR10e --seed 14093<") == 1
    assert "collision detection ratio" in page
    links = re.findall(r'href="([^"]*14023/[a-z.]*)"', page)
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
    command = ["trials", str(kept / "one_strike.yaml"), "--results", str(kept / "one_strike.jsonl")]
    assert run(command) == 2
    assert "--results needs --out, the folder" in " ".join(capsys.readouterr().err.split())
    assert {file.name: file.read_bytes() for file in own.iterdir() if file.is_file()} == before
    assert run([*command, "--out", "trials"]) == 0
    assert (own / RESULTS).read_bytes() == before[RESULTS]
    assert "<b>69</b><span>distinct tools</span>" in (own / "report.html").read_text()


@pytest.mark.parametrize("run_folder", ["runs/..", "..", ".", "/", "runs/full/../..", ""])
def test_a_run_s_folder_lies_in_that_of_its_trials(tmp_path: Path, run_folder: str) -> None:
    """A file of results may say anything: the report leads to no file outside."""

    def elsewhere(spec: JobSpec, out: Path) -> dict[str, Any]:
        return {**job(spec, out), "run_folder": run_folder}

    run_trials(PLAN, tmp_path, 1, quietly, elsewhere)
    for folder in (tmp_path, tmp_path / "runs", tmp_path / "runs" / "full"):
        folder.mkdir(exist_ok=True)
        for name in ("picture.png", "recording.mcap"):
            (folder / name).touch()
    page = write_report(PLAN, tmp_path).read_text()
    assert "picture.png" not in page
    assert "recording.mcap" not in page


def test_a_command_in_the_report_is_one_of_a_shell(tmp_path: Path) -> None:
    (tmp_path / "my lab's; x.yaml").write_text("work: {nail_protrusion: 0.01}")
    plan = replace(PLAN, where=InSimulation(str(tmp_path / "my lab's; x.yaml"), "UR10e"))
    asked = Asked()
    failed = next(record for record in run_trials(plan, tmp_path / "out", 1, quietly, asked) if not record.success)
    config = source(asked.specs[0]).config
    assert (config.work.nail_protrusion, config.arm.model) == (0.01, "UR10e")
    page = write_report(plan, tmp_path / "out").read_text()
    commands = re.findall(r">toolee (sim hammer [^<]*)<", page)
    assert list(failed.command) in [shlex.split(unescape(command)) for command in commands]
    (first,) = re.findall(r"the first one by: toolee ([^<]*)<", page)
    assert str(tmp_path / "my lab's; x.yaml") in shlex.split(unescape(first))


@pytest.mark.parametrize("name", ["sweep.jsonl", "rehearsals.jsonl", "accuracy.png", "nothing.jsonl"])
def test_a_file_without_a_plan_s_results_is_refused(tmp_path: Path, name: str) -> None:
    kept = EXAMPLES.parent / "docs" / "benchmark"
    with raises(UserError, says=name):
        write_report(load_plan(kept / "one_strike.yaml"), tmp_path, kept / name)
    assert not list(tmp_path.iterdir())


def test_every_seed_and_arm_gets_every_nail_in_every_wood(tmp_path: Path) -> None:
    plan = replace(load_plan(EXAMPLES / "nail_trials.yaml"), trials=2, arms=(Variant.FULL, Variant.NO_CORRECTION))
    asked = Asked()
    records = run_trials(plan, tmp_path, 1, quietly, asked)
    assert len({record.trial for record in records}) == 2 * 2 * 3 * 3
    works = [spec.source.config.work for spec in asked.specs]
    told = {(work.nail_diameter, work.wood_specific_gravity) for work in works}
    assert told == {(d, g) for d in (0.0022, 0.0025, 0.0031) for g in (0.35, 0.42, 0.68)}
    assert len(set(asked.outs)) == 2 * 3 * 3
    assert "--setup" in records[0].command, "a failed one is run again alone"
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
    given = [source(spec).sensor for spec in asked.specs]
    assert given == ["active-stereo", "active-stereo", "mixed", "mixed"] * 2
    assert len(set(asked.outs)) == 4, "arm and sensor"
    assert finished(plan, tmp_path) == records
    write_report(plan, tmp_path)
    made = json.loads((tmp_path / "report.json").read_text())["arms"]["full"]["conditions"]
    assert {words: of["of"] for words, of in made.items()} == {"active-stereo": 2, "mixed": 2}


@pytest.fixture
def paper(tmp_path: Path) -> TrialPlan:
    """A plan whose second arm is the paper's estimator."""
    weights = untrained_paper_weights(tmp_path / "weights")
    return replace(PLAN, arms=(Variant.FULL, Variant.PAPER), paper_weights=str(weights))


class PaperJobs(Asked):
    """Jobs that tell which weights they had."""

    def __call__(self, spec: JobSpec, out: Path) -> dict[str, Any]:
        weights = spec.paper_weights
        return {**super().__call__(spec, out), "paper_weights": weights and weights_hash(weights)}


def test_the_papers_arm_gets_its_weights_and_no_other_arm_does(paper: TrialPlan, tmp_path: Path) -> None:
    asked = PaperJobs()
    run_trials(paper, tmp_path / "out", 1, quietly, asked)
    given = [(spec.variant, spec.paper_weights) for spec in asked.specs]
    assert given == [(Variant.FULL, None), (Variant.PAPER, Path(paper.paper_weights))] * 3
    assert replace(paper, paper_weights="other").hash != paper.hash
    for arms, weights in (((Variant.FULL, Variant.PAPER), ""), ((Variant.FULL,), paper.paper_weights)):
        with pytest.raises(ValueError, match="paper_weights"):
            replace(paper, arms=arms, paper_weights=weights)


def test_a_plan_does_not_go_on_with_other_weights_of_the_papers_estimator(paper: TrialPlan, tmp_path: Path) -> None:
    run_trials(paper, tmp_path / "out", 1, quietly, PaperJobs())
    asked = PaperJobs()
    run_trials(paper, tmp_path / "out", 1, quietly, asked)
    untrained_paper_weights(Path(paper.paper_weights), seed=1)
    with raises(UserError, says="restore those, or give another --out"):
        run_trials(paper, tmp_path / "out", 1, quietly, asked)
    assert not asked.specs


def test_weights_that_no_job_could_take_are_refused_before_the_first_one(paper: TrialPlan, tmp_path: Path) -> None:
    asked = PaperJobs()
    with raises(AssetError, code="asset.missing") as missing:
        run_trials(replace(paper, paper_weights=str(tmp_path / "none")), tmp_path / "a", 1, quietly, asked)
    assert "toolee train paper" in str(missing.value)
    of_tools = untrained_paper_weights(tmp_path / "tools", "object-prior")
    with raises(UserError, code="user.paper_column"):
        run_trials(replace(paper, paper_weights=str(of_tools)), tmp_path / "b", 1, quietly, asked)
    assert not asked.specs


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ("arms: [full, full]", "arms"),
        ("arms: [ful]", "arms"),
        ("trials: 0", "trials"),
        ("errors: {camera_position: -1}", "errors"),
        ("seeds: 3", "seeds"),
        ("nails: [{name: a, diameter: 0.003}]", "nails.0"),
        ("woods: {oak: 680}", "woods"),
        ("sensors: [lidar]", "sensors"),
        ("sensors: [mixed, mixed]", "sensors"),
        ("arms: [paper]", "paper_weights"),
        ("instructions: look", "instructions"),
        ("sensors: [mixed]\nwhere: {rehearse: lab.yaml}", "sensors"),
        ("errors: exact\nwhere: {rehearse: lab.yaml}", "errors"),
        ("where: {rehearse: lab.yaml, robot: UR10}", "where"),
        ("where: {run: lab.yaml, real_time_factor: 0.5}", "where"),
        ("options: [--station, lab.yaml]", "options"),
        ("sweep: {ruler: [0.001]}", "sweep"),
        ("arms: [learnt_grasp]", "arms"),
    ],
)
def test_what_is_no_plan_is_refused_by_the_field(tmp_path: Path, change: str, what: str) -> None:
    lines = {"name": "a", "first_seed": "3", "trials": "2"}
    key, value = change.split(": ", 1)
    text = "\n".join(f"{k}: {v}" for k, v in {**lines, key: value}.items())
    (tmp_path / "plan.yaml").write_text(text)
    with raises(ConfigError) as refused:
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
    assert "7 of 8" in page
    assert plan.hash in page
    assert "http" not in page.replace("http://www.w3.org", ""), "one file, nothing is loaded"


def test_each_failure_leads_to_its_picture_and_its_recording(tmp_path: Path) -> None:
    def kept(spec: JobSpec, out: Path) -> dict[str, Any]:
        run = out / str(source(spec).seed)
        run.mkdir(parents=True)
        for name in ("picture.png", "recording.mcap"):
            (run / name).touch()
        return {**job(spec, out), "run_folder": str(run)}

    plan = replace(PLAN, trials=8, arms=(Variant.FULL,))
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
    assert f">{failed.repeated_by}<" in page, "how the failure is seen again"


def test_a_nail_that_is_flush_for_the_robot_alone_is_a_failure_with_a_name(tmp_path: Path) -> None:
    def deceived(spec: JobSpec, out: Path) -> dict[str, Any]:
        return {**job(spec, out), "success": False, "outcome": "flush", "reason": "the robot reports the nail as flush"}

    run_trials(replace(PLAN, trials=2), tmp_path, 1, quietly, deceived)
    page = write_report(replace(PLAN, trials=2), tmp_path).read_text()
    made = json.loads((tmp_path / "report.json").read_text())
    assert made["arms"]["full"]["outcomes"] == {"flush_by_the_robot_alone": 2}
    assert "flush by the robot alone" in page
    assert "conditions" not in page, "no trial has any"


def test_the_report_escapes_what_it_is_given(tmp_path: Path) -> None:
    def strange(spec: JobSpec, out: Path) -> dict[str, Any]:
        return {**job(spec, out), "tool": "<script>alert(1)</script>"}

    plan = replace(PLAN, trials=2, name="<i> a & b")
    run_trials(plan, tmp_path, 1, quietly, strange)
    page = write_report(plan, tmp_path).read_text()
    assert not re.search(r"https?://|<script|<link|@import|url\(|<i>", page)
    assert "&lt;i&gt; a &amp; b</h1>" in page
    links = re.findall(r'href="#([^"]+)"', page)
    assert len(links) == 4
    assert all(f'id="{link}"' in page for link in links)

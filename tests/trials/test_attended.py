"""A person is led through a plan's trials: nothing that was said or measured is lost, and nothing is assumed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.errors import raises
from toolee_robot.app.job import JobSpec
from toolee_robot.app.sources import Lab
from toolee_robot.app.variant import Variant
from toolee_robot.errors import ConfigError, TooleeError, UserError
from toolee_robot.station import ToolData, load_lab_station
from toolee_robot.trials import Record, Trial, TrialPlan, lead_trials, load_plan, run_trials, write_report
from toolee_robot.trials.plan import InRehearsal, InSimulation, NailSizes, OnRobot
from toolee_robot.trials.results import Event, Happened, compare, median, read_results, share

LAB = Path(__file__).parents[2] / "examples" / "lab.yaml"
PEEN = ToolData("ball peen", 0.014, (0.05, 0.0, 0.27), (1.0, 0.0, 0.0), 0.6, (0.0, 0.0, 0.16))
LONG = NailSizes("3.1 x 65", 0.0031, 0.065, 0.007, 0.03, 0.0026)
PLAN = TrialPlan(
    "two hammers", 1, 2, (Variant.FULL, Variant.NO_CORRECTION), where=OnRobot(str(LAB)), tools=("claw hammer", PEEN)
)
GOOD = ("r", "0.2", "n", "n", "y")
"""Ready; 0.2 mm over the wood, not bent; not slipped; counts."""


class Robot:
    """A job that believes that its nail is flush, unless it is the arm without correction."""

    def __init__(self) -> None:
        self.specs: list[JobSpec] = []

    def __call__(self, spec: JobSpec, out: Path) -> dict[str, Any]:  # noqa: ARG002
        self.specs.append(spec)
        success = spec.variant.corrects
        nail = {"name": "nail", "measured_protrusion_mm": 0.5 if success else None}
        return {
            "success": success, "outcome": "flush" if success else "nail_missed", "reason": "for a test",
            "strikes": 9, "tool": "a hammer", "run_folder": None, "nails": [nail],
        }  # fmt: skip


class Stopping(Robot):
    """One whose arm is stopped in every job."""

    def __call__(self, spec: JobSpec, out: Path) -> dict[str, Any]:
        return super().__call__(spec, out) | {"stops": 2}


class Person:
    """Answers from a list, then hangs up."""

    def __init__(self, *answers: str) -> None:
        self._answers: Iterator[str] = iter(answers)
        self.read: list[str] = []
        self.asked: list[str] = []

    def ask(self, question: str) -> str:
        self.asked.append(question)
        for answer in self._answers:
            return answer
        raise EOFError

    def tell(self, text: str) -> None:
        self.read.append(text)


def lead(plan: TrialPlan, folder: Path, person: Person, robot: Robot | None = None) -> Robot:
    robot = Robot() if robot is None else robot
    lead_trials(plan, folder, person.ask, person.tell, robot)
    return robot


def events(plan: TrialPlan, folder: Path) -> list[Event]:
    return read_results(plan, folder)[1]


def test_three_stops_end_the_session_and_the_next_one_goes_on(tmp_path: Path) -> None:
    """Each job counts its own stops; nobody may strike on until lunch with an arm that stops twice a nail."""
    person = Person(*8 * GOOD)
    robot = lead(PLAN, tmp_path, person, Stopping())
    assert len(robot.specs) == 2
    assert len(read_results(PLAN, tmp_path)[0]) == 2, "what was measured is kept"
    assert any("stopped 4 times with the tool in the hand" in line for line in person.read)
    assert events(PLAN, tmp_path)[-1].what is Happened.STOPPED
    assert len(lead(PLAN, tmp_path, Person(*8 * GOOD)).specs) == 6, "the stops of the session before do not count"


def test_every_trial_is_led_and_the_persons_calipers_are_the_outcome(tmp_path: Path) -> None:
    person = Person(*8 * GOOD)
    robot = lead(PLAN, tmp_path, person)
    records, _ = read_results(PLAN, tmp_path)
    assert [record.trial for record in records] == list(PLAN.jobs())
    assert all(record.success for record in records)
    assert {record.figures["robot"]["success"] for record in records} == {True, False}
    assert all(isinstance(spec.source, Lab) for spec in robot.specs)
    assert all("--seed" not in record.command for record in records), "on a robot a seed draws nothing"
    tools = [spec.source.config.tool for spec in robot.specs]
    assert tools.count(PEEN) == 4, "the others are the station file's own"
    text = "\n".join(person.read)
    assert "Trial 8 of 8" in text
    assert "claw hammer, 0.5 kg" in text
    assert "ball peen, 0.6 kg" in text
    assert "2.2 x 30 mm, head 6 mm, 20 mm over the wood, pilot hole 1.5 mm" in text
    x, y = load_lab_station(LAB).work.nail_xy
    assert f"at x {-x:.3f} m, y {-y:.3f} m in the Base of the teach pendant" in text
    assert "specific gravity 0.35" in text


def test_arms_are_paired_in_blocks_in_an_order_that_the_hash_draws() -> None:
    plan = replace(PLAN, trials=20)
    order = plan.order()
    assert sorted(map(str, order)) == sorted(map(str, plan.jobs()))
    blocks = list(zip(order[::2], order[1::2], strict=True))
    assert all((a.tool, a.seed) == (b.tool, b.seed) and a.arm is not b.arm for a, b in blocks)
    first = sum(a.arm is Variant.FULL for a, _ in blocks)
    assert 10 <= first <= 30, "of 40: neither arm always comes first"
    assert [a.seed for a, _ in blocks] != sorted(a.seed for a, _ in blocks)
    assert order == replace(plan).order()
    assert order != replace(plan, name="another").order()


@pytest.mark.parametrize("after", range(3 * len(GOOD)))
def test_whenever_the_terminal_closes_the_same_command_goes_on(tmp_path: Path, after: int) -> None:
    """What was answered in a trial that had ended is asked again; a job that was done is not done again."""
    answers = 8 * GOOD
    robot = Robot()
    lead(PLAN, tmp_path, Person(*answers[:after]), robot)
    done = len(read_results(PLAN, tmp_path)[0])
    assert done == after // len(GOOD)
    ended = after % len(GOOD) > 0  # the job, not yet measured
    lead(PLAN, tmp_path, Person(*answers[done * len(GOOD) + ended :]), robot)
    assert len(robot.specs) == 8
    assert len(read_results(PLAN, tmp_path)[0]) == 8
    assert [event.what for event in events(PLAN, tmp_path)].count(Happened.SESSION) == 2


def test_a_skipped_trial_is_not_done_and_is_asked_for_again(tmp_path: Path) -> None:
    person = Person("s", "", "  ", "no nails left", *7 * GOOD)
    lead(PLAN, tmp_path, person)
    assert person.asked.count("Why is it skipped? ") == 3, "a reason is needed"
    write_report(PLAN, tmp_path)
    made = json.loads((tmp_path / "report.json").read_text())
    assert (made["finished"], made["of"], made["attended"]["skipped"]) == (7, 8, 1)
    assert made["attended"]["interruptions"][0]["reason"] == "no nails left"
    robot = lead(PLAN, tmp_path, Person(*GOOD))
    assert len(robot.specs) == 1
    write_report(PLAN, tmp_path)
    made = json.loads((tmp_path / "report.json").read_text())
    assert (made["finished"], made["attended"]["skipped"]) == (8, 0)


def test_no_answer_has_a_default(tmp_path: Path) -> None:
    person = Person("", "x", "r", "", "two", "3000", "-90", "0,4", "", "n", "maybe", "n", "", "y")
    lead(PLAN, tmp_path, person)
    (record,) = read_results(PLAN, tmp_path)[0]
    assert record.figures["person"]["nails"] == [{"name": "nail", "protrusion_mm": 0.4, "bent": False, "flush": True}]
    assert any("the nail is 30 mm long" in line for line in person.read)


@pytest.mark.parametrize(
    ("answers", "flush", "outcome"),
    [
        (("1.0", "n", "n"), True, "flush"),
        (("1.1", "n", "y"), False, "not_flush"),
        (("-0.5", "n", "n"), True, "flush"),
        (("0.1", "y", "n"), False, "bent"),
        (("-", "n", "n"), False, "not_flush"),
    ],
)
def test_the_person_decides_whatever_the_robot_believes(
    tmp_path: Path, answers: tuple[str, ...], flush: bool, outcome: str
) -> None:
    plan = replace(PLAN, trials=1, arms=(Variant.FULL,), tools=())
    lead(plan, tmp_path, Person("r", *answers, "y"))
    (record,) = read_results(plan, tmp_path)[0]
    assert (record.success, record.figures["outcome"]) == (flush, outcome)
    assert record.figures["robot"]["success"]
    assert record.figures["person"]["slipped"] == (answers[2] == "y")


def test_a_void_trial_is_kept_with_its_reason_and_done_again(tmp_path: Path) -> None:
    plan = replace(PLAN, trials=1, arms=(Variant.FULL,), tools=())
    robot = lead(plan, tmp_path, Person("r", "9", "n", "n", "n", "somebody bumped the table", *GOOD))
    (record,) = read_results(plan, tmp_path)[0]
    assert record.success
    assert (len(robot.specs), record.figures["tries"]) == (2, 2)
    (void,) = [event for event in events(plan, tmp_path) if event.what is Happened.VOID]
    assert void.facts["reason"] == "somebody bumped the table"
    assert void.facts["figures"]["person"]["nails"][0]["protrusion_mm"] == 9.0


def test_a_job_that_cannot_begin_is_no_trial(tmp_path: Path) -> None:
    plan = replace(PLAN, trials=1, arms=(Variant.FULL,), tools=())
    robot = Robot()
    faults = iter([TooleeError("the robot does not answer"), KeyboardInterrupt(), None])

    def job(spec: JobSpec, out: Path) -> dict[str, Any]:
        if fault := next(faults):
            raise fault
        return robot(spec, out)

    lead_trials(plan, tmp_path, Person("r", "r", *GOOD).ask, lambda _: None, job)
    assert len(read_results(plan, tmp_path)[0]) == 1
    reasons = [event.facts["reason"] for event in events(plan, tmp_path) if event.what is Happened.NOT_BEGUN]
    assert reasons == ["the robot does not answer", "it was interrupted before it began"]


def test_a_command_that_is_killed_in_a_job_does_that_trial_again_and_tells_it(tmp_path: Path) -> None:
    plan = replace(PLAN, trials=1, arms=(Variant.FULL,), tools=())

    def killed(*_: object) -> dict[str, Any]:
        raise SystemExit

    with pytest.raises(SystemExit):
        lead_trials(plan, tmp_path, Person("r").ask, lambda _: None, killed)
    person = Person(*GOOD)
    lead(plan, tmp_path, person)
    assert any("ended during this trial" in line for line in person.read)
    page = write_report(plan, tmp_path).read_text()
    assert "cut off" in page
    assert read_results(plan, tmp_path)[0][0].figures["tries"] == 2


def test_the_report_tells_where_person_and_robot_disagree(tmp_path: Path) -> None:
    plan = replace(PLAN, tools=())
    lead(plan, tmp_path, Person(*3 * GOOD, "r", "4", "n", "n", "y"))
    page = write_report(plan, tmp_path).read_text()
    made = json.loads((tmp_path / "report.json").read_text())["attended"]
    whole = [sum(of[who] for of in made["flush"].values()) for who in ("both", "person", "robot", "neither")]
    assert sum(whole) == 4
    assert len(made["disagreements"]) == whole[1] + whole[2]
    assert made["touch_against_calipers_mm"]["nails"] == 2
    assert "Person and robot" in page
    assert "only the robot" in page
    assert not made["rehearsed"]
    assert made["station_files"] == 1


def test_nails_and_woods_of_the_plan_are_told_to_person_and_job(tmp_path: Path) -> None:
    plan = replace(
        PLAN,
        trials=1,
        arms=(Variant.FULL,),
        tools=(),
        nails=("nail", LONG),
        woods={"oak": 0.68},
        instructions="Look twice.",
    )
    person = Person(*2 * GOOD)
    robot = lead(plan, tmp_path, person)
    works = {spec.nails: spec.source.config.work for spec in robot.specs}
    assert {work.wood_specific_gravity for work in works.values()} == {0.68}
    assert works["nail",].nail_length == load_lab_station(LAB).work.nail_length
    long = works[()]
    sizes = (long.nail_diameter, long.nail_length, long.nail_head_diameter, long.nail_protrusion)
    assert (*sizes, long.pilot_hole_diameter) == (0.0031, 0.065, 0.007, 0.03, 0.0026)
    text = "\n".join(person.read)
    assert "3.1 x 65: 3.1 x 65 mm, head 7 mm, 30 mm over the wood, pilot hole 2.6 mm" in text
    assert "oak, specific gravity 0.68" in text
    assert "Look twice." in text


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"arms": (Variant.FULL, Variant.PERFECT_PERCEPTION)}, "only a simulation knows"),
        ({"errors": "exact"}, "for simulations only"),
        ({"errors": {"ruler": 0.001}}, "for simulations only"),
        ({"where": InSimulation(), "attended": True}, "no station file"),
        ({"tools": ("a", PEEN, "a")}, "a name of its own"),
    ],
)
def test_what_makes_no_sense_on_a_robot_is_refused_with_the_reason(change: dict[str, Any], what: str) -> None:
    with pytest.raises(ValueError, match=what):
        replace(PLAN, **change)


def test_a_plan_on_a_robot_has_a_person_and_a_rehearsal_where_it_says_so(tmp_path: Path) -> None:
    rehearsal = InRehearsal(str(LAB))
    assert PLAN.led
    assert not replace(PLAN, tools=(), where=rehearsal).led
    assert replace(PLAN, tools=(), where=rehearsal, attended=True).led
    assert load_plan(LAB.with_name("robot_trials.yaml")).on_robot
    with pytest.raises(ValueError, match="where the seed chooses them"):
        replace(PLAN, where=rehearsal)
    with raises(UserError, says="a person is led through this"):
        run_trials(PLAN, tmp_path)


@pytest.mark.parametrize(("change", "what"), [({"tools": ("mallet",)}, "mallet"), ({"nails": ("left",)}, "left")])
def test_a_tool_or_nail_that_the_station_does_not_have_is_refused(
    tmp_path: Path, change: dict[str, Any], what: str
) -> None:
    with raises(ConfigError, says="the station") as refused:
        lead(replace(PLAN, **change), tmp_path, Person())
    assert what in str(refused.value)


def records(successes: str, arm: Variant = Variant.FULL) -> list[Record]:
    return [
        Record(Trial(arm, i), {"success": c == "x", "errors": {"camera_mm": float(i)}, "strikes": i or None}, ())
        for i, c in enumerate(successes)
    ]


@pytest.mark.parametrize(
    ("hits", "of", "low", "high"),
    [(100, 100, 0.9630, 1.0), (0, 20, 0.0, 0.1611), (81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605)],
)
def test_intervals_are_wilsons(hits: int, of: int, low: float, high: float) -> None:
    """The last two from Newcombe, "Two-sided confidence intervals for the single proportion", 1998, table I."""
    found = share([i < hits for i in range(of)])
    assert [found.low, found.high] == pytest.approx([low, high], abs=1e-4)


def test_pairs_are_compared_by_the_exact_test() -> None:
    """Ten pairs differ, one of them for the better: 2 (1 + 10) / 2^10."""
    found = compare(records("x" + "." * 9 + "xx", Variant.NO_CORRECTION), records("." + "x" * 9 + "xx"))
    assert (found.pairs, found.better, found.worse) == (12, 1, 9)
    assert found.p == pytest.approx(22 / 1024)
    assert compare(records("xx"), records("xx")).p == 1.0


def test_only_seeds_that_both_have_are_pairs() -> None:
    assert compare(records("x.x"), records("xxxxxx")).pairs == 3


def test_a_median_leaves_out_what_is_not_known() -> None:
    assert median(records("xxxx"), "strikes") == 2.0
    assert median(records("x"), "strikes") is None

"""The ledger: who scores a test set leaves an entry, and cannot score it without one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from toolee_robot.cli.app import run
from toolee_robot.perception.offline.dataset.records import INSTANCES
from toolee_robot.perception.offline.dataset.spec import DESCRIPTION, DatasetSpec
from toolee_robot.perception.offline.evaluation import ledger
from toolee_robot.perception.weight_files import WEIGHTS_DIR
from toolee_robot.runtime.files import sha256
from toolee_robot.tools.catalog import TOOL_SPECS, role, split

pytestmark = pytest.mark.sim(seconds=20)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A test set, as the command makes it."""
    folder = tmp_path_factory.mktemp("ledger") / "set"
    arguments = ["--config", "hard", "--size", "2", "--test-share", "1", "--seed", "5", "--workers", "1", "--test-set"]
    assert run(["dataset", "generate", *arguments, "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def described(tmp_path: Path) -> Path:
    """A test set as its description has it, without images."""
    folder = tmp_path / "described"
    folder.mkdir()
    (folder / DESCRIPTION).write_text(json.dumps(DatasetSpec("hard", 2, 5, 1.0, test_set=True).to_json()))
    (folder / "SHA256SUMS").touch()
    return folder


@pytest.fixture
def entries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "test_ledger.jsonl"
    path.touch()
    monkeypatch.setattr(ledger, "LEDGER", path)
    return path


@pytest.mark.nightly
def test_every_scoring_of_a_test_set_enters_itself(made: Path, entries: Path) -> None:
    for times in (1, 2):
        assert run(["evaluate", "pose", str(made), "--true-masks-only", "--limit", "2"]) == 0
        assert len(entries.read_text().splitlines()) == times
    assert run(["evaluate", "pose", str(made / "test"), "--true-masks-only", "--limit", "2"]) == 0
    first, _, of_split = (json.loads(line) for line in entries.read_text().splitlines())
    assert first["data"] == of_split["data"]
    assert first["data"]["sha256"] == sha256(made / "SHA256SUMS")
    assert (first["data"]["config"], first["data"]["seed"], first["limit"]) == ("hard", 5, 2)
    assert (first["data"]["sensor"], first["data"]["kinds"]) == ("time-of-flight", len(TOOL_SPECS))
    assert list(first["weights"]) == ["ours"], "the detector was not scored"
    assert first["weights"]["ours"] == of_split["weights"]["ours"]
    assert 0 <= first["figures"]["5deg2cm"]["ours"]["truth"]["average"] <= 1
    assert first["date"][:2] == "20"


def test_other_weights_have_another_hash(described: Path, entries: Path, tmp_path: Path) -> None:
    (tmp_path / "pose.json").write_text("{}")
    found = ledger.Ledger.of(described)
    assert found is not None
    found.enter("pose", {"shipped": None, "named": WEIGHTS_DIR, "others": tmp_path}, {})
    hashes = json.loads(entries.read_text())["weights"]
    assert hashes["shipped"] == hashes["named"] != hashes["others"]


def test_a_test_set_without_a_ledger_is_not_scored(
    described: Path, entries: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entries.unlink()
    assert run(["evaluate", "pose", str(described), "--true-masks-only"]) == 2
    printed = capsys.readouterr()
    assert "ledger" in printed.err
    assert "5deg2cm" not in printed.out


def test_other_data_sets_enter_nothing(described: Path, entries: Path, tmp_path: Path) -> None:
    spec = replace(DatasetSpec.read(described), test_set=False)
    (tmp_path / DESCRIPTION).write_text(json.dumps(spec.to_json()))
    assert ledger.Ledger.of(tmp_path) is None
    assert entries.read_text() == ""


def test_validation_and_test_tools_are_held_out_and_share_no_instance() -> None:
    roles = {use: {s for s in range(INSTANCES) if role(s) == use} for use in ("train", "validation", "test")}
    assert sum(map(len, roles.values())) == INSTANCES
    assert len(roles["validation"]) == len(roles["test"]) == INSTANCES // 10
    assert {s for s in range(INSTANCES) if split(s) == "test"} == roles["validation"] | roles["test"]

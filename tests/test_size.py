"""A room that grows over its budget fails, and what counts is code."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts import check_size


@pytest.fixture
def house(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    source = '# a comment\nX = 1\n"""What it is."""\n\n\ndef f() -> int:\n    """One."""\n    return X\n'
    for folder in (*check_size.PRODUCT, "control/arm", "tests"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "control" / "arm" / "code.py").write_text(source)
    (tmp_path / "toolee_robot" / "linked").symlink_to(tmp_path / "control")
    monkeypatch.setattr(check_size, "ROOT", tmp_path)
    monkeypatch.setattr(check_size, "BUDGET", tmp_path / "size_budget.toml")
    return tmp_path


@pytest.mark.parametrize(
    ("rooms", "code", "says"),
    [
        ('"control" = 3', 0, "size ok: 3 code lines in 1 files"),
        ('"control" = 2', 1, "control: 3 of 2, OVER"),
        ('"control" = 3\n"control/arm" = 2', 1, "control/arm: 3 of 2, OVER"),
        ('"toolee_robot" = 9', 1, "no room: 3 of 0, OVER"),
    ],
)
def test_a_room_over_its_budget_fails(
    house: Path, rooms: str, code: int, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (house / "size_budget.toml").write_text(f"[rooms]\n{rooms}\n[whole]\nproduct = 9\nfiles = 1\ntests = 0\n")
    assert check_size.main([]) == code
    assert says in capsys.readouterr().out

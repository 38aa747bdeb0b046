"""The matrix lists every fault of the safety page once; a failure while the machine stalled is measured again."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, get_args

import pytest

from tests.faults import matrix
from tests.faults.record import ATTEMPTS, FaultRow, Measurement, MissedMomentError, Phase
from toolee_robot.errors import LinkLostError, TooleeError
from toolee_robot.runtime.latency_monitor import STALL_LIMIT
from toolee_robot.sim_backend.ur_controller.profile import ProfileName
from toolee_robot.types import ArmModel


class Machine:
    """A latency monitor that has seen these stalls [s], one in each measurement."""

    def __init__(self, *stalls: float) -> None:
        self._stalls = list(stalls)
        self.longest = 0.0

    def begin(self) -> None:
        self.longest = self._stalls.pop(0) if self._stalls else 0.0


def measurement(*outcomes: bool | TooleeError) -> Measurement:
    left = list(outcomes)

    def run() -> FaultRow:
        outcome = left.pop(0)
        if isinstance(outcome, TooleeError):
            raise outcome
        return FaultRow(9, "connection closed", Phase.REST, "UR10", "latches", "latched", True, outcome)

    return Measurement(9, "connection closed", Phase.REST, "UR10", "latches", run)


STALL = 2 * STALL_LIMIT
MISSED = MissedMomentError("too late")


@pytest.mark.parametrize(
    ("outcomes", "stalls", "handled", "again"),
    [
        ((False,), (), False, 0),
        ((False, True), (STALL,), True, 1),
        ((False,) * ATTEMPTS, (STALL,) * ATTEMPTS, False, ATTEMPTS - 1),
        ((LinkLostError("the link is gone"),), (), False, 0),
        ((MISSED, True), (), True, 1),
        ((MISSED,) * ATTEMPTS, (), False, ATTEMPTS - 1),
    ],
)
def test_only_what_failed_while_the_machine_stalled_or_missed_its_moment_is_measured_again(
    outcomes: Any, stalls: tuple[float, ...], handled: bool, again: int
) -> None:
    machine: Any = Machine(*stalls)
    row = measurement(*outcomes).row(machine)
    assert (row.handled, row.again) == (handled, again)
    if isinstance(outcomes[-1], TooleeError):
        assert row.got == "not measured"
        assert str(outcomes[-1]) in row.why


def test_every_row_is_listed_once_and_its_number_is_on_the_safety_page() -> None:
    rows = list(matrix.matrix(list(matrix.PARTS), list(ArmModel), get_args(ProfileName)))
    names = [(row.number, row.fault, row.phase, row.on, row.expected) for row in rows]
    assert len(set(names)) == len(names)
    numbers = re.findall(r"^\| (\d+) \|", matrix.PAGE.read_text(), flags=re.MULTILINE)
    assert [int(number) for number in numbers] == sorted({row.number for row in rows})


def test_the_page_gets_the_rows_that_are_handled() -> None:
    rows = [measurement(good).row(Machine()) for good in (True, False, True)]  # type: ignore[arg-type]
    page = "| | fault | reaction | rows |\n|---|---|---|---|\n| 8 | old | stops | 1 of 1 |\n| 9 | cut | stops | |\n"
    written = matrix.table_with(page.replace("| |\n", "| - |\n"), matrix.handled(rows))
    assert written.splitlines()[2:] == ["| 8 | old | stops | 1 of 1 |", "| 9 | cut | stops | 2 of 3 |"]


@pytest.mark.parametrize("arguments", [["--fault", "reboot of the moon"], ["--part", "arm", "--write"]])
def test_rows_that_are_not_there_and_half_a_table_are_refused(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    listed: Callable[..., Any] = matrix.matrix
    monkeypatch.setattr(matrix, "matrix", lambda *args: listed(*args[:3]))
    with pytest.raises(SystemExit):
        matrix.main(arguments)
    assert "error" in capsys.readouterr().err

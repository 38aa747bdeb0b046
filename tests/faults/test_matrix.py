"""A run of the fault matrix measures the rows that are asked for, and says so where there are none."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import pytest

from tests.errors import raises
from toolee_robot.errors import UserError
from toolee_robot.faults import matrix
from toolee_robot.faults.matrix import MatrixOptions, run_matrix
from toolee_robot.faults.measuring import Measurement
from toolee_robot.faults.record import FaultRow, Phase


@pytest.fixture(autouse=True)
def two_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    def measurements(_: MatrixOptions) -> Iterator[Measurement]:
        for fault in ("protective stop", "emergency stop"):
            row = FaultRow(12, fault, Phase.REST, "UR10", "latches", "latched", True, True)
            yield Measurement(12, fault, Phase.REST, "UR10", "latches", partial(lambda row: row, row))

    monkeypatch.setattr(matrix, "_measurements", measurements)


@pytest.mark.parametrize(("fault", "rows"), [("", 2), ("stop", 2), ("emergency", 1)])
def test_rows_are_chosen_by_a_part_of_their_fault(fault: str, rows: int) -> None:
    found = list(run_matrix(MatrixOptions(fault=fault)))
    assert len(found) == rows
    assert all(fault in row.fault for row in found)


def test_no_row_of_that_fault() -> None:
    with raises(UserError, code="user.no_fault_row"):
        list(run_matrix(MatrixOptions(fault="reboot of the moon")))

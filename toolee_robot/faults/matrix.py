"""The whole matrix, row by row as it is measured."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from toolee_robot.faults.arm_rows import arm_rows
from toolee_robot.faults.process_rows import process_rows
from toolee_robot.faults.record import FaultRow
from toolee_robot.faults.rig import rig
from toolee_robot.types import ArmModel

ELSEWHERE = {
    16: "hand: checksum error, short or echoed frame",
    17: "hand: reply with a wrong id or address",
    19: "hand: write not acknowledged",
    20: "hand: USB unplugged",
}
"""Faults of the list that belong to the serial hand's driver, which does not exist yet."""


@dataclass(frozen=True)
class MatrixOptions:
    """host: a loopback address for the stand-ins. models: under which the arm's faults are injected."""

    host: str = "127.0.0.70"
    models: tuple[ArmModel, ...] = (ArmModel.UR10, ArmModel.UR10E)


def run_matrix(options: MatrixOptions) -> Iterator[FaultRow]:
    """Every row, sorted by nothing but the order of measuring."""
    for model in options.models:
        with rig(model, options.host) as arm_rig:
            yield from arm_rows(arm_rig)
        yield from process_rows(model, options.host)

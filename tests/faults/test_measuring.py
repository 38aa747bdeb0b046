"""A row that failed while the machine stalled is measured again, and says so; any other failure counts."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator

import pytest

from toolee_robot.errors import LinkLostError
from toolee_robot.faults.measuring import ATTEMPTS, Measurement
from toolee_robot.faults.record import FaultRow, Phase
from toolee_robot.faults.rigs.driver_rig import MissedMomentError
from toolee_robot.runtime.latency_monitor import STALL_LIMIT, LatencyMonitor

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def machine() -> Iterator[LatencyMonitor]:
    with LatencyMonitor() as witness:
        yield witness


def measurement(run: Callable[[], FaultRow]) -> Measurement:
    return Measurement(9, "connection closed", Phase.REST, "UR10", "latches", run)


def row(handled: bool) -> FaultRow:
    return FaultRow(9, "connection closed", Phase.REST, "UR10", "latches", "latched", True, handled)


def stand_still(machine: LatencyMonitor) -> None:
    """What the witness sees when the host takes the cores away."""
    os.kill(machine.pid, signal.SIGSTOP)
    time.sleep(3 * STALL_LIMIT)
    os.kill(machine.pid, signal.SIGCONT)
    time.sleep(STALL_LIMIT)


def test_a_failure_on_a_machine_without_stalls_counts(machine: LatencyMonitor) -> None:
    failed = measurement(lambda: row(False)).row(machine)
    assert not failed.handled
    assert failed.again == 0


def test_what_failed_while_the_machine_stood_still_is_measured_again(machine: LatencyMonitor) -> None:
    tries: list[FaultRow] = []

    def run() -> FaultRow:
        tries.append(row(len(tries) > 0))
        if not tries[-1].handled:
            stand_still(machine)
        return tries[-1]

    handled = measurement(run).row(machine)
    assert handled.handled
    assert handled.again == 1


def test_it_is_not_measured_until_it_succeeds(machine: LatencyMonitor) -> None:
    def run() -> FaultRow:
        stand_still(machine)
        return row(False)

    failed = measurement(run).row(machine)
    assert not failed.handled
    assert failed.again == ATTEMPTS - 1


def test_what_cannot_be_measured_is_not_handled_and_a_missed_moment_is_waited_for_again(
    machine: LatencyMonitor,
) -> None:
    def lost() -> FaultRow:
        raise LinkLostError("the link is gone")

    failed = measurement(lost).row(machine)
    assert (failed.handled, failed.again, failed.got) == (False, 0, "not measured")
    assert "the link is gone" in failed.why

    def late() -> FaultRow:
        raise MissedMomentError("too late")

    assert measurement(late).row(machine).again == ATTEMPTS - 1

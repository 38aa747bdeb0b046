"""The station with the hammer in the hand, one for all tests of the job, put back for each."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.rigs.job_rig import Bench


@pytest.fixture(scope="session")
def shared() -> Iterator[Bench]:
    bench = Bench()
    with bench.sim:
        yield bench


@pytest.fixture
def bench(shared: Bench) -> Bench:
    """The hammer in the hand, held at the handover."""
    shared.reset()
    return shared

"""`toolee bench-servo` for half a minute at each rate: the same figures as its ten minutes."""

from __future__ import annotations

import json

import pytest

from toolee_robot.cli.app import run

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize("model", ["UR10", "UR10e"])
def test_half_a_minute_meets_every_target(model: str, capsys: pytest.CaptureFixture[str]) -> None:
    status = run(["bench-servo", "--model", model, "--seconds", "30", "--host", "127.0.0.36", "--json"])
    out, table = capsys.readouterr()
    record = json.loads(out)
    trace = record["trace"]
    assert status == 0, table
    assert list(record["targets"].values()) == [True] * 4
    assert record["servo"]["memory_growth"] < 2**20
    # Not those about late ones, of which a restless machine has many; and of those that are left, tracking is told.
    assert trace["followed"] * trace["ticks"] > 100

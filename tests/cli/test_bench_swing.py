"""`toolee bench-swing`: the swing is faster than the straight line wherever the command has to turn back."""

from __future__ import annotations

import json

import pytest

from toolee_robot.cli.app import run
from toolee_robot.cli.bench.swing_draws import KINDS, STRAIGHT_BOUND, SWING_BOUND


def test_a_swing_is_faster_where_the_command_turns_back(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["bench-swing", "--draws", "3", "--seed", "1", "--json"]) in (0, 1)  # 1: slow on a busy machine
    strikes = json.loads(capsys.readouterr().out.splitlines()[-1])["strikes"]
    assert {s["kind"] for s in strikes} == set(KINDS)
    speeds = {(s["kind"], s["nail"]): s["speed"] for s in strikes if s["speed"] > 0}
    both = [n for n in range(3) if (STRAIGHT_BOUND, n) in speeds and (SWING_BOUND, n) in speeds]
    assert both
    for nail in both:
        assert speeds[SWING_BOUND, nail] > 1.5 * speeds[STRAIGHT_BOUND, nail]


def test_too_few_draws_are_refused() -> None:
    assert run(["bench-swing", "--draws", "1"]) == 2
